"""The nets of Table I and of the threshold sweep (Table III), and their results as JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import Split
from servoscope.pipeline import FeatureTable, Fitted, Recipe, fit_all
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.selection import ThresholdSubset, best_subset, threshold_subsets
from servoscope.study.information import CANDIDATES, Assessment
from servoscope.study.paper import FAMILIES, StudyConfig

Progress = Callable[[int], object]


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """A subset of the sweep and the net trained on it."""

    subset: ThresholdSubset
    trained: Fitted


@dataclass(frozen=True, eq=False)
class StudyNets:
    """Nets by family and dof, and by dof along the sweep from the lowest threshold up."""

    families: dict[str, dict[str, Fitted]]
    sweeps: dict[str, list[SweepPoint]]


def plan_sweeps(
    assessment: Assessment, thresholds: NDArray[np.float64]
) -> dict[str, list[ThresholdSubset]]:
    """The distinct subsets of every dof's ranked features along the thresholds.

    A dof that no feature informs, since it never moves, gets the subset of all ranked features.
    """
    return {
        dof: threshold_subsets(ranking.order, ranking.relevance, thresholds)
        or [ThresholdSubset(tuple(ranking.order.tolist()), (0.0,))]
        for dof, ranking in assessment.rankings.items()
    }


def train_study_nets(
    table: FeatureTable,
    targets: NDArray[np.float64],
    split: Split,
    sweeps: dict[str, list[ThresholdSubset]],
    config: StudyConfig,
    *,
    n_jobs: int = -1,
    on_progress: Progress | None = None,
) -> StudyNets:
    """Train every net of one protocol and displacement form, on targets scaled to [-1, 1].

    They stop, and the best restart is chosen, on the validation images; `sweeps` are the subsets of
    candidates to try for every dof.
    """
    keys = [(family, dof) for family in FAMILIES for dof in DOFS]
    points = [(dof, subset) for dof in DOFS for subset in sweeps[dof]]
    jobs = [(FAMILIES[family].recipe, dof) for family, dof in keys]
    jobs += [(subset_recipe(table, subset.features), dof) for dof, subset in points]
    trained = train_nets(
        table, targets, split, jobs, config, n_jobs=n_jobs, on_progress=on_progress
    )
    families: dict[str, dict[str, Fitted]] = {family: {} for family in FAMILIES}
    for (family, dof), net in zip(keys, trained, strict=False):
        families[family][dof] = net
    sweep_nets: dict[str, list[SweepPoint]] = {dof: [] for dof in DOFS}
    for (dof, subset), net in zip(points, trained[len(keys) :], strict=True):
        sweep_nets[dof].append(SweepPoint(subset, net))
    return StudyNets(families, sweep_nets)


def subset_recipe(table: FeatureTable, candidates: Sequence[int]) -> Recipe:
    """The recipe of a net that takes some of the candidates, by their numbers."""
    columns = table.columns(CANDIDATES)[list(candidates)]
    return Recipe(
        CANDIDATES.features, tuple(table.names[i] for i in columns), "levenberg_marquardt"
    )


def train_nets(
    table: FeatureTable,
    targets: NDArray[np.float64],
    split: Split,
    jobs: Sequence[tuple[Recipe, str]],
    config: StudyConfig,
    *,
    n_jobs: int = -1,
    on_progress: Progress | None = None,
) -> list[Fitted]:
    """Train a net for each recipe and dof, as the study is configured; see `train_study_nets`."""
    settings = {"hidden": config.hidden, "restarts": config.restarts}
    return fit_all(
        table,
        targets,
        split,
        [(replace(recipe, settings=settings), dof) for recipe, dof in jobs],
        seed=config.seed,
        n_jobs=n_jobs,
        on_progress=on_progress,
    )


def summarise(
    assessment: Assessment,
    nets: StudyNets,
    targets: NDArray[np.float64],
    split: Split,
    ranges: NDArray[np.float64],
) -> dict[str, Any]:
    """Tables I to III and all that stands behind them, for one protocol and displacement form.

    ``table1[family][dof]`` and ``table3[dof]`` have RMS errors in units of the range (``rms``) and
    in ``physical`` ``unit``; ``table2[dof]`` has names in order of selection, ``mi[feature][dof]``
    is in bits. ``best_family`` is so on the average of the dofs, for the images that decide;
    ``baseline[dof]`` is the error of always predicting the mean of the training images;
    ``ranges[dof]``, what the targets were divided by, has ``value`` None for a dof that never
    moves. ``ranking``, ``sweep`` and ``stability`` are by dof.
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
