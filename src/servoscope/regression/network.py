"""A scikit-learn regressor: the network of the paper, trained by Levenberg-Marquardt."""

from __future__ import annotations

import numpy as np

from servoscope.errors import InvalidInputError
from servoscope.regression.levenberg_marquardt import LMSettings
from servoscope.regression.network_regressor import NetworkRegressor, check_counts


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

    def _check_parameters(self) -> None:
        check_counts(self, "hidden", "restarts", "max_iter", "patience")
        if not self.damping > 0 or not self.weight_decay >= 0:
            raise InvalidInputError(
                "damping must be positive and weight_decay not negative, "
                f"got {self.damping} and {self.weight_decay}."
            )
