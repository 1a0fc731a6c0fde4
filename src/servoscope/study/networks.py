"""The nets of Table I, one a family and dof, and those of the threshold sweep (Table III)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import Split
from servoscope.pipeline import FeatureTable, Fitted, Recipe, fit_all
from servoscope.poses import DOFS
from servoscope.selection import ThresholdSubset, threshold_subsets
from servoscope.study.assessment import Assessment
from servoscope.study.config import StudyConfig
from servoscope.study.feature_tables import CANDIDATES
from servoscope.study.paper import FAMILIES, RECIPES

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

    A dof that no feature tells of, since it never moves, gets the subset of all ranked features.
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
    """Train every net of one protocol and displacement form.

    Parameters
    ----------
    table : FeatureTable
    targets : ndarray of shape (n_images, 6)
        Displacements scaled to [-1, 1], in `DOFS` order.
    split : Split
        The nets stop, and the best restart is chosen, on the validation images.
    sweeps : dict
        The subsets of candidates to try for every dof.
    config : StudyConfig
    n_jobs : int
        Processes, as joblib counts them; all cores by default.
    on_progress : callable, optional
        Called with the number of nets finished.
    """
    keys = [(family, dof) for family in FAMILIES for dof in DOFS]
    points = [(dof, subset) for dof in DOFS for subset in sweeps[dof]]
    jobs = [(RECIPES[family], dof) for family, dof in keys]
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
    """Train a net for each recipe and dof, as the study is configured.

    Parameters
    ----------
    jobs : sequence of (Recipe, str)
    table, targets, split, config, n_jobs, on_progress
        As of `train_study_nets`.
    """
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
