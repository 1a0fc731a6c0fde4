"""The criteria of selection side by side, and forecasts beside nets, as the page shows them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from servoscope.report.names import CRITERION_NAMES, DOF_LABELS

SHOWN = 8
"""The number of features for which the table tells the error of every dof."""

FEWEST = 12
"""So few forecasts say nothing of how well they agree."""


def describe_criteria(compared: dict[str, Any] | None) -> dict[str, Any] | None:
    """What the page shows of the criteria; None where they were not compared.

    Returns
    -------
    dict or None
        ``sizes``, ``shown`` and ``dofs`` as heads; ``rows``, one a criterion, with the errors on
        the ``means`` of the dofs by size and of the ``cells`` by dof at the size that is shown,
        each with ``rms`` and whether it is the ``best``; the errors of ``all_candidates`` and
        their number; a ``sentence``, and the ``forecasts`` as another.
    """
    if not compared:
        return None
    dofs, place = list(compared["all_candidates"]), compared["sizes"].index(SHOWN)
    means = {name: _means(by_dof) for name, by_dof in compared["errors"].items()}
    shown = {
        name: [by_dof[dof][place] for dof in dofs] for name, by_dof in compared["errors"].items()
    }
    everything = float(np.mean(list(compared["all_candidates"].values())))
    return {
        "sizes": compared["sizes"],
        "shown": SHOWN,
        "dofs": [DOF_LABELS[dof] for dof in dofs],
        "rows": [
            {
                "title": CRITERION_NAMES.get(name, name),
                "means": _marked(means[name], list(means.values())),
                "cells": _marked(shown[name], list(shown.values())),
            }
            for name in means
        ],
        "all_candidates": everything,
        "sentence": _least({name: errors[place] for name, errors in means.items()}, everything),
        "forecasts": _forecasts(compared["forecasts"]),
    }


def describe_agreement(pairs: NDArray[np.float64]) -> str:
    """How far forecasts agree with what was reached; nothing where there are few.

    Parameters
    ----------
    pairs : ndarray of shape (n_forecasts, 2)
        Forecast and reached errors, in the same unit for all dofs.
    """
    if len(pairs) < FEWEST or not (pairs > 0).all():
        return ""
    ratio = pairs[:, 0] / pairs[:, 1]
    within = np.mean((ratio >= 0.75) & (ratio <= 1.33))
    return (
        f"Of {len(pairs)} forecasts, {100 * within:.0f} % lie within 0.75 and 1.33 of what was "
        f"reached; the median ratio is {np.median(ratio):.2f}, the rank correlation "
        f"{spearmanr(*pairs.T).statistic:.2f}."
    )


def _means(by_dof: dict[str, list[float]]) -> list[float]:
    means: list[float] = np.mean(list(by_dof.values()), axis=0).tolist()
    return means


def _marked(own: list[float], of_all: list[list[float]]) -> list[dict[str, Any]]:
    least = np.min(of_all, axis=0)
    return [{"rms": rms, "best": bool(rms == best)} for rms, best in zip(own, least, strict=True)]


def _least(means: dict[str, float], everything: float) -> str:
    best = min(means, key=lambda name: means[name])
    published = (
        ""
        if best == "ideal_point"
        else f", against {means['ideal_point']:.3f} by the published ideal-point rule"
    )
    return (
        f"With {SHOWN} features the error is least when they are selected by "
        f"{CRITERION_NAMES.get(best, best)}: {means[best]:.3f} of the range on the average of the "
        f"degrees of freedom{published}. All candidates together reach {everything:.3f}."
    )


def _forecasts(forecasts: list[dict[str, Any]]) -> str:
    """The sentence on the forecasts for these nets."""
    pairs = np.array([(pair["forecast"], pair["reached"]) for pair in forecasts]).reshape(-1, 2)
    told = describe_agreement(pairs)
    return told and (
        "Errors were also forecast, before training, for the nets of moments, eigenfeatures, "
        f"pose-image covariance and the minimum subsets of Table III. {told}"
    )
