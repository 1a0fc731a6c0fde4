"""Regressors side by side: error, time, and whether 95 % of their intervals hold the target."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.arrays import as_numbers
from servoscope.data.splits import Split
from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS
from servoscope.processes import in_processes, one_blas_thread
from servoscope.regression.registry import REGRESSORS, make_regressor
from servoscope.regression.samples import Array, Samples

INTERVAL = 1.959963984540054
"""Half the width of the interval that holds 95 % of a normal variable, in standard deviations."""


@dataclass(frozen=True)
class RegressorScore:
    """How one regressor tells one degree of freedom.

    Parameters
    ----------
    regressor, dof : str
    test_rms : float
        In the unit of the target, like the width.
    coverage : float
        Share of the test samples that lie in their 95 % interval.
    interval_width : float
        Mean width of that interval.
    fit_seconds : float
        Processor time of one BLAS thread. Scores that differ in it alone are equal.
    """

    regressor: str
    dof: str
    test_rms: float
    coverage: float
    interval_width: float
    fit_seconds: float = field(compare=False)


def compare_regressors(
    X: ArrayLike,
    Y: ArrayLike,
    split: Split,
    regressors: Sequence[str] | Mapping[str, Any] = tuple(REGRESSORS),
    *,
    columns: Mapping[str, ArrayLike] | None = None,
    dofs: Sequence[str] = DOFS,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> list[RegressorScore]:
    """Fit each regressor to each degree of freedom and measure it on the test samples.

    Each gets the training and the validation samples; what it does with the latter is its own
    affair (see `Regressor`). Under the paper's protocol, where the test samples are the validation
    samples, that would be to learn from the test samples, and is refused.

    Parameters
    ----------
    X : array of shape (n, n_features)
    Y : array of shape (n, n_dofs)
        Targets in the order of `dofs`, in any unit.
    split : Split
    regressors : sequence of str, or dict of estimators by name
        Names of `REGRESSORS`, or estimators of the same interface.
    columns : dict of sequences of int, optional
        The columns of X for each dof; all by default.
    dofs : sequence of str
    n_jobs : int, optional
        Processes, as joblib counts them; the scores do not depend on it.
    on_progress : callable, optional
        Called with the number of fits finished.

    Returns
    -------
    list of RegressorScore
        By regressor, then by dof.

    Raises
    ------
    InvalidInputError
        If a regressor is unknown, the arrays do not belong together or hold NaN or infinity, or
        test samples are among the others.

    Examples
    --------
    >>> from servoscope.data.splits import split_images
    >>> X = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    >>> split = split_images(100)
    >>> scores = compare_regressors(X, X**3, split, ["kernel_ridge"], dofs=("a", "b"), n_jobs=1)
    >>> [(score.regressor, score.dof, score.test_rms < 0.05) for score in scores]
    [('kernel_ridge', 'a', True), ('kernel_ridge', 'b', True)]
    """
    X, Y = _check(X, Y, split, dofs)
    if not isinstance(regressors, Mapping):
        regressors = {name: name for name in regressors}
    templates = {name: make_regressor(regressor) for name, regressor in regressors.items()}
    everything = np.arange(X.shape[1])
    chosen = {
        dof: everything if columns is None else np.asarray(columns[dof], dtype=np.intp)
        for dof in dofs
    }
    keys = [(name, dof) for name in templates for dof in dofs]
    calls = (
        (templates[name], *_parts(X[:, chosen[dof]], Y[:, i], split))
        for name in templates
        for i, dof in enumerate(dofs)
    )
    return list(_scores(keys, in_processes(_measure, calls, n_jobs, batch_size=1), on_progress))


def _scores(
    keys: Sequence[tuple[str, str]],
    measured: Iterator[tuple[float, ...]],
    on_progress: Callable[[int], object] | None,
) -> Iterator[RegressorScore]:
    for n_done, (key, figures) in enumerate(zip(keys, measured, strict=True), start=1):
        if on_progress is not None:
            on_progress(n_done)
        yield RegressorScore(*key, *figures)


def _measure(
    template: Any, training: Samples, validation: Samples, test: Samples
) -> tuple[float, float, float, float]:
    """Test RMS, coverage, width and seconds of a regressor fitted to one dof."""
    with one_blas_thread():
        regressor = make_regressor(template)
        start = time.process_time()
        regressor.fit(*training, *validation)
        seconds = time.process_time() - start
        mean, deviation = regressor.predict(test.X, return_std=True)
    errors = np.abs(mean - test.y)
    half_width = INTERVAL * deviation
    return (
        float(np.sqrt(np.mean(errors**2))),
        float(np.mean(errors <= half_width)),
        float(2 * np.mean(half_width)),
        seconds,
    )


def _parts(X: Array, y: Array, split: Split) -> tuple[Samples, Samples, Samples]:
    train, validation, test = (
        Samples(X[rows], y[rows]) for rows in (split.train, split.validation, split.test)
    )
    return train, validation, test


def _check(
    X: ArrayLike, Y: ArrayLike, split: Split, dofs: Sequence[str]
) -> tuple[Array, NDArray[np.float64]]:
    X, Y = as_numbers(X, "X"), as_numbers(Y, "Y")
    if X.ndim != 2 or Y.shape != (len(X), len(dofs)):
        raise InvalidInputError(
            f"X and Y must be of shape (n, n_features) and (n, {len(dofs)}), "
            f"got {X.shape} and {Y.shape}."
        )
    if not (np.isfinite(X).all() and np.isfinite(Y).all()):
        raise InvalidInputError("X and Y must be finite, but hold NaN or infinity.")
    if np.isin(split.test, split.learned).any():
        raise InvalidInputError(
            "Test samples are among those that train or decide; compare regressors under the "
            "honest protocol."
        )
    return X, Y
