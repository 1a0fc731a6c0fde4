"""The families of features that an assessment tries, and their features of a data set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features import (
    Eigenfeatures,
    GeometricMoments,
    GradientMoments,
    ImageProjections,
    IntensityMoments,
    LogPolarFeatures,
    PoseImageCovariance,
    PoseLeastSquares,
    RobustMoments,
)
from servoscope.features.image_transformer import ImageTransformer
from servoscope.processes import in_processes, one_blas_thread
from servoscope.wording import listing

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Family:
    """A family of features.

    Parameters
    ----------
    title : str
        What people call it.
    make : callable
        The transformer, for so many images to learn from.
    is_learned : bool
        Whether the features themselves are fitted to images, so that those images flatter them.
    """

    title: str
    make: Callable[[int], ImageTransformer]
    is_learned: bool = False


FAMILIES = {
    "moments": Family("geometric moments", lambda n: GeometricMoments()),
    "eigenfeatures": Family(
        "eigenfeatures",
        lambda n: Eigenfeatures(min(35, n // 3)),
        is_learned=True,
    ),
    "pose_covariance": Family(
        "pose-image covariance", lambda n: PoseImageCovariance(), is_learned=True
    ),
    "least_squares": Family(
        "partial least squares", lambda n: PoseLeastSquares(min(20, n // 3)), is_learned=True
    ),
    "projections": Family("projections onto lines", lambda n: ImageProjections()),
    "log_polar": Family("log-polar waves", lambda n: LogPolarFeatures()),
    "gradient": Family("gradient orientations in cells", lambda n: GradientMoments()),
    "intensity": Family("intensity slices in cells", lambda n: IntensityMoments()),
    "robust": Family("completed cells", lambda n: RobustMoments()),
}
"""The families that are tried, by name: the paper's but LFA, which is behind them in every
measurement, and those that are ahead in clean or in disturbed images (docs/assessment.md)."""

MIXES = (
    ("moments", "eigenfeatures", "pose_covariance"),
    ("moments", "projections", "log_polar", "gradient", "intensity"),
)
"""Families that are tried together: the paper's, and those that need no fitting."""


def choose_tried(names: str) -> list[str]:
    """The families that a list with commas names; all of them for ``all``.

    Raises
    ------
    InvalidInputError
        If a name is unknown, or there is none.

    Examples
    --------
    >>> choose_tried("moments, robust")
    ['moments', 'robust']
    """
    if names.strip() == "all":
        return list(FAMILIES)
    tried = [name.strip() for name in names.split(",") if name.strip()]
    if not tried or set(tried) - set(FAMILIES):
        raise InvalidInputError(
            f"families must be all or taken from {', '.join(FAMILIES)}, got {names!r}."
        )
    return tried


def title_of(family: str) -> str:
    """What people call a family, or several joined by ``+``.

    Examples
    --------
    >>> title_of("moments"), title_of("moments+log_polar")
    ('geometric moments', 'geometric moments + log-polar waves')
    """
    titles = [FAMILIES[name].title for name in family.split("+")]
    return " + ".join(titles) if len(titles) < 4 else listing(family.split("+"))


class FamilyTransformer:
    """The features of one family, or of several side by side.

    Parameters
    ----------
    family : str
        A name in `FAMILIES`; several are joined by ``+``.
    """

    def __init__(self, family: str) -> None:
        self.families = [FAMILIES[name] for name in family.split("+")]

    @property
    def is_learned(self) -> bool:
        """Whether any of the features are fitted to images."""
        return any(family.is_learned for family in self.families)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the features; after `fit`."""
        return tuple(str(name) for one in self._fitted for name in one.get_feature_names_out())

    def fit(self, images: NDArray[np.uint8], targets: Array) -> FamilyTransformer:
        """Fit the features to images and their displacements in units of the range."""
        self._fitted = [family.make(len(images)).fit(images, targets) for family in self.families]
        return self

    def transform(self, images: NDArray[np.uint8]) -> Array:
        """Features of images, (n, n_features)."""
        return np.hstack([one.transform(images) for one in self._fitted]).astype(np.float64)


@dataclass(frozen=True, eq=False)
class FamilyFeatures:
    """Features of one family, or of several together, for every image of a data set.

    Parameters
    ----------
    family : str
        Its name; several are joined by ``+``.
    values : ndarray of shape (n_images, n_features)
    names : tuple of n_features str
    """

    family: str
    values: Array
    names: tuple[str, ...]

    def of(self, images: Indices) -> FamilyFeatures:
        """Those of some of the images."""
        return replace(self, values=self.values[images])


def compute_families(
    images: NDArray[np.uint8],
    targets: Array,
    learn: Indices,
    families: Sequence[str] = tuple(FAMILIES),
    *,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> dict[str, FamilyFeatures]:
    """Features of all images by every family, fitted to those that are learned from.

    Families that cannot be had of these images, which may be too small or too few, are missing.
    """
    calls = ((images, targets, learn, family) for family in families)
    found: dict[str, FamilyFeatures] = {}
    for n_done, features in enumerate(in_processes(_compute, calls, n_jobs), start=1):
        if features is not None:
            found[features.family] = features
        if on_progress is not None:
            on_progress(n_done)
    return found


def join_families(features: Sequence[FamilyFeatures]) -> FamilyFeatures:
    """The features of several families side by side."""
    return FamilyFeatures(
        "+".join(one.family for one in features),
        np.hstack([one.values for one in features]),
        tuple(name for one in features for name in one.names),
    )


def _compute(
    images: NDArray[np.uint8], targets: Array, learn: Indices, family: str
) -> FamilyFeatures | None:
    try:
        with one_blas_thread():
            transformer = FamilyTransformer(family).fit(images[learn], targets[learn])
            return FamilyFeatures(family, transformer.transform(images), transformer.names)
    except InvalidInputError:
        return None
