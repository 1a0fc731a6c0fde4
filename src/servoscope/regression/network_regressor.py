"""What the regressors made of one tanh network share: all but how it is trained."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from servoscope.arrays import check_scale, check_unmasked
from servoscope.errors import InvalidInputError
from servoscope.regression.samples import (
    Array,
    check_arrays,
    check_samples,
    least_deviation,
)
from servoscope.regression.training import (
    Settings,
    Standardisation,
    TrainedNetwork,
    rms_left_out,
    train_restarts,
)
from servoscope.regression.training_result import TrainingResult

_ARRAYS = ("weights", "input_mean", "input_scale", "target_mean", "target_scale")


class NetworkRegressor(RegressorMixin, BaseEstimator):
    """A network of tanh hidden units and one linear output; subclasses say how it is trained."""

    hidden: int
    restarts: int
    random_state: int | np.random.RandomState | None
    network_: TrainedNetwork

    @abstractmethod
    def _settings(self) -> Settings:
        """How each start is trained."""

    @abstractmethod
    def _check_parameters(self) -> None:
        """Raise InvalidInputError where a parameter is out of range."""

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        X_val: ArrayLike | None = None,
        y_val: ArrayLike | None = None,
        poses: ArrayLike | None = None,
    ) -> Self:
        """Train on samples X (n, k) and y (n,), stopping by X_val (n_val, k) and y_val (n_val,).

        Parameters
        ----------
        X, y : arrays of shape (n, n_features) and (n,)
            Two samples at least.
        X_val, y_val : arrays of shape (n_val, n_features) and (n_val,), optional
            Those of poses that are trained on stop nothing, and are trained on as well.
        poses : array of shape (n,) or (n + n_val,), optional
            Samples of equal value are repeated shots of one pose, which count as one sample, their
            mean. By default they are found (`servoscope.kernels.find_repeats`).

        Returns
        -------
        self

        Raises
        ------
        InvalidInputError
            If a parameter is out of range, only one of X_val and y_val is given, or values are
            masked or beyond 1e30.
        ValueError
            If an array is empty, has the wrong shape or holds NaN or infinity, or there is one
            sample only.
        """
        options = self.training_options()
        learned, others = check_samples(self, X, y, X_val, y_val, poses)
        validation = (None, None) if others is None else others.each
        network = train_restarts(*learned.poses, *validation, **options)
        error = rms_left_out(learned, options) if others is None else network.error
        self.network_ = replace(network, error=error or least_deviation(learned.each.y))
        return self

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Array: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Array, Array]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Array | tuple[Array, Array]:
        """The target at samples X of shape (n, n_features_in_).

        Parameters
        ----------
        X : array of shape (n, n_features_in_)
        return_std : bool

        Returns
        -------
        y : ndarray of shape (n,)
        std : ndarray of shape (n,)
            Only if `return_std`: the standard deviation of a new target.

        Raises
        ------
        InvalidInputError
            If the deviation is asked for and unknown, as it is of networks that were kept as
            arrays before it was kept with them.
        """
        check_is_fitted(self)
        check_unmasked(X, "X")
        samples = np.asarray(validate_data(self, X, reset=False, dtype=np.float64))
        check_scale(samples, "X")
        mean = self.network_.predict(samples)
        return (mean, self._deviation(samples)) if return_std else mean

    def _deviation(self, X: Array) -> Array:
        """Standard deviation of a target at samples X, (n,): the same everywhere."""
        if np.isnan(self.network_.error):
            raise InvalidInputError(
                "The network was kept without its error, so that no standard deviation is known; "
                "train it again."
            )
        return np.full(len(X), self.network_.error)

    @property
    def results_(self) -> tuple[TrainingResult, ...]:
        """How each start went."""
        return self.network_.results

    @property
    def result_(self) -> TrainingResult:
        """The start that was kept."""
        return self.network_.results[self.network_.best]

    @property
    def n_iter_(self) -> int:
        """Number of steps of the start that was kept."""
        return self.result_.n_iter

    def training_options(self, seed: int | None = None) -> dict[str, Any]:
        """Checked arguments for `servoscope.regression.training.train_restarts`.

        Parameters
        ----------
        seed : int, optional
            In place of `random_state`.

        Raises
        ------
        InvalidInputError
            If a parameter is out of range.
        """
        self._check_parameters()
        return {
            "hidden": self.hidden,
            "restarts": self.restarts,
            "seed": _seed(self.random_state) if seed is None else seed,
            "settings": self._settings(),
        }

    def to_arrays(self) -> dict[str, NDArray]:
        """What `predict` needs, as plain arrays that `numpy.savez` writes without pickle."""
        check_is_fitted(self)
        network = self.network_
        arrays: dict[str, NDArray] = {
            "weights": network.weights,
            "input_mean": network.inputs.mean,
            "input_scale": network.inputs.scale,
            "target_mean": np.asarray(network.target.mean),
            "target_scale": np.asarray(network.target.scale),
            "error": np.asarray(network.error),
        }
        if hasattr(self, "feature_names_in_"):
            arrays["feature_names"] = np.asarray(self.feature_names_in_, dtype=str)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """A regressor that predicts as the one that `to_arrays` was called on.

        How it was trained (`results_`) is not kept.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
        weights, *scales = check_arrays(arrays, _ARRAYS, "A network")
        n_features = scales[0].size
        hidden, rest = divmod(weights.size - 1, n_features + 2)
        if rest or hidden < 1 or scales[1].size != n_features:
            raise InvalidInputError(
                f"{weights.size} weights do not make a network of {n_features} inputs: "
                "the arrays are not of one network."
            )
        network = TrainedNetwork(
            weights,
            Standardisation(*scales[:2]),
            Standardisation(*scales[2:]),
            error=float(np.asarray(arrays.get("error", np.nan))),
        )
        names = arrays.get("feature_names")
        regressor = cls(hidden=hidden)
        return regressor.adopt(network, None if names is None else np.asarray(names, dtype=object))

    def adopt(self, network: TrainedNetwork, feature_names: NDArray | None = None) -> Self:
        """Take a network that was trained elsewhere, in place of `fit`."""
        self.network_ = network
        self.n_features_in_ = network.inputs.mean.size
        if feature_names is not None:
            self.feature_names_in_ = feature_names
        return self


def check_counts(regressor: NetworkRegressor, *names: str) -> None:
    """Raise InvalidInputError where a parameter is below 1."""
    for name in names:
        if getattr(regressor, name) < 1:
            raise InvalidInputError(f"{name} must be at least 1, got {getattr(regressor, name)}.")


def _seed(random_state: int | np.random.RandomState | None) -> int:
    if isinstance(random_state, int | np.integer):
        return int(random_state)
    return int(check_random_state(random_state).randint(2**31 - 1))
