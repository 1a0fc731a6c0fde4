"""One regressor for each degree of freedom, on the features that tell it best."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.families import FamilyFeatures, FamilyTransformer
from servoscope.data.splits import Split
from servoscope.poses import DOFS
from servoscope.processes import in_processes, one_blas_thread
from servoscope.regression import GaussianProcess
from servoscope.regression.comparison import INTERVAL

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DofModel:
    """What tells one dof, and how well it does on the test images.

    Parameters
    ----------
    family : str
    rms : float
        On the test images, in units of the range.
    covered : float
        Share of the test images within 1.96 of the standard deviations that it predicts.
    best_features : tuple of str
        The features that have most say, the first most of all.
    regressor : GaussianProcess or None
        None where only its errors were wanted.
    """

    family: str
    rms: float
    covered: float
    best_features: tuple[str, ...]
    regressor: GaussianProcess | None = None


@dataclass(frozen=True, eq=False)
class PoseModels:
    """A model for each dof that moves, and the features that they take."""

    dofs: Mapping[str, DofModel]
    transformers: Mapping[str, FamilyTransformer]

    def predict(self, images: NDArray[np.uint8]) -> dict[str, Array]:
        """Displacements told from images by dof, in units of the range."""
        features = {name: one.transform(images) for name, one in self.transformers.items()}
        return {
            dof: model.regressor.predict(features[model.family])
            for dof, model in self.dofs.items()
            if model.regressor is not None
        }


def train_models(
    candidates: Mapping[str, FamilyFeatures],
    targets: Array,
    split: Split,
    choice: Mapping[str, str],
    *,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> dict[str, dict[str, DofModel]]:
    """Train a Gaussian process on every candidate for every dof, and test it on other images.

    Parameters
    ----------
    candidates : dict of FamilyFeatures
    targets : ndarray of shape (n_images, 6)
        Displacements in units of the range.
    split : Split
        The validation images set the size of the predicted standard deviations, and are learned
        from as well.
    choice : dict
        The dofs to train for, and the candidate whose regressor is kept for each.

    Returns
    -------
    dict
        By candidate and dof.
    """
    jobs = [(name, dof) for name in candidates for dof in choice]
    calls = (
        (candidates[name], targets[:, DOFS.index(dof)], split, choice[dof] == name)
        for name, dof in jobs
    )
    trained: dict[str, dict[str, DofModel]] = {name: {} for name in candidates}
    results = in_processes(_train_one, calls, n_jobs)
    for n_done, ((name, dof), model) in enumerate(zip(jobs, results, strict=True), start=1):
        trained[name][dof] = model
        if on_progress is not None:
            on_progress(n_done)
    return trained


def join_models(
    trained: Mapping[str, Mapping[str, DofModel]],
    choice: Mapping[str, str],
    images: NDArray[np.uint8],
    targets: Array,
) -> PoseModels:
    """The chosen models, with transformers fitted to the images that were learned from."""
    with one_blas_thread():
        transformers = {
            name: FamilyTransformer(name).fit(images, targets)
            for name in sorted(set(choice.values()))
        }
    return PoseModels({dof: trained[name][dof] for dof, name in choice.items()}, transformers)


def _train_one(features: FamilyFeatures, y: Array, split: Split, keep: bool) -> DofModel:
    X, train, validation = features.values, split.train, split.validation
    with one_blas_thread():
        regressor = GaussianProcess().fit(X[train], y[train], X[validation], y[validation])
        told, deviation = regressor.predict(X[split.test], return_std=True)
    error = told - y[split.test]
    return DofModel(
        features.family,
        rms=float(np.sqrt(np.mean(error**2))),
        covered=float(np.mean(np.abs(error) <= INTERVAL * deviation)),
        best_features=_best_features(regressor, X[train], features.names),
        regressor=regressor if keep else None,
    )


def _best_features(
    regressor: GaussianProcess, X: Array, names: tuple[str, ...], n_best: int = 5
) -> tuple[str, ...]:
    """The features whose spread is most length scales wide."""
    say = X.std(axis=0) / regressor.kernel_.length_scales
    return tuple(names[i] for i in np.argsort(-say, kind="stable")[:n_best] if say[i] > 0)
