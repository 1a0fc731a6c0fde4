"""The results of a study as one JSON value."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import Split
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.selection import best_subset
from servoscope.study.assessment import Assessment
from servoscope.study.networks import StudyNets, SweepPoint
from servoscope.study.paper import FAMILIES


def summarise(
    assessment: Assessment,
    nets: StudyNets,
    targets: NDArray[np.float64],
    split: Split,
    ranges: NDArray[np.float64],
) -> dict[str, Any]:
    """Tables I to III and all that stands behind them, for one protocol and displacement form.

    Parameters
    ----------
    assessment : Assessment
    nets : StudyNets
    targets : ndarray of shape (n_images, 6)
        Displacements scaled to [-1, 1], in `DOFS` order.
    split : Split
    ranges : ndarray of shape (6,)
        What the targets were divided by, [m] and [rad].

    Returns
    -------
    dict
        ``table1[family][dof]`` and ``table3[dof]`` with RMS errors in units of the range
        (``rms``) and in ``physical`` ``unit``; ``table2[dof]``, names in order of selection;
        ``mi[feature][dof]`` in bits; ``best_family``, on the average of the dofs, for the images
        that decide; ``baseline[dof]``, the error of always predicting the mean of
        the training images; ``ranges[dof]`` with ``value`` None for a dof that never moves;
        ``n_images`` that train, decide and test; and ``ranking``, ``sweep`` and ``stability`` by
        dof.
    """
    errors = targets[split.test] - targets[split.train].mean(axis=0)
    baseline = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    scale = dict(zip(DOFS, ranges * DISPLAY_FACTORS, strict=True))
    names = assessment.names
    best = {dof: choose_best(points) for dof, points in nets.sweeps.items()}
    return {
        "table1": {
            family: {dof: _error(nets.families[family][dof].test_rms, dof, scale) for dof in DOFS}
            for family in FAMILIES
        },
        "best_family": min(FAMILIES, key=lambda family: _validation_rms(nets, family)),
        "baseline": {dof: _error(rms, dof, scale) for dof, rms in zip(DOFS, baseline, strict=True)},
        "table2": {dof: [names[i] for i in assessment.rankings[dof].order] for dof in DOFS},
        "table3": {dof: _minimum_subset(best[dof], dof, scale, names) for dof in DOFS},
        "mi": {
            name: dict(zip(DOFS, row, strict=True))
            for name, row in zip(names, assessment.mutual_information.tolist(), strict=True)
        },
        "mi_null_level": assessment.null_level,
        "ranking": {dof: _ranking(assessment, dof) for dof in DOFS},
        "sweep": {dof: [_sweep_point(p) for p in nets.sweeps[dof]] for dof in DOFS},
        "stability": {dof: _stability(assessment, dof) for dof in DOFS},
        "ranges": {
            dof: {"value": scale[dof] if moved else None, "unit": _unit(dof)}
            for dof, moved in zip(DOFS, np.ptp(targets, axis=0) > 0, strict=True)
        },
        "n_images": {part: len(getattr(split, part)) for part in ("train", "validation", "test")},
    }


def choose_best(points: list[SweepPoint]) -> SweepPoint:
    """The point of a sweep with the least error on the images that decide."""
    subsets = [point.subset for point in points]
    return points[best_subset(subsets, [point.trained.validation_rms for point in points])]


def _validation_rms(nets: StudyNets, family: str) -> float:
    return sum(nets.families[family][dof].validation_rms for dof in DOFS) / len(DOFS)


def _unit(dof: str) -> str:
    return DISPLAY_UNITS[DOFS.index(dof)]


def _error(rms: float, dof: str, scale: dict[str, float]) -> dict[str, Any]:
    return {"rms": rms, "physical": rms * scale[dof], "unit": _unit(dof)}


def _minimum_subset(
    point: SweepPoint, dof: str, scale: dict[str, float], names: list[str]
) -> dict[str, Any]:
    features = [names[i] for i in point.subset.features]
    return {
        **_error(point.trained.test_rms, dof, scale),
        "n_features": len(features),
        "features": features,
        "threshold": point.subset.thresholds[0],
    }


def _sweep_point(point: SweepPoint) -> dict[str, Any]:
    return {
        "thresholds": list(point.subset.thresholds),
        "n_features": len(point.subset.features),
        "rms": point.trained.test_rms,
        "validation_rms": point.trained.validation_rms,
    }


def _ranking(assessment: Assessment, dof: str) -> list[dict[str, Any]]:
    ranking = assessment.rankings[dof]
    return [
        {"feature": assessment.names[i], "relevance": float(r), "redundancy": float(s)}
        for i, r, s in zip(ranking.order, ranking.relevance, ranking.redundancy, strict=True)
    ]


def _stability(assessment: Assessment, dof: str) -> list[dict[str, Any]]:
    """For every number of bins, how far the order agrees with the study's own."""
    stability = assessment.stability[dof]
    columns = (stability.n_bins, stability.same_steps, stability.overlap, stability.kendall_tau)
    return [
        {
            "n_bins": int(bins),
            "same_steps": int(steps),
            "overlap": float(o),
            "kendall_tau": float(t),
        }
        for bins, steps, o, t in zip(*columns, strict=True)
    ]
