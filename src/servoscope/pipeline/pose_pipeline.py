"""A pipeline from images to displacements: features and a regressor for each degree of freedom."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from servoscope.arrays import check_unmasked
from servoscope.data.splits import Split, split_images
from servoscope.errors import InvalidInputError, ModelError, ServoscopeError
from servoscope.features.catalogue import FAMILIES
from servoscope.pipeline.feature_table import FeatureTable, FittedFamily, feature_names
from servoscope.pipeline.recipe import Recipe
from servoscope.pipeline.training import Fitted, fit_all, predict_with_std
from servoscope.poses import DOFS
from servoscope.regression.registry import REGRESSORS
from servoscope.storage.model_folder import read_model, write_model
from servoscope.wording import one_line

Array = NDArray[np.float64]

KIND = "pose pipeline"
MOST_PIXELS = 2**24
"""Most pixels of an image that a saved pipeline may be for."""

_TOLERANCE = 1e-3
"""A pipeline that was saved predicts as before, up to this share of the range."""


class PosePipeline(RegressorMixin, BaseEstimator):
    """The displacement at which images were taken, each degree of freedom by a recipe of its own.

    Parameters
    ----------
    recipes : Recipe or dict of Recipe, optional
        For all degrees of freedom or by dof; a Gaussian process on geometric moments by default.
    dofs : sequence of str
        Names of the columns of the displacements.
    random_state : int
        Draws what is random in regressors, and the images that decide where `fit` is given groups.
    n_jobs : int, optional
        Processes, as joblib counts them; every number of them gives the same, bit for bit.

    Attributes
    ----------
    fitted_ : dict
        The features by family, and their names.
    regressors_ : dict of Fitted
        By dof.
    ranges_ : ndarray of shape (n_dofs,)
        Largest displacements learned from; the regressors work in shares of them.
    image_shape_ : (height, width)
    split_ : Split
        The images that trained, decided and tested.
    record_ : dict
        What is known of it, as plain JSON values: ``measured``, the RMS errors of the test images
        by dof, and what whoever made it has added.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> delta_p = rng.uniform(-1, 1, (80, 2))
    >>> y, x = np.mgrid[:16, :16] / 8 - 1
    >>> squares = (x - delta_p[:, :1, None]) ** 2 + (y - delta_p[:, 1:, None]) ** 2
    >>> images = (255 * np.exp(-2 * squares)).astype(np.uint8)
    >>> pipeline = PosePipeline(Recipe("eigenfeatures"), dofs=("tx", "ty")).fit(images, delta_p)
    >>> predicted, std = pipeline.predict(images[:3], return_std=True)
    >>> predicted.shape, std.shape, bool(np.abs(predicted - delta_p[:3]).max() < 0.1)
    ((3, 2), (3, 2), True)
    """

    def __init__(
        self,
        recipes: Recipe | Mapping[str, Recipe] | None = None,
        dofs: Sequence[str] = DOFS,
        random_state: int = 0,
        n_jobs: int | None = 1,
    ) -> None:
        self.recipes = recipes
        self.dofs = dofs
        self.random_state = random_state
        self.n_jobs = n_jobs

    def fit(
        self,
        images: ArrayLike,
        targets: ArrayLike,
        split: Split | None = None,
        groups: ArrayLike | None = None,
    ) -> Self:
        """Fit the features, then a regressor for each degree of freedom.

        Parameters
        ----------
        images : array of shape (n, height, width)
            Grey levels.
        targets : array of shape (n, n_dofs)
            Displacements in the order of `dofs`, in any unit.
        split : Split, optional
            Images that train, that decide when a network stops or how large standard deviations
            are, and that test; by default all train.
        groups : array of shape (n,), optional
            Images that are not independent of each other. Without a split a part of the groups
            decides; with one, no group may be in two of its parts.

        Raises
        ------
        InvalidInputError
            If the arrays do not belong together, a group is divided, a recipe is missing or
            names what there is not, or its features cannot be had of these images.
        """
        stack = _as_images(images)
        check_unmasked(targets, "targets")
        Y = np.asarray(targets, dtype=np.float64)
        if Y.shape != (len(stack), len(self.dofs)) or not np.isfinite(Y).all():
            raise InvalidInputError(
                f"targets must be finite and of shape ({len(stack)}, {len(self.dofs)}), for "
                f"{', '.join(self.dofs)}, got the shape {Y.shape}."
            )
        recipes = self._recipes()
        split = _resolve_split(len(stack), split, groups, self.random_state)
        ranges = np.abs(Y[split.learned]).max(axis=0)
        ranges = np.where(ranges > 0, ranges, 1.0)
        families = list(dict.fromkeys(f for recipe in recipes.values() for f in recipe.families))
        table = FeatureTable.fit(stack, Y / ranges, families, split.learned, n_jobs=self.n_jobs)
        for recipe in recipes.values():
            if not table.has(recipe.name):
                raise InvalidInputError(
                    f"The features {recipe.name} cannot be had of these {len(split.learned)} "
                    f"images of {stack.shape[2]} x {stack.shape[1]} px; take other features, or "
                    "more or larger images."
                )
        fitted = fit_all(
            table,
            Y / ranges,
            split,
            [(recipe, dof) for dof, recipe in recipes.items()],
            dofs=self.dofs,
            seed=self.random_state,
            n_jobs=self.n_jobs,
        )
        return self._adopt(table, fitted, ranges, split, stack[split.train[0]])

    @classmethod
    def from_fitted(
        cls,
        table: FeatureTable,
        fitted: Sequence[Fitted],
        ranges: Array,
        split: Split,
        sample: NDArray[Any],
        **record: Any,
    ) -> Self:
        """Join what was fitted already.

        Parameters
        ----------
        table : FeatureTable
        fitted : sequence of Fitted
            One a dof, on that table; their order is that of the predictions.
        ranges : ndarray of shape (n_dofs,)
            What the targets of `fitted` were divided by.
        split : Split
        sample : ndarray of shape (height, width)
            An image.
        **record
            More of `record_`.
        """
        pipeline = cls({one.dof: one.recipe for one in fitted}, tuple(one.dof for one in fitted))
        pipeline._adopt(table, fitted, ranges, split, sample)
        pipeline.record_ |= record
        return pipeline

    @overload
    def predict(self, images: ArrayLike, return_std: Literal[False] = False) -> Array: ...
    @overload
    def predict(self, images: ArrayLike, return_std: Literal[True]) -> tuple[Array, Array]: ...
    def predict(self, images: ArrayLike, return_std: bool = False) -> Array | tuple[Array, Array]:
        """The displacements at which images were taken.

        Parameters
        ----------
        images : array of shape (n, height, width)
        return_std : bool

        Returns
        -------
        displacements : ndarray of shape (n, n_dofs)
            In the unit of the targets.
        std : ndarray of shape (n, n_dofs)
            Only if `return_std`: their standard deviations.

        Raises
        ------
        InvalidInputError
            If the images are not of the size of those of `fit`.
        """
        check_is_fitted(self)
        stack = _as_images(images)
        if stack.shape[1:] != self.image_shape_:
            raise InvalidInputError(
                "The images must be of {} x {} px (height x width), as those learned from, got "
                "{} x {}; resize them.".format(*self.image_shape_, *stack.shape[1:])
            )
        means, deviations = self.predict_from(self.compute_features(stack))
        return (means, deviations) if return_std else means

    def compute_features(self, images: NDArray[Any]) -> Array:
        """The features of images of shape (n, height, width) that any of the recipes takes."""
        return np.hstack([one.transform(images) for one in self.fitted_.values()])

    def predict_from(self, X: Array) -> tuple[Array, Array]:
        """Displacements and their standard deviations from what `compute_features` returns."""
        predicted = [
            predict_with_std(one.regressor, X[:, one.columns], one.validation_rms)
            for one in self.regressors_.values()
        ]
        means, deviations = zip(*predicted, strict=True)
        return np.column_stack(means) * self.ranges_, np.column_stack(deviations) * self.ranges_

    def describe(self) -> dict[str, Any]:
        """What it is made of and what is known of it, as plain JSON values."""
        check_is_fitted(self)
        names = self._names()
        return {
            "image_shape": list(self.image_shape_),
            "n_images": {
                part: len(getattr(self.split_, part)) for part in ("train", "validation", "test")
            },
            "dofs": {
                dof: {
                    "recipe": one.recipe.to_json(),
                    "features": [names[i] for i in one.columns],
                    "range": float(scale),
                }
                for (dof, one), scale in zip(self.regressors_.items(), self.ranges_, strict=True)
            },
            **self.record_,
        }

    def to_arrays(self) -> dict[str, NDArray]:
        """All of it as plain arrays of numbers, with flat names.

        Raises
        ------
        InvalidInputError
            If its features or regressors are objects that have no name, or that cannot be made
            arrays themselves.
        """
        check_is_fitted(self)
        arrays: dict[str, NDArray] = {
            "sample": self.sample_,
            "predicted": np.stack(self.predict(self.sample_[None], return_std=True)),
            "ranges": self.ranges_,
            **{f"split.{part}": indices for part, indices in vars(self.split_).items()},
        }
        families: dict[str, list[str]] = {}
        for name, one in self.fitted_.items():
            if name not in FAMILIES:
                raise InvalidInputError(
                    f"The features {name} have no name by which a saved pipeline finds them again;"
                    " add them to the entry points of a package, as servoscope.features."
                )
            families[name] = list(one.names)
            arrays |= _prefixed(f"features.{name}", _transformer_arrays(name, one))
        dofs = {}
        for dof, fitted in self.regressors_.items():
            dofs[dof] = {"recipe": fitted.recipe.to_json(), "validation_rms": fitted.validation_rms}
            arrays[f"dofs.{dof}.columns"] = fitted.columns
            if not hasattr(fitted.regressor, "to_arrays"):
                raise InvalidInputError(
                    f"The regressor {fitted.recipe.regressor!r} cannot be saved: it needs "
                    "to_arrays and from_arrays."
                )
            arrays |= _prefixed(f"dofs.{dof}.regressor", fitted.regressor.to_arrays())
        header = {"families": families, "dofs": dofs, "record": self.record_}
        text = json.dumps(header, allow_nan=True).encode()
        return {"header": np.frombuffer(text, np.uint8), **arrays}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """The pipeline that `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If arrays are missing or do not belong together, or what they make does not predict
            for its sample image what it did when it was saved.
        """
        try:
            pipeline = cls._read({name: np.asarray(array) for name, array in arrays.items()})
        except ServoscopeError as error:
            raise InvalidInputError(str(error)) from error
        except Exception as error:  # arrays that do not belong together fail in ways of their own
            raise InvalidInputError(
                f"The arrays are of no pose pipeline ({type(error).__name__}: {one_line(error)})."
            ) from error
        return pipeline

    def save(self, folder: str | PathLike[str], *, force: bool = False) -> None:
        """Write it to a folder, whole or not at all; nothing in it is pickled.

        Raises
        ------
        FolderExistsError
            If the folder holds a model and `force` is not set, or anything else.
        InvalidInputError
            As `to_arrays`.
        """
        write_model(folder, {"kind": KIND, **self.describe()}, self.to_arrays(), force=force)

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> Self:
        """The pipeline in a folder.

        Raises
        ------
        ModelError
            If there is none, or it is damaged or not to be trusted.
        """
        header, arrays = read_model(folder)
        if header.get("kind") != KIND:
            raise ModelError(
                f"{folder} holds a model of another kind than a pose pipeline; name the folder "
                "models/pipeline of an assessment."
            )
        try:
            return cls.from_arrays(arrays)
        except InvalidInputError as error:
            raise ModelError(f"{folder} cannot be used: {one_line(error)}") from error

    def _recipes(self) -> dict[str, Recipe]:
        if self.recipes is None or isinstance(self.recipes, Recipe):
            return dict.fromkeys(self.dofs, self.recipes or Recipe())
        if set(self.recipes) != set(self.dofs):
            raise InvalidInputError(
                f"recipes must be of {', '.join(self.dofs)}, got {', '.join(self.recipes)}."
            )
        return {dof: self.recipes[dof] for dof in self.dofs}

    def _adopt(
        self,
        table: FeatureTable,
        fitted: Sequence[Fitted],
        ranges: Array,
        split: Split,
        sample: NDArray[Any],
    ) -> Self:
        used = {family for one in fitted for family in one.recipe.family_names}
        kept = np.flatnonzero([family in used for family in table.families])
        place = {int(column): i for i, column in enumerate(kept)}
        self.fitted_ = {name: one for name, one in table.fitted.items() if name in used}
        self.regressors_ = {
            one.dof: one.with_columns([place[int(column)] for column in one.columns])
            for one in fitted
        }
        self.ranges_, self.split_ = np.asarray(ranges, dtype=np.float64), split
        self.sample_, self.image_shape_ = np.asarray(sample), tuple(map(int, sample.shape))
        self.record_: dict[str, Any] = {}
        if len(split.test):
            measured = {one.dof: one.test_rms * r for one, r in zip(fitted, ranges, strict=True)}
            self.record_["measured"] = measured
        return self

    def _names(self) -> list[str]:
        return [name for one in self.fitted_.values() for name in one.names]

    @classmethod
    def _read(cls, arrays: Mapping[str, NDArray]) -> Self:
        header = json.loads(np.asarray(arrays["header"], dtype=np.uint8).tobytes())
        sample = arrays["sample"]
        if sample.ndim != 2 or not 0 < sample.size <= MOST_PIXELS:
            raise InvalidInputError(f"The sample image is of shape {sample.shape}.")
        fitted_families = {
            str(name): _read_family(str(name), names, sample, _part(arrays, f"features.{name}."))
            for name, names in header["families"].items()
        }
        n_features = sum(len(one.names) for one in fitted_families.values())
        fitted = []
        for dof, values in header["dofs"].items():
            recipe = Recipe.from_json(values["recipe"])
            columns = arrays[f"dofs.{dof}.columns"].astype(np.intp)
            if columns.ndim != 1 or columns.min() < 0 or columns.max() >= n_features:
                raise InvalidInputError(f"The recipe of {dof!r} takes features that there are not.")
            kind: Any = REGRESSORS[recipe.regressor]
            regressor = kind.from_arrays(_part(arrays, f"dofs.{dof}.regressor."))
            rms = float(values["validation_rms"])
            fitted.append(Fitted(recipe, str(dof), columns, regressor, rms, float("nan")))
        pipeline = cls({one.dof: one.recipe for one in fitted}, tuple(one.dof for one in fitted))
        pipeline.fitted_ = fitted_families
        pipeline.regressors_ = {one.dof: one for one in fitted}
        pipeline.ranges_ = arrays["ranges"].astype(np.float64)
        pipeline.split_ = Split(
            *(arrays[f"split.{part}"].astype(np.intp) for part in ("train", "validation", "test"))
        )
        pipeline.sample_ = sample
        pipeline.image_shape_ = tuple(map(int, sample.shape))
        pipeline.record_ = dict(header["record"])
        again = np.stack(pipeline.predict(sample[None], return_std=True))
        if not np.allclose(
            again / pipeline.ranges_,
            arrays["predicted"] / pipeline.ranges_,
            rtol=_TOLERANCE,
            atol=_TOLERANCE,
        ):
            raise InvalidInputError(
                "The pipeline does not predict what it did when it was saved; make it again."
            )
        return pipeline


def _as_images(images: ArrayLike) -> NDArray[Any]:
    check_unmasked(images, "images")
    stack = np.asarray(images)
    if stack.ndim != 3 or not stack.size or stack.dtype.kind not in "uif":
        raise InvalidInputError(
            f"images must be numbers of shape (n, height, width), got {stack.dtype} of shape "
            f"{stack.shape}."
        )
    return stack


def _resolve_split(n: int, split: Split | None, groups: ArrayLike | None, seed: int) -> Split:
    nothing = np.arange(0)
    if split is None and groups is None:
        return Split(np.arange(n), nothing, nothing)
    if split is None:
        drawn = split_images(n, "honest", seed, groups=groups)
        return Split(np.sort(np.concatenate([drawn.train, drawn.test])), drawn.validation, nothing)
    parts = (split.train, split.validation, split.test)
    if groups is not None:
        labels = np.asarray(groups)
        if labels.shape != (n,):
            raise InvalidInputError(
                f"groups must be {n} values, one an image, got the shape {labels.shape}."
            )
        held = [set(labels[part].tolist()) for part in parts]
        if held[0] & held[1] or (held[0] | held[1]) & held[2]:
            raise InvalidInputError(
                "A group of images is in two parts of the split; split by whole groups."
            )
    return split


def _transformer_arrays(name: str, one: FittedFamily) -> dict[str, NDArray]:
    if hasattr(one.transformer, "to_arrays"):
        return dict(one.transformer.to_arrays())
    if one.family.is_learned:
        raise InvalidInputError(
            f"The features {name} are fitted to images and cannot be saved: they need to_arrays "
            "and from_arrays."
        )
    return {}


def _read_family(
    name: str, names: Sequence[str], sample: NDArray[Any], arrays: dict[str, NDArray]
) -> FittedFamily:
    family = FAMILIES[name]
    transformer = family.make(2)
    if arrays:
        transformer = type(transformer).from_arrays(arrays)
    else:
        transformer.fit(sample[None], np.zeros((1, len(DOFS))))
    found = FittedFamily(family, transformer, feature_names(name, transformer, len(names)))
    if list(found.names) != list(names):
        raise InvalidInputError(f"The features {name} are others than when they were saved.")
    return found


def _prefixed(prefix: str, arrays: Mapping[str, Any]) -> dict[str, NDArray]:
    """Arrays of numbers by longer names; names of features are left out, being known."""
    found = {name: np.asarray(array) for name, array in arrays.items()}
    return {f"{prefix}.{name}": a for name, a in found.items() if a.dtype.kind in "biuf"}


def _part(arrays: Mapping[str, NDArray], prefix: str) -> dict[str, NDArray]:
    return {name.removeprefix(prefix): a for name, a in arrays.items() if name.startswith(prefix)}
