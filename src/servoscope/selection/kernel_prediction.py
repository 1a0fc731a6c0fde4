"""What a Gaussian process says of new samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.kernels import GaussianKernel, inverse_covariance

Array = NDArray[np.float64]


def predict_samples(kernel: GaussianKernel, X: Array, y: Array, X_new: Array) -> Array:
    """Targets at samples X_new (n_new, n_features), from the targets y (n,) at X (n, n_features).

    Examples
    --------
    >>> kernel = GaussianKernel(np.zeros(1), np.ones(1), signal=1.0, noise=1e-3, offset=2.0)
    >>> X = np.linspace(0, 3, 20)[:, None]
    >>> predict_samples(kernel, X, np.sin(X[:, 0]), np.array([[1.0], [99.0]])).round(2)
    array([0.84, 2.  ])
    """
    if kernel.signal == 0:
        return np.full(len(X_new), kernel.offset)
    inverse, _ = inverse_covariance(kernel, X)
    return np.asarray(kernel.offset + kernel(X_new, X) @ (inverse @ (y - kernel.offset)))
