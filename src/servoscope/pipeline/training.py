"""The one loop that fits regressors: recipes and degrees of freedom, side by side."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import has_fit_parameter

from servoscope.arrays import as_numbers, check_scale
from servoscope.data.splits import Split
from servoscope.errors import InvalidInputError
from servoscope.kernels import find_repeats
from servoscope.pipeline.feature_table import FeatureTable
from servoscope.pipeline.recipe import Recipe
from servoscope.poses import DOFS
from servoscope.processes import in_processes, one_blas_thread
from servoscope.regression.registry import make_regressor

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

INTERVAL = 1.959963984540054
"""Half the width of the interval that holds 95 % of a normal variable, in standard deviations."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A regressor fitted to a recipe's features for one degree of freedom, and its errors.

    Parameters
    ----------
    recipe : Recipe
    dof : str
    columns : ndarray
        Columns of the feature table that it takes.
    regressor : object
        Fitted.
    validation_rms, test_rms : float
        RMS errors in the unit of the targets; NaN where there are no such images.
    coverage : float
        Share of the test images that lie in their 95 % interval.
    interval_width : float
        Mean width of that interval.
    seconds : float
        Processor time of fitting.
    errors : ndarray of shape (n_test,)
        Prediction less target of each test image.
    """

    recipe: Recipe
    dof: str
    columns: Indices
    regressor: Any = field(repr=False)
    validation_rms: float
    test_rms: float
    coverage: float = float("nan")
    interval_width: float = float("nan")
    seconds: float = float("nan")
    errors: Array = field(default_factory=lambda: np.empty(0), repr=False)

    def with_columns(self, columns: ArrayLike) -> Fitted:
        """The same on another table, in which its features have these columns."""
        return replace(self, columns=np.asarray(columns, dtype=np.intp))

    def best_features(self, table: FeatureTable, n_best: int = 5) -> tuple[str, ...]:
        """Names of the features whose spread is most length scales wide; of a kernel only."""
        kernel = getattr(self.regressor, "kernel_", None)
        if kernel is None or len(np.atleast_1d(kernel.length_scales)) != len(self.columns):
            return tuple(table.names[i] for i in self.columns[:n_best])
        say = table.values[np.ix_(table.learn, self.columns)].std(axis=0) / kernel.length_scales
        order = np.argsort(-say, kind="stable")[:n_best]
        return tuple(table.names[self.columns[i]] for i in order if say[i] > 0)


def fit_all(
    table: FeatureTable,
    targets: ArrayLike,
    split: Split,
    jobs: Sequence[tuple[Recipe, str]],
    *,
    dofs: Sequence[str] = DOFS,
    seed: int = 0,
    poses: ArrayLike | None = None,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> list[Fitted]:
    """Fit a regressor for every recipe and degree of freedom, in processes of one BLAS thread.

    Parameters
    ----------
    table : FeatureTable
    targets : array of shape (n_images, n_dofs)
        In any unit.
    split : Split
        The validation images stop the training of networks, and set the size of the standard
        deviations of others, which then learn from them as well. There may be none, and no test
        images either.
    jobs : sequence of (Recipe, str)
    dofs : sequence of str
        Names of the columns of `targets`.
    seed : int
        With the dof and the columns it draws what is random in a regressor, unless the settings
        of the recipe have a ``random_state``. A job's place in the list does not matter.
    poses : array of shape (n_images,), optional
        Images of equal value are repeated shots of one pose, which count as one. By default they
        are found (`servoscope.kernels.find_repeats`).
    n_jobs : int, optional
        Processes, as joblib counts them; every number of them gives the same, bit for bit.
    on_progress : callable, optional
        Called with the number of regressors fitted.

    Returns
    -------
    list of Fitted
        In the order of the jobs.

    Raises
    ------
    InvalidInputError
        If the table and the targets do not belong together or are not finite, a recipe names
        features that the table does not have, or less than two images train.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    >>> table = FeatureTable(X, ("a", "b"), ("own", "own"))
    >>> split = Split(np.arange(60), np.arange(60, 80), np.arange(80, 100))
    >>> recipe = Recipe("own", columns=("a",), regressor="kernel_ridge")
    >>> fitted = fit_all(table, X**3, split, [(recipe, "a")], dofs=("a", "b"), n_jobs=1)
    >>> fitted[0].columns, fitted[0].test_rms < 0.05
    (array([0]), True)
    """
    X, Y = table.values, as_numbers(targets, "targets")
    _check(X, Y, split, dofs)
    learned = np.concatenate([split.train, split.validation])
    members = find_repeats(X[learned], Y[learned]) if poses is None else np.asarray(poses)[learned]
    calls = []
    for recipe, dof in jobs:
        columns = table.columns(recipe.for_dof(dof))
        own = zlib.crc32(f"{seed} {dof} {columns.tolist()}".encode())
        calls.append((X, Y[:, list(dofs).index(dof)], split, members, recipe, dof, columns, own))
    found: list[Fitted] = []
    for fitted in in_processes(_fit, calls, n_jobs, batch_size=1):
        found.append(fitted)
        if on_progress is not None:
            on_progress(len(found))
    return found


def predict_with_std(regressor: Any, X: Array, otherwise: float) -> tuple[Array, Array]:
    """What a regressor predicts, and its standard deviation, or the given one if it has none."""
    if "return_std" in signature(regressor.predict).parameters:
        mean, deviation = regressor.predict(X, return_std=True)
        return np.asarray(mean, dtype=np.float64), np.asarray(deviation, dtype=np.float64)
    mean = np.asarray(regressor.predict(X), dtype=np.float64).reshape(len(X))
    return mean, np.full(len(X), otherwise)


def _fit(
    X: Array,
    y: Array,
    split: Split,
    members: Indices,
    recipe: Recipe,
    dof: str,
    columns: Indices,
    seed: int,
) -> Fitted:
    with one_blas_thread():
        regressor = _prepared(recipe, seed)
        start = time.process_time()
        _learn(regressor, X[:, columns], y, split, members)
        seconds = time.process_time() - start
        validation = _errors(regressor, X, y, columns, split.validation, 0.0)[0]
        validation_rms = float(np.sqrt(np.mean(validation**2))) if len(validation) else np.nan
        error, deviation = _errors(regressor, X, y, columns, split.test, validation_rms)
    half_width = INTERVAL * deviation
    is_tested = len(error) > 0
    return Fitted(
        recipe,
        dof,
        columns,
        regressor,
        validation_rms,
        float(np.sqrt(np.mean(error**2))) if is_tested else np.nan,
        float(np.mean(np.abs(error) <= half_width)) if is_tested else np.nan,
        float(2 * np.mean(half_width)) if is_tested else np.nan,
        seconds,
        error,
    )


def _prepared(recipe: Recipe, seed: int) -> Any:
    """A new regressor with the settings of the recipe."""
    regressor = make_regressor(recipe.regressor)
    settings = dict(recipe.settings)
    if hasattr(regressor, "get_params") and "random_state" in regressor.get_params():
        settings.setdefault("random_state", seed)
    return regressor.set_params(**settings) if settings else regressor


def _learn(regressor: Any, Z: Array, y: Array, split: Split, members: Indices) -> None:
    train, validation = split.train, split.validation
    options: dict[str, Any] = {}
    if len(validation) and has_fit_parameter(regressor, "X_val"):
        options = {"X_val": Z[validation], "y_val": y[validation]}
    elif len(validation):
        train = np.concatenate([train, validation])
    if has_fit_parameter(regressor, "poses"):
        options["poses"] = members if len(validation) else members[: len(train)]
    regressor.fit(Z[train], y[train], **options)


def _errors(
    regressor: Any, X: Array, y: Array, columns: Indices, images: Indices, otherwise: float
) -> tuple[Array, Array]:
    if not len(images):
        return np.empty(0), np.empty(0)
    mean, deviation = predict_with_std(regressor, X[np.ix_(images, columns)], otherwise)
    return mean - y[images], deviation


def _check(X: Array, Y: Array, split: Split, dofs: Sequence[str]) -> None:
    if X.ndim != 2 or Y.shape != (len(X), len(dofs)):
        raise InvalidInputError(
            f"Features and targets must be of shape (n, n_features) and (n, {len(dofs)}), got "
            f"{X.shape} and {Y.shape}."
        )
    if not (np.isfinite(X).all() and np.isfinite(Y).all()):
        raise InvalidInputError("Features and targets must be finite, but hold NaN or infinity.")
    for values, name in ((X, "Features"), (Y, "Targets")):
        if values.size:
            check_scale(values, name)
    if len(split.train) < 2:
        raise InvalidInputError(f"At least two images must train, got {len(split.train)}.")
    rows = np.concatenate([split.train, split.validation, split.test])
    if rows.min() < 0 or rows.max() >= len(X):
        raise InvalidInputError(
            f"The images of a split must be from 0 to {len(X) - 1}, got {rows.min()} to "
            f"{rows.max()}."
        )
