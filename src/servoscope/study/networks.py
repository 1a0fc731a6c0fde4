"""The nets of Table I, one a family and dof, and those of the threshold sweep (Table III)."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import Split
from servoscope.poses import DOFS
from servoscope.regression import LMRegressor, NetworkJob, train_networks
from servoscope.selection import ThresholdSubset, threshold_subsets
from servoscope.study.assessment import Assessment
from servoscope.study.config import StudyConfig
from servoscope.study.feature_tables import FeatureTable
from servoscope.study.paper import FAMILIES

Progress = Callable[[int], object]


@dataclass(frozen=True, eq=False)
class TrainedNet:
    """A net and its RMS errors, in units of the acquisition range.

    Parameters
    ----------
    columns : ndarray
        Columns of the feature table that it takes.
    net : LMRegressor
    validation_rms, test_rms : float
    """

    columns: NDArray[np.intp]
    net: LMRegressor
    validation_rms: float
    test_rms: float


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """A subset of the sweep and the net trained on it."""

    subset: ThresholdSubset
    trained: TrainedNet


@dataclass(frozen=True, eq=False)
class StudyNets:
    """Nets by family and dof, and by dof along the sweep from the lowest threshold up."""

    families: dict[str, dict[str, TrainedNet]]
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
    inputs = [table.family(*key) for key in keys]
    points = [(dof, subset) for dof in DOFS for subset in sweeps[dof]]
    inputs += [table.candidates[list(subset.features)] for _, subset in points]
    dofs = [dof for _, dof in keys] + [dof for dof, _ in points]
    trained = train_nets(
        table, targets, split, dofs, inputs, config, n_jobs=n_jobs, on_progress=on_progress
    )
    families: dict[str, dict[str, TrainedNet]] = {family: {} for family in FAMILIES}
    for (family, dof), net in zip(keys, trained, strict=False):
        families[family][dof] = net
    sweep_nets: dict[str, list[SweepPoint]] = {dof: [] for dof in DOFS}
    for (dof, subset), net in zip(points, trained[len(keys) :], strict=True):
        sweep_nets[dof].append(SweepPoint(subset, net))
    return StudyNets(families, sweep_nets)


def train_nets(
    table: FeatureTable,
    targets: NDArray[np.float64],
    split: Split,
    dofs: Sequence[str],
    inputs: Sequence[NDArray[np.intp]],
    config: StudyConfig,
    *,
    n_jobs: int = -1,
    on_progress: Progress | None = None,
) -> list[TrainedNet]:
    """Train a net for each dof from the columns of the table that it is given.

    Parameters
    ----------
    dofs : sequence of str
    inputs : sequence of ndarray
        As many arrays of columns.
    table, targets, split, config, n_jobs, on_progress
        As of `train_study_nets`.
    """
    jobs = [
        NetworkJob(columns, DOFS.index(dof), _seed(config.seed, dof, columns))
        for columns, dof in zip(inputs, dofs, strict=True)
    ]
    nets = train_networks(
        table.values,
        targets,
        jobs,
        split.train,
        split.validation,
        regressor=LMRegressor(hidden=config.hidden, restarts=config.restarts),
        n_jobs=n_jobs,
        on_progress=on_progress,
    )
    return [
        _measure(table.values, targets, split, job, net)
        for job, net in zip(jobs, nets, strict=True)
    ]


def _measure(
    X: NDArray[np.float64],
    Y: NDArray[np.float64],
    split: Split,
    job: NetworkJob,
    net: LMRegressor,
) -> TrainedNet:
    def rms(samples: NDArray[np.intp]) -> float:
        error = net.predict(X[np.ix_(samples, job.columns)]) - Y[samples, job.target]
        return float(np.sqrt(np.mean(error**2)))

    return TrainedNet(job.columns, net, rms(split.validation), rms(split.test))


def _seed(seed: int, dof: str, columns: NDArray[np.intp]) -> int:
    """A seed that depends on what the net learns from, and not on its place in the list."""
    return zlib.crc32(f"{seed} {dof} {columns.tolist()}".encode())
