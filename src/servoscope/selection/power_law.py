"""Errors that fall with a power of the number of images, towards what more images cannot mend."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

EXPONENTS = np.geomspace(0.15, 2.0, 16)
REMAINDERS = np.linspace(0.0, 1.0, 26)
"""Shares of the last error that no number of images takes away."""
_OFFSETS = np.linspace(-3.0, 3.0, 13)
"""By how many of its standard errors the last error may be wrong."""


@dataclass(frozen=True, eq=False)
class PowerLaw:
    """The curves ``a + b n^-c`` that agree with some measured errors, and how well each does.

    Parameters
    ----------
    n : float
        The largest measured number of images.
    level : ndarray of shape (n_curves,)
        Error of each curve there.
    remainder : ndarray of shape (n_curves,)
        Share of it that no number of images takes away: ``a / level``.
    exponent : ndarray of shape (n_curves,)
        c.
    weight : ndarray of shape (n_curves,)
        Adds up to 1.
    """

    n: float
    level: Array = field(repr=False)
    remainder: Array = field(repr=False)
    exponent: Array = field(repr=False)
    weight: Array = field(repr=False)

    def quantiles(self, n: float, shares: ArrayLike) -> Array:
        """The errors at n images that such shares of the curves, by weight, fall below.

        They never rise with n.
        """
        falling = (1 - self.remainder) * (n / self.n) ** -self.exponent
        errors = self.level * (falling + self.remainder)
        order = np.argsort(errors, kind="stable")
        reached = np.searchsorted(np.cumsum(self.weight[order]), shares)
        return np.asarray(errors[order[np.minimum(reached, len(order) - 1)]])


def fit_power_law(n: ArrayLike, rms: ArrayLike, log_errors: ArrayLike) -> PowerLaw:
    """The power laws that agree with errors measured at several numbers of images.

    Parameters
    ----------
    n : array of shape (n_sizes,)
        Numbers of images, ascending.
    rms : array of shape (n_sizes,)
        Errors there, all above 0.
    log_errors : array of shape (n_sizes,)
        Standard errors of their logarithms.

    Returns
    -------
    PowerLaw

    Notes
    -----
    Three to five errors do not settle three parameters. So no curve is the best one: every curve
    of a grid counts by its likelihood, with log errors taken for normal, exponents for equally
    likely by their logarithm from 0.15 to 2, and remainders from 0 to 1.

    Examples
    --------
    >>> n = np.array([100, 200, 400, 800])
    >>> law = fit_power_law(n, 0.1 + 4 / n, [0.01] * 4)
    >>> law.quantiles(8000, [0.5]).round(2)
    array([0.1])
    """
    sizes, errors, spread = (np.asarray(a, dtype=float) for a in (n, rms, log_errors))
    level, remainder, exponent = (
        grid.ravel()
        for grid in np.meshgrid(
            errors[-1] * np.exp(spread[-1] * _OFFSETS), REMAINDERS, EXPONENTS, indexing="ij"
        )
    )
    ratio = sizes[:, None] / sizes[-1]
    curves = level * ((1 - remainder) * ratio**-exponent + remainder)
    misfit = np.square((np.log(curves) - np.log(errors)[:, None]) / spread[:, None]).sum(axis=0)
    weight = np.exp(-0.5 * (misfit - misfit.min()))
    return PowerLaw(float(sizes[-1]), level, remainder, exponent, weight / weight.sum())
