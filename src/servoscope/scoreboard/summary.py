"""Trials as the numbers of the scoreboard."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from servoscope.positioning.result import STATUSES
from servoscope.scoreboard.trial import Trial


def summarise(trials: Sequence[Trial]) -> dict[str, Any]:
    """The numbers of one method under one condition, as plain JSON values.

    Parameters
    ----------
    trials : sequence of Trial
        One at least.

    Returns
    -------
    dict
        ``moves_median`` is over the trials that succeeded, ``moves_to_success_median`` over those
        that ever came within 1 mm and 0.1 deg; None where there are none. ``final_`` and
        ``start_`` are over all trials, failures too.
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
