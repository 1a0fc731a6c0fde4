"""What the scoreboard is to show of ours, and whether it does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from servoscope.scoreboard.trial import Trial

Trials = Mapping[str, Mapping[str, Sequence[Trial]]]
"""The trials of a scene by condition and method."""

LEAST_SHARES = {
    "range_1.0": 0.99,
    "gain_0.8": 0.95,
    "light_moved": 0.95,
    "covered_10": 0.95,
    "noise_10": 0.95,
    "repeatability": 0.95,
    "range_1.5": 0.90,
}
"""Share of the starts that are to succeed."""

MOST_MOVES = 6
MOST_MS = 15.0

_STOPPED = ("abstained", "diverged", "out_of_workspace", "robot_fault", "camera_fault")
"""The statuses with which the guard or a fault ended a run, and said so."""


@dataclass(frozen=True)
class Target:
    """One target of one scene.

    Parameters
    ----------
    scene, condition : str
    what : str
        What is measured, in words.
    wanted : str
    got : float or None
        None where there was nothing to measure.
    reached : bool
    """

    scene: str
    condition: str
    what: str
    wanted: str
    got: float | None
    reached: bool

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self)


def check_targets(scene: str, trials: Trials) -> list[Target]:
    """The targets of a scene, of the conditions that were measured."""
    targets = [
        _at_least(scene, condition, share, trials[condition]["ours"])
        for condition, share in LEAST_SHARES.items()
        if condition in trials
    ]
    if "range_1.0" in trials:
        targets += _at_full_range(scene, trials["range_1.0"])
    return [*targets, _no_escape(scene, trials)]


def _at_least(scene: str, condition: str, share: float, ours: Sequence[Trial]) -> Target:
    got = round(float(np.mean([trial.succeeded for trial in ours])), 4)
    return Target(scene, condition, "share that succeeded", f">= {share:g}", got, got >= share)


def _at_full_range(scene: str, trials: Mapping[str, Sequence[Trial]]) -> Iterator[Target]:
    ours, theirs = trials["ours"], trials["photometric"]
    condition = "range_1.0"
    moves = [trial.moves for trial in ours if trial.succeeded]
    got = float(np.median(moves)) if moves else None
    reached = got is not None and got <= MOST_MOVES
    yield Target(scene, condition, "median moves", f"<= {MOST_MOVES}", got, reached)
    common = min(len(ours), len(theirs))
    end, bound = (
        round(float(np.median([t.end_mm for t in c[:common]])), 4) for c in (ours, theirs)
    )
    what = f"median end [mm], the {common} starts of the baseline"
    yield Target(scene, condition, what, f"<= {bound:g}", end, end <= bound)
    ms = round(float(np.median([ms for trial in ours for ms in trial.decisions_ms])), 3)
    yield Target(scene, condition, "median decision [ms]", f"<= {MOST_MS:g}", ms, ms <= MOST_MS)


def _no_escape(scene: str, trials: Trials) -> Target:
    """Starts that end farther away than they began, and nobody stopped them."""
    escaped = sum(
        trial.end_mm > trial.start_mm and trial.status not in _STOPPED
        for by_method in trials.values()
        for trial in by_method["ours"]
    )
    what = "starts that end farther away and were not stopped"
    return Target(scene, "all", what, "<= 0", float(escaped), escaped == 0)
