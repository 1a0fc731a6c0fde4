"""One regressor and one subset of the features for each degree of freedom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.utils.validation import check_is_fitted, has_fit_parameter, validate_data

from servoscope.arrays import check_unmasked
from servoscope.errors import InvalidInputError
from servoscope.kernels import find_repeats
from servoscope.poses import DOFS
from servoscope.regression.registry import (
    make_regressor,
    regressor_as_arrays,
    regressor_from_arrays,
)
from servoscope.regression.samples import Samples

Array = NDArray[np.float64]
Columns = Sequence[int] | Sequence[str]


class PoseRegressor(RegressorMixin, BaseEstimator):
    """The pose displacement, each degree of freedom by a regressor on features of its own.

    Parameters
    ----------
    subsets : dict of sequences of int or str, optional
        For each dof the features it is told from, by column or by name; all of them by default.
    regressor : str or estimator
        A name of `REGRESSORS`, of which ``"levenberg_marquardt"`` is the paper's, or an estimator;
        made anew for each dof.
    feature_names : sequence of str, optional
        Names of the columns of X, where X is not a DataFrame.
    dofs : sequence of str
        Names of the columns of `delta_p`.

    Attributes
    ----------
    regressors_ : dict
        The fitted regressor of each dof.
    columns_ : dict of ndarray
        The columns of X that each was given.
    n_features_in_ : int
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Only where X was a DataFrame.

    Examples
    --------
    >>> delta_p = np.random.default_rng(0).uniform(-1, 1, (200, 6))
    >>> subsets = {dof: [i] for i, dof in enumerate(DOFS)}
    >>> model = PoseRegressor(subsets, "kernel_ridge").fit(delta_p**3, delta_p)
    >>> predicted, std = model.predict(delta_p[:2] ** 3, return_std=True)
    >>> predicted.shape, std.shape
    ((2, 6), (2, 6))
    """

    def __init__(
        self,
        subsets: Mapping[str, Columns] | None = None,
        regressor: Any = "gaussian_process",
        feature_names: Sequence[str] | None = None,
        dofs: Sequence[str] = DOFS,
    ) -> None:
        self.subsets = subsets
        self.regressor = regressor
        self.feature_names = feature_names
        self.dofs = dofs

    def fit(
        self,
        X: ArrayLike,
        delta_p: ArrayLike,
        X_val: ArrayLike | None = None,
        delta_p_val: ArrayLike | None = None,
    ) -> PoseRegressor:
        """Fit each dof's regressor.

        Parameters
        ----------
        X : array or DataFrame of shape (n, n_features)
        delta_p : array of shape (n, n_dofs)
            In the order of `dofs`, in any unit.
            Repeated shots of one pose count as one sample.
        X_val, delta_p_val : arrays of shape (n_val, n_features) and (n_val, n_dofs), optional
            Samples that stop the training of networks, and that others learn from as well; only
            for regressors whose `fit` takes ``X_val, y_val``.

        Returns
        -------
        self

        Raises
        ------
        InvalidInputError
            If a subset names no dof or no feature that there is, the number of dofs differs, or
            values are masked.
        """
        features, targets = self._check(X, delta_p, reset=True)
        template = make_regressor(self.regressor)
        held_out = None
        if X_val is not None and has_fit_parameter(template, "X_val"):
            held_out = Samples(*self._check(X_val, delta_p_val, reset=False))
        known: dict[str, NDArray] = {}
        if has_fit_parameter(template, "poses"):
            # Of all dofs together: one dof may be the same at many poses.
            known["poses"] = find_repeats(*Samples(features, targets).joined(held_out))
        self.columns_ = self._resolve_subsets()
        self.regressors_ = {}
        for i, (dof, columns) in enumerate(self.columns_.items()):
            stop: dict[str, NDArray] = known.copy()
            if held_out is not None:
                stop |= {"X_val": held_out[0][:, columns], "y_val": held_out[1][:, i]}
            self.regressors_[dof] = clone(template).fit(features[:, columns], targets[:, i], **stop)
        return self

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Array: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Array, Array]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Array | tuple[Array, Array]:
        """The displacement at samples X of shape (n, n_features).

        Parameters
        ----------
        X : array or DataFrame of shape (n, n_features)
        return_std : bool

        Returns
        -------
        delta_p : ndarray of shape (n, n_dofs)
        std : ndarray of shape (n, n_dofs)
            Only if `return_std`: the standard deviation of a new displacement.

        Raises
        ------
        TypeError
            If the deviation is asked for and a regressor cannot tell it.
        """
        check_is_fitted(self)
        check_unmasked(X, "X")
        features: Any = validate_data(self, X, reset=False, dtype=np.float64)
        options = {"return_std": True} if return_std else {}
        answers = [
            self.regressors_[dof].predict(features[:, self.columns_[dof]], **options)
            for dof in self.dofs
        ]
        if not return_std:
            return np.column_stack(answers)
        means, deviations = zip(*answers, strict=True)
        return np.column_stack(means), np.column_stack(deviations)

    @classmethod
    def from_fitted(
        cls, regressors: Mapping[str, Any], columns: Mapping[str, Sequence[int]], n_features: int
    ) -> PoseRegressor:
        """Join regressors that were fitted elsewhere, such as by `servoscope.pipeline.fit_all`.

        Parameters
        ----------
        regressors : dict
            A fitted regressor for each dof; their order is that of the predictions.
        columns : dict of sequences of int
            The columns of X that each takes.
        n_features : int
            Number of columns of X.
        """
        model = cls(
            subsets={dof: [int(i) for i in columns[dof]] for dof in regressors},
            regressor=clone(next(iter(regressors.values()))),
            dofs=tuple(regressors),
        )
        model.regressors_ = dict(regressors)
        model.n_features_in_ = n_features
        model.columns_ = model._resolve_subsets()
        return model

    def to_arrays(self) -> dict[str, NDArray]:
        """What `predict` needs, as plain arrays that `numpy.savez` writes without pickle.

        Raises
        ------
        InvalidInputError
            If a regressor is not one of `REGRESSORS`.
        """
        check_is_fitted(self)
        arrays: dict[str, NDArray] = {
            "dofs": np.asarray(self.dofs, dtype=str),
            "n_features": np.asarray(self.n_features_in_),
        }
        if hasattr(self, "feature_names_in_"):
            arrays["feature_names"] = np.asarray(self.feature_names_in_, dtype=str)
        for dof, regressor in self.regressors_.items():
            arrays[f"{dof}.columns"] = self.columns_[dof]
            own = regressor_as_arrays(regressor)
            arrays |= {f"{dof}.{name}": np.asarray(array) for name, array in own.items()}
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> PoseRegressor:
        """A model that predicts as the one `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
        if "dofs" not in arrays or "n_features" not in arrays:
            raise InvalidInputError("A pose regressor needs the arrays 'dofs' and 'n_features'.")
        regressors, columns = {}, {}
        for dof in np.asarray(arrays["dofs"], dtype=str).tolist():
            own = {
                name.removeprefix(f"{dof}."): array
                for name, array in arrays.items()
                if name.startswith(f"{dof}.")
            }
            columns[dof] = np.asarray(own.pop("columns", []), dtype=np.intp).tolist()
            regressors[dof] = regressor_from_arrays(own)
        model = cls.from_fitted(regressors, columns, int(np.asarray(arrays["n_features"])))
        if "feature_names" in arrays:
            model.feature_names_in_ = np.asarray(arrays["feature_names"], dtype=object)
        return model

    def _check(self, X: Any, delta_p: Any, reset: bool) -> tuple[NDArray, NDArray]:
        check_unmasked(X, "X")
        check_unmasked(delta_p, "delta_p")
        X, delta_p = validate_data(
            self, X, delta_p, reset=reset, dtype=np.float64, multi_output=True, y_numeric=True
        )
        delta_p = delta_p.reshape(len(X), -1)
        if delta_p.shape[1] != len(self.dofs):
            raise InvalidInputError(
                f"delta_p must have one column for each of {', '.join(self.dofs)}, "
                f"got {delta_p.shape[1]} columns."
            )
        return X, delta_p

    def _resolve_subsets(self) -> dict[str, NDArray[np.intp]]:
        if self.subsets is None:
            return {dof: np.arange(self.n_features_in_) for dof in self.dofs}
        if set(self.subsets) != set(self.dofs):
            raise InvalidInputError(
                f"subsets must name {', '.join(self.dofs)}, got {', '.join(self.subsets)}."
            )
        for dof, subset in self.subsets.items():
            if len(subset) == 0:
                raise InvalidInputError(
                    f"The subset for {dof} is empty; a dof is told from one feature or more."
                )
        names = getattr(self, "feature_names_in_", self.feature_names)
        known = {} if names is None else {name: i for i, name in enumerate(names)}
        return {
            dof: np.array([self._column(dof, f, known) for f in self.subsets[dof]], dtype=np.intp)
            for dof in self.dofs
        }

    def _column(self, dof: str, feature: int | str, known: Mapping[str, int]) -> int:
        column = known.get(feature) if isinstance(feature, str) else int(feature)
        if column is None or not 0 <= column < self.n_features_in_:
            raise InvalidInputError(
                f"The subset for {dof} names the feature {feature!r}, but X has "
                f"{self.n_features_in_} columns" + (f": {', '.join(known)}." if known else ".")
            )
        return column
