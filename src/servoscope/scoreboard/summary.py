"""Trials as the numbers of the scoreboard, and whether ours are what they are to be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from servoscope.positioning.result import STATUSES
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
    """One target of one scene:

    what is measured, what is wanted, what came out, None where there was nothing to measure, and
    whether it is reached.
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


def summarise(trials: Sequence[Trial]) -> dict[str, Any]:
    """The numbers of one method under one condition, of one trial at least, as plain JSON values.

    ``moves_median`` is over the trials that succeeded, ``moves_to_success_median`` over those that
    ever came within 1 mm and 0.1 deg; None where there are none. ``final_`` and ``start_`` are over
    all trials, failures too.
    """
    final_mm = [trial.end_mm for trial in trials]
    succeeded = [trial.moves for trial in trials if trial.succeeded]
    arrived = [n for trial in trials if (n := trial.moves_to_success) is not None]
    counts = Counter(trial.status for trial in trials)
    return {
        "success": len(succeeded),
        "trials": len(trials),
        "moves_median": median(succeeded),
        "moves_to_success_median": median(arrived),
        "final_mm_median": median(final_mm),
        "final_deg_median": median([trial.end_deg for trial in trials]),
        "final_mm_p95": round(float(np.percentile(final_mm, 95)), 4),
        "start_mm_median": median([trial.start_mm for trial in trials]),
        "decision_ms_median": median([ms for trial in trials for ms in trial.decisions_ms]),
        "status_counts": {status: counts[status] for status in STATUSES if counts[status]},
        "predicted": _compare_prediction(trials),
    }


def _compare_prediction(trials: Sequence[Trial]) -> dict[str, float] | None:
    """How what is believed to be left at the end compares with what is left.

    ``within_2_std`` is the share of all dofs of all trials whose true displacement is within two
    believed deviations of the believed one; ``error_over_std_median`` the median of their ratio,
    0.67 where the deviations are right and errors normal. None where nothing is believed.
    """
    rows = [(trial.believed, trial.std, trial.truth) for trial in trials]
    believed, std, truth = np.array(rows, dtype=float).transpose(1, 0, 2)
    ratios = np.abs(truth - believed) / np.maximum(std, 1e-12)
    is_known = np.isfinite(ratios)
    if not is_known.any():
        return None
    ratio = ratios[is_known]
    return {
        "trials": int(is_known.any(axis=1).sum()),
        "within_2_std": round(float(np.mean(ratio <= 2)), 4),
        "error_over_std_median": round(float(np.median(ratio)), 4),
    }


def median(values: Sequence[float]) -> float | None:
    """The median, or None of nothing."""
    return round(float(np.median(values)), 4) if values else None
