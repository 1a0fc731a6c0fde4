"""A scikit-learn regressor: the network of the paper, trained by Levenberg-Marquardt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from servoscope.errors import InvalidInputError
from servoscope.regression.levenberg_marquardt import LMResult, LMSettings
from servoscope.regression.tanh_network import Array
from servoscope.regression.training import Standardisation, TrainedNetwork, train_restarts


class LMRegressor(RegressorMixin, BaseEstimator):
    """A network of tanh hidden units and one linear output, trained by Levenberg-Marquardt.

    Inputs and target are brought to zero mean and unit variance by the training samples; a
    constant input counts for nothing, and a constant target is predicted as it is. Training goes
    on until the error on the validation samples has not fallen by 0.5 % for `patience` steps; the
    weights of its lowest point are kept, of the best of `restarts` random starts. Without
    validation samples training goes on until the training error falls no further (or `max_iter`),
    which over-fits unless `weight_decay` holds it back.

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

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        X_val: ArrayLike | None = None,
        y_val: ArrayLike | None = None,
    ) -> LMRegressor:
        """Train on samples X (n, k) and y (n,), stopping by X_val (n_val, k) and y_val (n_val,).

        Returns
        -------
        self

        Raises
        ------
        InvalidInputError
            If a parameter is out of range or only one of X_val and y_val is given.
        ValueError
            If an array is empty, has the wrong shape or holds NaN or infinity.
        """
        options = self.training_options()
        if (X_val is None) != (y_val is None):
            raise InvalidInputError("X_val and y_val belong together: give both, or neither.")
        training = self._check_samples(X, y, reset=True)
        validation: tuple[Any, Any] = (None, None)
        if X_val is not None:
            validation = self._check_samples(X_val, y_val, reset=False)
        self.network_ = train_restarts(*training, *validation, **options)
        return self

    def predict(self, X: ArrayLike) -> NDArray[np.float64]:
        """The target at samples X of shape (n, n_features_in_), (n,)."""
        check_is_fitted(self)
        return self.network_.predict(validate_data(self, X, reset=False, dtype=np.float64))

    @property
    def results_(self) -> tuple[LMResult, ...]:
        """How each start went."""
        return self.network_.results

    @property
    def result_(self) -> LMResult:
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
        for name in ("hidden", "restarts", "max_iter", "patience"):
            if getattr(self, name) < 1:
                raise InvalidInputError(f"{name} must be at least 1, got {getattr(self, name)}.")
        if not self.damping > 0 or not self.weight_decay >= 0:
            raise InvalidInputError(
                "damping must be positive and weight_decay not negative, "
                f"got {self.damping} and {self.weight_decay}."
            )
        if seed is None:
            seed = _seed(self.random_state)
        settings = LMSettings(
            max_iter=self.max_iter,
            patience=self.patience,
            damping=self.damping,
            weight_decay=self.weight_decay,
        )
        return {
            "hidden": self.hidden,
            "restarts": self.restarts,
            "seed": seed,
            "settings": settings,
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
        }
        if hasattr(self, "feature_names_in_"):
            arrays["feature_names"] = np.asarray(self.feature_names_in_, dtype=str)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> LMRegressor:
        """A regressor that predicts as the one that `to_arrays` was called on.

        How it was trained (`results_`) is not kept.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
        missing = {"weights", "input_mean", "input_scale", "target_mean", "target_scale"} - set(
            arrays
        )
        if missing:
            raise InvalidInputError(
                f"A network needs the array {min(missing)!r}, got {', '.join(sorted(arrays))}."
            )
        weights, *scales = (
            np.asarray(arrays[name], dtype=np.float64)
            for name in ("weights", "input_mean", "input_scale", "target_mean", "target_scale")
        )
        n_features = scales[0].size
        hidden, rest = divmod(weights.size - 1, n_features + 2)
        if rest or hidden < 1 or scales[1].size != n_features:
            raise InvalidInputError(
                f"{weights.size} weights do not make a network of {n_features} inputs: "
                "the arrays are not of one network."
            )
        regressor = cls(hidden=hidden)
        network = TrainedNetwork(
            weights, Standardisation(*scales[:2]), Standardisation(*scales[2:])
        )
        names = arrays.get("feature_names")
        return regressor.adopt(network, None if names is None else np.asarray(names, dtype=object))

    def adopt(self, network: TrainedNetwork, feature_names: NDArray | None = None) -> LMRegressor:
        """Take a network that was trained elsewhere, in place of `fit`."""
        self.network_ = network
        self.n_features_in_ = network.inputs.mean.size
        if feature_names is not None:
            self.feature_names_in_ = feature_names
        return self

    def _check_samples(self, X: Any, y: Any, reset: bool) -> tuple[Array, Array]:
        X, y = validate_data(self, X, y, reset=reset, dtype=np.float64, y_numeric=True)
        return X, y.astype(np.float64)


def _seed(random_state: int | np.random.RandomState | None) -> int:
    if isinstance(random_state, int | np.integer):
        return int(random_state)
    return int(check_random_state(random_state).randint(2**31 - 1))
