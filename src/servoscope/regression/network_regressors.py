"""Regressors made of one tanh network; they differ in how it is trained."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from servoscope.errors import InvalidInputError
from servoscope.regression.bayesian import BayesianResult, BayesianSettings, WeightPosterior
from servoscope.regression.levenberg_marquardt import LMSettings
from servoscope.regression.samples import (
    Array,
    SampleRegressor,
    Samples,
    Shots,
    calibration_ratio,
    check_arrays,
    least_deviation,
)
from servoscope.regression.training import (
    LBFGSSettings,
    Settings,
    Standardisation,
    TrainedNetwork,
    TrainingResult,
    rms_left_out,
    train_restarts,
)

_ARRAYS = ("weights", "input_mean", "input_scale", "target_mean", "target_scale")


class NetworkRegressor(SampleRegressor):
    """A network of tanh hidden units and one linear output; subclasses say how it is trained."""

    hidden: int
    restarts: int
    random_state: int | np.random.RandomState | None
    network_: TrainedNetwork

    @abstractmethod
    def _settings(self) -> Settings:
        """How each start is trained."""

    def _check_parameters(self) -> None:
        values = self.get_params()
        for name in ("hidden", "restarts", "max_iter", "patience"):
            if values.get(name, 1) < 1:
                raise InvalidInputError(f"{name} must be at least 1, got {values[name]}.")
        if not values.get("damping", 1.0) > 0:
            raise InvalidInputError(f"damping must be positive, got {values['damping']}.")
        if not values.get("weight_decay", 0.0) >= 0:
            raise InvalidInputError(
                f"weight_decay must not be negative, got {values['weight_decay']}."
            )

    def _learn(self, learned: Shots, others: Shots | None) -> None:
        options = self._training_options()
        validation = (None, None) if others is None else others.each
        network = train_restarts(*learned.poses, *validation, **options)
        error = rms_left_out(learned, options) if others is None else network.error
        self.network_ = replace(network, error=error or least_deviation(learned.each.y))

    def _mean(self, X: Array) -> Array:
        return self.network_.predict(X)

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

    def _training_options(self) -> dict[str, Any]:
        """Arguments for `train_restarts`."""
        return {
            "hidden": self.hidden,
            "restarts": self.restarts,
            "seed": _seed(self.random_state),
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
        return self._with_names(arrays)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """A regressor that predicts as the one that `to_arrays` was called on."""
        weights, *scales = check_arrays(arrays, _ARRAYS, "A network")
        n_features = scales[0].size
        hidden, rest = divmod(weights.size - 1, n_features + 2)
        if rest or hidden < 1 or scales[1].size != n_features:
            raise InvalidInputError(
                f"{weights.size} weights do not make a network of {n_features} inputs: "
                "the arrays are not of one network."
            )
        regressor = cls(hidden=hidden)
        regressor.network_ = TrainedNetwork(
            weights,
            Standardisation(*scales[:2]),
            Standardisation(*scales[2:]),
            error=float(np.asarray(arrays.get("error", np.nan))),
        )
        regressor._take_names(n_features, arrays)
        return regressor


def _seed(random_state: int | np.random.RandomState | None) -> int:
    if isinstance(random_state, int | np.integer):
        return int(random_state)
    return int(check_random_state(random_state).randint(2**31 - 1))


class LMRegressor(NetworkRegressor):
    """A network of tanh hidden units and one linear output, trained by Levenberg-Marquardt.

    Inputs and target are brought to zero mean and unit variance by the training samples; a
    constant input counts for nothing, and a constant target is predicted as it is. Repeated shots
    of one pose count as one sample. Training goes
    on until the error on the validation samples has not fallen by 0.5 % for `patience` steps; the
    weights of its lowest point are kept, of the best of `restarts` random starts. Without
    validation samples training goes on until the training error falls no further (or `max_iter`),
    which over-fits unless `weight_decay` holds it back. The predicted standard deviation is the
    RMS error of the validation samples, the same everywhere; without them it is that of networks
    trained without a quarter of the poses, at those.

    Parameters
    ----------
    hidden : int
        Number of tanh units.
    restarts : int
        Number of random starts.
    max_iter : int
        Most steps of one start.
    patience : int
        Steps without a lower validation error after which a start is over.
    weight_decay : float
        Factor of the squared weights, which are added to the sum of the squared residuals.
    damping : float
        Levenberg-Marquardt damping to start with.
    random_state : int, RandomState or None
        Draws the starts.

    Attributes
    ----------
    network_ : TrainedNetwork
        Weights and scales.
    results_ : tuple of LMResult
        How each start went; errors in units of the target.
    result_ : LMResult
        The start that was kept.
    n_iter_ : int
        Number of steps of that start.
    n_features_in_ : int
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Only where X had names.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.random.default_rng(0).uniform(-1, 1, (300, 2))
    >>> y = np.sin(2 * X[:, 0]) * X[:, 1]
    >>> net = LMRegressor(hidden=10).fit(X[:200], y[:200], X[200:], y[200:])
    >>> bool(net.result_.best_rms < 0.01)
    True
    """

    def __init__(
        self,
        hidden: int = 30,
        restarts: int = 3,
        max_iter: int = 200,
        patience: int = 3,
        weight_decay: float = 0.0,
        damping: float = 10.0,
        random_state: int | np.random.RandomState | None = 0,
    ) -> None:
        self.hidden = hidden
        self.restarts = restarts
        self.max_iter = max_iter
        self.patience = patience
        self.weight_decay = weight_decay
        self.damping = damping
        self.random_state = random_state

    def _settings(self) -> LMSettings:
        return LMSettings(
            max_iter=self.max_iter,
            patience=self.patience,
            damping=self.damping,
            weight_decay=self.weight_decay,
        )


class LBFGSRegressor(NetworkRegressor):
    """A network of tanh hidden units and one linear output, trained by L-BFGS.

    Like `LMRegressor`, whose parameters of the same names and whose attributes it has, in all but
    the steps, which are many and cheap. Without validation samples `weight_decay` alone holds
    training back.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.random.default_rng(0).uniform(-1, 1, (300, 2))
    >>> y = np.sin(2 * X[:, 0]) * X[:, 1]
    >>> net = LBFGSRegressor(hidden=10).fit(X[:200], y[:200], X[200:], y[200:])
    >>> bool(net.result_.best_rms < 0.03)
    True
    """

    def __init__(
        self,
        hidden: int = 30,
        restarts: int = 3,
        max_iter: int = 1000,
        patience: int = 50,
        weight_decay: float = 0.1,
        random_state: int | np.random.RandomState | None = 0,
    ) -> None:
        self.hidden = hidden
        self.restarts = restarts
        self.max_iter = max_iter
        self.patience = patience
        self.weight_decay = weight_decay
        self.random_state = random_state

    def _settings(self) -> LBFGSSettings:
        return LBFGSSettings(self.max_iter, self.patience, self.weight_decay)


class BayesianLMRegressor(NetworkRegressor):
    """A network of tanh hidden units under the weight decay that makes the targets likeliest.

    It is trained by Levenberg-Marquardt under a strong weight decay, then under weaker and weaker
    ones; the decay of the largest evidence is kept, of the best of `restarts` random starts. The
    predicted standard deviation is that of Laplace's approximation, `posterior_`. Validation
    samples are not needed; those that `fit` is given set the size of the standard deviation, and
    are then learned from like the others. Parameters and attributes are as of `LMRegressor`.

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

    def _learn(self, learned: Shots, others: Shots | None) -> None:
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

    @property
    def result_(self) -> BayesianResult:
        """The start that was kept."""
        return cast(BayesianResult, super().result_)

    def _train(self, samples: Samples, noise: float | None = None) -> None:
        """Train anew; `noise`, in the unit of the target, replaces what the samples say of it."""
        self.network_ = train_restarts(*samples, None, None, **self._training_options())
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
        """A regressor that predicts as the one that `to_arrays` was called on."""
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
