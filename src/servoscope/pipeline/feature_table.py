"""Features of the images of a data set, fitted to those that may be learned from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError, PluginError, ServoscopeError
from servoscope.features.catalogue import Family, resolve_families
from servoscope.features.image_transformer import LearnedProjection
from servoscope.features.normalised_images import span_coordinates
from servoscope.kernels import find_repeats
from servoscope.pipeline.recipe import Recipe
from servoscope.processes import in_processes, one_blas_thread
from servoscope.selection.forecast import Fold, cut_folds
from servoscope.wording import one_line

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Images = NDArray[np.uint8]

N_FOLDS = 3
"""Parts of the images without which learned features are fitted anew, for their forecast."""


@dataclass(frozen=True, eq=False)
class FittedFamily:
    """A family fitted to images.

    Parameters
    ----------
    family : Family
    transformer : object
        Fitted.
    names : tuple of str
        Of the features.
    """

    family: Family
    transformer: Any = field(repr=False)
    names: tuple[str, ...]

    @classmethod
    def fit(
        cls, name: str, family: Family, images: Images, targets: Array, n_learned: int | None = None
    ) -> FittedFamily:
        """Fit a family, as it is made for so many images, to images and their displacements."""
        with _named(name):
            transformer = family.make(n_learned or len(images))
            transformer.fit(images, targets)
            n_features = _checked(name, transformer.transform(images[:1]), 1).shape[1]
            return cls(family, transformer, feature_names(name, transformer, n_features))

    def transform(self, images: Images) -> Array:
        """Features of images, (n, n_features).

        Raises
        ------
        PluginError
            If the transformer fails, or gives no finite numbers, one row an image.
        """
        with _named(self.family.title):
            values = _checked(self.family.title, self.transformer.transform(images), len(images))
        if values.shape[1] != len(self.names):
            raise PluginError(
                f"The features {self.family.title!r} were {len(self.names)} when they were "
                f"fitted, but are {values.shape[1]} of these images."
            )
        return values


@dataclass(frozen=True, eq=False)
class FeatureTable:
    """Features of the images of a data set, a column each.

    Parameters
    ----------
    values : ndarray of shape (n_images, n_features)
    names : tuple of n_features str
    families : tuple of n_features str
        The family of each column.
    learn : ndarray
        The images that the features were fitted to.
    fitted : dict of FittedFamily
        By family, where they are at hand.
    folds : tuple of Fold
        Features of the images in `learn`, where those that are learned were fitted anew without
        each part of these; none if none are learned.
    """

    values: Array
    names: tuple[str, ...]
    families: tuple[str, ...]
    learn: Indices = field(default_factory=lambda: np.arange(0), repr=False)
    fitted: Mapping[str, FittedFamily] = field(default_factory=dict, repr=False)
    folds: tuple[Fold, ...] = field(default=(), repr=False)

    @classmethod
    def fit(
        cls,
        images: Images,
        targets: Array,
        families: Sequence[object],
        learn: Indices | None = None,
        *,
        groups: Indices | None = None,
        n_folds: int = 0,
        known: FeatureTable | None = None,
        n_jobs: int | None = -1,
        on_progress: Callable[[int], object] | None = None,
    ) -> FeatureTable:
        """Features of all images by several families, fitted to those that may be learned from.

        Families that cannot be had of these images, which may be too small or too few, are missing.

        Parameters
        ----------
        images : ndarray of shape (n_images, height, width), uint8
        targets : ndarray of shape (n_images, n_targets)
            Displacements.
        families : sequence of str or transformer
        learn : ndarray, optional
            Images that may be learned from; all by default.
        groups : ndarray of shape (n_images,), optional
            Images that belong together are in one part of the folds.
        n_folds : int
            Parts for a forecast of learned features.
        known : FeatureTable, optional
            Of the same images and displacements: what it has need not be computed again, unless
            it was fitted to others than those in `learn`.
        n_jobs : int, optional
            Processes, as joblib counts them.
        on_progress : callable, optional
            Called with the number of `n_steps` done.

        Raises
        ------
        InvalidInputError
            If a family is unknown, or none of them can be had.
        """
        resolved = resolve_families(families)
        learn = np.arange(len(images)) if learn is None else np.asarray(learn, dtype=np.intp)
        groups = None if groups is None else groups[learn]
        parts = cut_folds(targets[learn], groups, n_folds) if n_folds else []
        refitted = _refitted_together(resolved) if parts else []
        there = {} if known is None else known._usable(resolved, learn)
        calls: list[tuple[Any, ...]]
        calls = [(images, targets, learn, together, parts) for together in refitted]
        calls += [
            (images, targets, learn, {name: family}, None)
            for name, family in resolved.items()
            if name not in there
        ]
        found: list[Any] = []
        for one in in_processes(_compute, calls, n_jobs, batch_size=1):
            found.append(one)
            if on_progress is not None:
                on_progress(len(found))
        computed = there | {name: one for of in found[len(refitted) :] for name, one in of.items()}
        computed = {name: computed[name] for name in resolved}
        again = {name: one for of in found[: len(refitted)] for name, one in of.items()}
        table = _joined(computed, again, learn, parts)
        if table is None:
            raise InvalidInputError(
                f"None of the families can be had of these {len(learn)} images of "
                f"{images.shape[2]} x {images.shape[1]} px; try other families or larger images."
            )
        return table

    @staticmethod
    def n_steps(families: Sequence[object], n_folds: int = 0) -> int:
        """How many steps `fit` takes."""
        known = resolve_families(families)
        return len(known) + (len(_refitted_together(known)) if n_folds else 0)

    def has(self, features: str) -> bool:
        """Whether all of some families joined by ``+`` are in it."""
        return set(features.split("+")) <= set(self.families)

    def poses(self, targets: Array) -> Indices:
        """The pose of each image learned from, -1 of others; images of equal value are its shots.

        Parameters
        ----------
        targets : ndarray of shape (n_images, n_targets)
            Displacements.
        """
        poses = np.full(len(self.values), -1)
        with one_blas_thread():
            poses[self.learn] = find_repeats(self.values[self.learn], targets[self.learn])
        return poses

    def _usable(
        self, families: Mapping[str, Family], learn: Indices
    ) -> dict[str, tuple[Array, FittedFamily]]:
        """Features by family that are as good for images to learn from as they are."""
        is_same = np.array_equal(self.learn, learn)
        return {
            name: (self.values[:, [one == name for one in self.families]], self.fitted[name])
            for name, family in families.items()
            if name in self.fitted and (is_same or not family.is_learned)
        }

    def is_learned(self, recipe: Recipe) -> bool:
        """Whether any of a recipe's features are fitted to images."""
        return any(self.fitted[name].family.is_learned for name in recipe.family_names)

    def columns(self, recipe: Recipe) -> Indices:
        """The columns that a recipe takes, in its order.

        Raises
        ------
        InvalidInputError
            If the table has none of them.
        """
        own = recipe.family_names
        member = [i for i, family in enumerate(self.families) if family in own]
        if recipe.columns:
            member = [
                i
                for pattern in recipe.columns
                for i in member
                if self.names[i] == pattern or fnmatchcase(self.names[i], pattern)
            ]
        if not member:
            raise InvalidInputError(
                f"The recipe takes {', '.join(recipe.columns) or 'all'} of {recipe.name}, but "
                f"there are only {', '.join(dict.fromkeys(self.families)) or 'no features'}."
            )
        return np.array(member, dtype=np.intp)


def _refitted_together(known: Mapping[str, Family]) -> list[dict[str, Family]]:
    """The learned families in sets that are fitted anew in one go: all projections, and others."""
    learned = {name: family for name, family in known.items() if family.is_learned}
    linear = {name: f for name, f in learned.items() if isinstance(f.make(2), LearnedProjection)}
    others = [{name: family} for name, family in learned.items() if name not in linear]
    return [linear, *others] if linear else others


def _joined(
    computed: Mapping[str, tuple[Array, FittedFamily] | None],
    again: Mapping[str, Any],
    learn: Indices,
    parts: list[Indices],
) -> FeatureTable | None:
    """The table of the families that were found, side by side."""
    there = {
        name: found for name, found in computed.items() if found and again.get(name, ()) is not None
    }
    if not there:
        return None
    folds = [
        Fold(
            part,
            np.hstack(
                [again[name][i] if name in again else one[0][learn] for name, one in there.items()]
            ),
        )
        for i, part in enumerate(parts)
    ]
    return FeatureTable(
        np.hstack([values for values, _ in there.values()]),
        tuple(feature for _, one in there.values() for feature in one.names),
        tuple(name for name, (_, one) in there.items() for _ in one.names),
        learn,
        {name: one for name, (_, one) in there.items()},
        tuple(folds) if set(again) & set(there) else (),
    )


def feature_names(family: str, transformer: object, n_features: int) -> tuple[str, ...]:
    """The names that a fitted transformer gives its features, or else their numbers."""
    if hasattr(transformer, "get_feature_names_out"):
        names = tuple(map(str, transformer.get_feature_names_out()))
        if len(names) == n_features:
            return names
    return tuple(f"{family}_{i:02d}" for i in range(n_features))


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Say which features failed, in whatever way those of others do."""
    try:
        yield
    except ServoscopeError:
        raise
    except Exception as error:
        raise PluginError(
            f"The features {name!r} failed ({type(error).__name__}: {one_line(error)})."
        ) from error


def _checked(name: str, values: object, n_images: int) -> Array:
    try:
        table = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PluginError(f"The features {name!r} are no numbers ({error}).") from error
    if table.ndim != 2 or len(table) != n_images or not table.shape[1]:
        raise PluginError(
            f"The features {name!r} must be one row an image, ({n_images}, n_features), got "
            f"{table.shape}."
        )
    if not np.isfinite(table).all():
        raise PluginError(f"The features {name!r} hold NaN or infinity.")
    return table


def _compute(
    images: Images,
    targets: Array,
    learn: Indices,
    families: Mapping[str, Family],
    parts: Sequence[Indices] | None,
) -> dict[str, Any]:
    """Features of all images by family, and what made them; None where they cannot be had.

    With parts, a list of the features of the images learned from, fitted without each part.
    """
    with one_blas_thread():
        if parts is None:
            return {name: _fit_one(images, targets, learn, name, f) for name, f in families.items()}
        stack: NDArray[Any] = images[learn]
        Y = targets[learn]
        if isinstance(next(iter(families.values())).make(2), LearnedProjection):
            stack = span_coordinates(stack.reshape(len(stack), -1))[:, None]
        return {name: _refit(stack, Y, name, family, parts) for name, family in families.items()}


def _fit_one(
    images: Images, targets: Array, learn: Indices, name: str, family: Family
) -> tuple[Array, FittedFamily] | None:
    try:
        fitted = FittedFamily.fit(name, family, images[learn], targets[learn])
        return fitted.transform(images), fitted
    except InvalidInputError:
        return None


def _refit(
    images: NDArray[Any], targets: Array, name: str, family: Family, parts: Sequence[Indices]
) -> list[Array] | None:
    features = []
    try:
        for part in parts:
            used = np.delete(np.arange(len(images)), part)
            fitted = FittedFamily.fit(name, family, images[used], targets[used], len(images))
            features.append(fitted.transform(images))
    except InvalidInputError:
        return None
    return features
