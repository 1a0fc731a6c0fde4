"""A scikit-learn regressor: a Gaussian process with a length scale for each feature."""

from __future__ import annotations

from servoscope.kernels import GaussianKernel, fit_kernel
from servoscope.regression.kernel_regressor import KERNEL_SAMPLES, KernelRegressor
from servoscope.regression.samples import Samples


class GaussianProcess(KernelRegressor):
    """A Gaussian process whose length scales tell how much each feature has to say.

    Length scales, signal and noise are those of the largest marginal likelihood of at most 600
    training samples; from the rest, up to `max_samples` in all, the predictions learn as well.
    Validation samples are not needed; those that `fit` is given set the size of the predicted
    standard deviation, and are then learned from like the others.

    Parameters
    ----------
    max_samples : int
        Of more samples than that, so many drawn at random are learned from, always the same
        ones: memory grows with their square and time with their cube.
    kernel_steps : int
        Most steps of the search for the kernel.

    Attributes
    ----------
    kernel_ : GaussianKernel
        Length scales, signal and noise in the units of the features and the target.
    posterior_ : KernelPosterior
        The kernel with the samples.
    n_features_in_ : int
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Only where X had names.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    >>> process = GaussianProcess().fit(X, np.sin(2 * X[:, 0]) * X[:, 1])
    >>> y, std = process.predict([[0.5, 0.5], [9.0, 9.0]], return_std=True)
    >>> bool(abs(y[0] - np.sin(1.0) * 0.5) < 0.01), bool(std[1] > 10 * std[0])
    (True, True)
    """

    def __init__(self, max_samples: int = 2000, kernel_steps: int = 60) -> None:
        self.max_samples = max_samples
        self.kernel_steps = kernel_steps

    def _find_kernel(self, samples: Samples) -> GaussianKernel:
        return fit_kernel(*samples, max_samples=KERNEL_SAMPLES, max_iter=self.kernel_steps)
