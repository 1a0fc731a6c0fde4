"""What the scoreboard is to show of ours, and whether it does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from servoscope.scoreboard.summary import median
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
    "planar": 0.95,
}
"""Share of the starts that are to succeed."""

MOST_MOVES = 6
MOST_MS = 15.0

_STOPPED = (
    "abstained",
    "diverged",
    "inconsistent",
    "out_of_workspace",
    "robot_fault",
    "camera_fault",
)
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


def _at_full_range(scene: str, trials: Mapping[str, Sequence[Trial]]) -> list[Target]:
    ours, theirs = trials["ours"], trials["photometric"]
    common = min(len(ours), len(theirs))
    bound = median([trial.end_mm for trial in theirs[:common]])
    measured: list[tuple[str, float | None, list[float]]] = [
        ("median moves", MOST_MOVES, [trial.moves for trial in ours if trial.succeeded]),
        (
            f"median end [mm], the {common} starts of the baseline",
            bound,
            [trial.end_mm for trial in ours[:common]],
        ),
        ("median decision [ms]", MOST_MS, [ms for trial in ours for ms in trial.decisions_ms]),
    ]
    return [_at_most(scene, what, most, median(values)) for what, most, values in measured]


def _at_most(scene: str, what: str, most: float | None, got: float | None) -> Target:
    reached = most is not None and got is not None and got <= most
    wanted = "-" if most is None else f"<= {most:g}"
    return Target(scene, "range_1.0", what, wanted, got, reached)


def _no_escape(scene: str, trials: Trials) -> Target:
    """Starts that end farther away than they began, and nobody stopped them."""
    escaped = sum(
        trial.end_mm > trial.start_mm and trial.status not in _STOPPED
        for by_method in trials.values()
        for trial in by_method["ours"]
    )
    what = "starts that end farther away and were not stopped"
    return Target(scene, "all", what, "<= 0", float(escaped), escaped == 0)
