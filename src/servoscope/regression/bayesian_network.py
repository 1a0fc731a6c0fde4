"""A scikit-learn regressor: the network of the paper under MacKay's weight decay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from servoscope.errors import InvalidInputError
from servoscope.regression.bayesian import BayesianResult, BayesianSettings
from servoscope.regression.calibration_ratio import calibration_ratio
from servoscope.regression.network_regressor import NetworkRegressor, check_counts
from servoscope.regression.samples import (
    Array,
    Samples,
    check_arrays,
    check_samples,
    least_deviation,
)
from servoscope.regression.training import train_restarts
from servoscope.regression.weight_posterior import WeightPosterior


class BayesianLMRegressor(NetworkRegressor):
    """A network of tanh hidden units under the weight decay that makes the targets likeliest.

    It is trained by Levenberg-Marquardt under a strong weight decay, then under weaker and weaker
    ones; the decay of the largest evidence is kept, of the best of `restarts` random starts. The
    predicted standard deviation is that of Laplace's approximation. Validation samples are not
    needed; those that `fit` is given set the size of the standard deviation, and are then learned
    from like the others.

    Parameters
    ----------
    hidden : int
        Number of tanh units.
    restarts : int
        Number of random starts.
    random_state : int, RandomState or None
        Draws the starts.

    Attributes
    ----------
    network_ : TrainedNetwork
        Weights and scales.
    posterior_ : WeightPosterior
        What the samples leave open, for standardised inputs and target.
    results_ : tuple of BayesianResult
        How each start went; errors in units of the target.
    result_ : BayesianResult
        The start that was kept.
    n_iter_ : int
        Number of steps of that start.
    n_features_in_ : int
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Only where X had names.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    >>> net = BayesianLMRegressor(hidden=10).fit(X, np.sin(2 * X[:, 0]) * X[:, 1])
    >>> y, std = net.predict([[0.5, 0.5], [9.0, 9.0]], return_std=True)
    >>> bool(abs(y[0] - np.sin(1.0) * 0.5) < 0.02), bool(std[1] > 10 * std[0])
    (True, True)
    """

    posterior_: WeightPosterior

    def __init__(
        self,
        hidden: int = 30,
        restarts: int = 1,
        random_state: int | np.random.RandomState | None = 0,
    ) -> None:
        self.hidden = hidden
        self.restarts = restarts
        self.random_state = random_state

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        X_val: ArrayLike | None = None,
        y_val: ArrayLike | None = None,
        poses: ArrayLike | None = None,
    ) -> Self:
        """Train on samples X (n, k) and y (n,).

        Parameters
        ----------
        X, y : arrays of shape (n, n_features) and (n,)
            Two samples at least.
        X_val, y_val : arrays of shape (n_val, n_features) and (n_val,), optional
            More samples to learn from, once it is seen how large the errors at them are: by as
            much the predicted standard deviation is raised or lowered.
        poses : array of shape (n,) or (n + n_val,), optional
            Samples of equal value are repeated shots of one pose, which count as one sample, their
            mean. By default they are found (`servoscope.kernels.find_repeats`).

        Raises
        ------
        InvalidInputError
            If a parameter is out of range, only one of X_val and y_val is given, or values are
            masked or beyond 1e30.
        ValueError
            If an array is empty, has the wrong shape or holds NaN or infinity, or there is one
            sample only.
        """
        self._check_parameters()
        learned, others = check_samples(self, X, y, X_val, y_val, poses)
        self._train(learned.poses)
        noise = self.posterior_.noise / float(self.network_.target.scale)
        if others is not None:
            errors = others.each.y - self.network_.predict(others.each.X)
            noise *= calibration_ratio(errors, self._deviation(others.each.X))
            self._train(learned.poses.joined(others.poses), noise)
        elif learned.poses is not learned.each or not noise:
            within = learned.noise_within(learned.each.y - self.network_.predict(learned.each.X))
            noise = float(np.hypot(noise, np.sqrt(within))) or least_deviation(learned.each.y)
            self._set_noise(noise)
        return self

    @property
    def result_(self) -> BayesianResult:
        """The start that was kept."""
        return cast(BayesianResult, super().result_)

    def _train(self, samples: Samples, noise: float | None = None) -> None:
        """Train anew; `noise`, in the unit of the target, replaces what the samples say of it."""
        self.network_ = train_restarts(*samples, None, None, **self.training_options())
        evidence = self.result_.evidence
        self.posterior_ = WeightPosterior(
            self.network_.weights,
            self.network_.inputs.apply(samples.X),
            evidence.weight_decay,
            evidence.noise if noise is None else noise * float(self.network_.target.scale),
        )

    def _set_noise(self, noise: float) -> None:
        """Take another noise, in the unit of the target."""
        scaled = noise * float(self.network_.target.scale)
        self.posterior_ = replace(self.posterior_, noise=scaled)

    def _deviation(self, X: Array) -> Array:
        check_is_fitted(self, "posterior_")
        network = self.network_
        return self.posterior_.deviation(network.inputs.apply(X)) / network.target.scale

    def to_arrays(self) -> dict[str, NDArray]:
        """What `predict` needs, as plain arrays that `numpy.savez` writes without pickle."""
        posterior = self.posterior_
        return {
            **super().to_arrays(),
            "samples": posterior.X,
            "weight_decay": np.asarray(posterior.weight_decay),
            "noise": np.asarray(posterior.noise),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """A regressor that predicts as the one that `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
        regressor = super().from_arrays(arrays)
        X, weight_decay, noise = check_arrays(
            arrays, ("samples", "weight_decay", "noise"), "A Bayesian network"
        )
        if X.ndim != 2 or X.shape[1] != regressor.n_features_in_:
            raise InvalidInputError(
                f"Samples of shape {X.shape} are not of a network of {regressor.n_features_in_} "
                "inputs: the arrays are not of one network."
            )
        regressor.posterior_ = WeightPosterior(
            regressor.network_.weights, X, float(weight_decay), float(noise)
        )
        return regressor

    def _settings(self) -> BayesianSettings:
        return BayesianSettings()

    def _check_parameters(self) -> None:
        check_counts(self, "hidden", "restarts")
