"""The families of features side by side: their features of clean and of disturbed images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import servoscope as sv
from servoscope.data.splits import Split
from servoscope.features.catalogue import FAMILIES
from servoscope.features.image_transformer import ImageTransformer
from servoscope.scene.disturbances import SINGLE_DISTURBANCES, Disturbances
from servoscope.study.information import lfa_window

N_SELECTED = 24
N_COPIES = 3
LFA_PER_DOF = 12

PUBLISHED = ("moments", "eigenfeatures", "pose_covariance", "lfa", "mix", "mix_selected")
"""The paper's families; the mix is of the first three, the selected are 24 of it by their MI."""

COVERINGS = {"robust_copies_8": (0.08, 0.12, 1.0), "robust_copies_5": (0.05, 0.12, 1.0)}
"""How much of the copies is covered that completed cells are trained with as well."""

Array = np.ndarray
Columns = Callable[[Array, Array, int], Array]
"""Which features serve a dof, given those of the training images, its targets and its number."""


@dataclass(frozen=True, eq=False)
class FamilySamples:
    """The features of one family.

    Parameters
    ----------
    train, validation : ndarray of shape (n, n_features)
    tests : dict of ndarray of shape (n_test, n_features)
        Of the test images, ``"clean"`` and by the disturbance that they were given.
    columns : callable
    copies : int
        How many times the training images stand in `train`.
    """

    train: Array
    validation: Array
    tests: dict[str, Array]
    columns: Columns
    copies: int = 1


def compute_families(
    data: sv.PoseImageSet, targets: Array, split: Split, seed: int
) -> dict[str, FamilySamples]:
    """Every family by name, fitted to the training images."""
    images = data.images[split.train]
    views = _views(data.images, split, seed)
    found = {}
    for name, transformer in _transformers(len(images), data.image_shape).items():
        transformer.fit(images, targets[split.train])
        features = {view: transformer.transform(shown) for view, shown in views.items()}
        found[name] = _samples(features, _lfa_columns if name == "lfa" else _all_columns)
        if name == "robust":
            found |= _trained_with_copies(transformer, images, found[name], seed)
    parts = [found[name] for name in PUBLISHED[:3]]
    mix = {
        view: np.hstack([_view(part, view) for part in parts])
        for view in ("train", "validation", *parts[0].tests)
    }
    found["mix"], found["mix_selected"] = (
        _samples(mix, columns) for columns in (_all_columns, _selected_columns)
    )
    return found


def _transformers(n: int, image_shape: tuple[int, int]) -> dict[str, ImageTransformer]:
    """Those that `assess` tries, and those that it does not."""
    tried = {
        name: family.make(n) for name, family in FAMILIES.built_in.items() if family.is_default
    }
    n_eigenvectors = min(35, n // 3)
    others = {
        "lfa": sv.LocalFeatureAnalysis(
            n_eigenvectors, n_per_dof=LFA_PER_DOF, window=lfa_window(image_shape)
        ),
        "tchebichef": sv.TchebichefMoments(),
        "lfa_covariance": sv.LocalFeatureCovariance(min(85, n // 3)),
    }
    return tried | others


def _views(images: Array, split: Split, seed: int) -> dict[str, Array]:
    """The images that train, decide and test, the last also with one disturbance each."""
    test = images[split.test]
    disturbed = {
        name: _disturbed(disturbance, test, seed)
        for name, disturbance in SINGLE_DISTURBANCES.items()
    }
    return {
        "train": images[split.train],
        "validation": images[split.validation],
        "clean": test,
        **disturbed,
    }


def _disturbed(disturbance: Disturbances, images: Array, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return np.array([disturbance.disturb(image, rng) for image in images])


def _samples(features: dict[str, Array], columns: Columns) -> FamilySamples:
    tests = {view: X for view, X in features.items() if view not in ("train", "validation")}
    return FamilySamples(features["train"], features["validation"], tests, columns)


def _view(samples: FamilySamples, view: str) -> Array:
    kept = {"train": samples.train, "validation": samples.validation}
    return (kept | samples.tests)[view]


def _trained_with_copies(
    transformer: ImageTransformer, images: Array, clean: FamilySamples, seed: int
) -> dict[str, FamilySamples]:
    """The same features, with those of covered copies of the training images among the samples."""
    found = {}
    for name, covering in COVERINGS.items():
        others = dict.fromkeys(("defocus", "light", "gain", "offset", "noise"))
        cover = Disturbances(**others, covering=covering)
        copies = [
            transformer.transform(_disturbed(cover, images, 1000 * (seed + 1) + copy))
            for copy in range(N_COPIES)
        ]
        train = np.vstack([clean.train, *copies])
        found[name] = FamilySamples(
            train, clean.validation, clean.tests, _all_columns, 1 + N_COPIES
        )
    return found


def _all_columns(X: Array, y: Array, dof: int) -> Array:
    return np.arange(X.shape[1])


def _lfa_columns(X: Array, y: Array, dof: int) -> Array:
    return np.arange(LFA_PER_DOF * dof, LFA_PER_DOF * (dof + 1))


def _selected_columns(X: Array, y: Array, dof: int) -> Array:
    return sv.MutualInfoSelector(N_SELECTED).fit(X, y).ranking_
