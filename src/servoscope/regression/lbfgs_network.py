"""A scikit-learn regressor: the network of the paper, trained by L-BFGS."""

from __future__ import annotations

import numpy as np

from servoscope.errors import InvalidInputError
from servoscope.regression.lbfgs import LBFGSSettings
from servoscope.regression.network_regressor import NetworkRegressor, check_counts


class LBFGSRegressor(NetworkRegressor):
    """A network of tanh hidden units and one linear output, trained by L-BFGS.

    Like `LMRegressor` in all but the steps, which are many and cheap: inputs and target are
    standardised, training goes on until the error on the validation samples has not fallen by
    0.5 % for `patience` steps, and the weights of its lowest point are kept, of the best of
    `restarts` random starts. Without validation samples `weight_decay` alone holds training back.
    The predicted standard deviation is that of `LMRegressor`.

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
    random_state : int, RandomState or None
        Draws the starts.

    Attributes
    ----------
    network_ : TrainedNetwork
        Weights and scales.
    results_ : tuple of TrainingResult
        How each start went; errors in units of the target.
    result_ : TrainingResult
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

    def _check_parameters(self) -> None:
        check_counts(self, "hidden", "restarts", "max_iter", "patience")
        if not self.weight_decay >= 0:
            raise InvalidInputError(f"weight_decay must not be negative, got {self.weight_decay}.")
