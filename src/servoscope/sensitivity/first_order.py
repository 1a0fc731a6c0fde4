"""The error that derivatives predict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def predict_rms(clean_errors: Array, slopes: tuple[Array, Array], phi: Sequence[float]) -> Array:
    """RMS errors to first order, from two estimates of the errors' derivatives.

    Parameters
    ----------
    clean_errors : ndarray of shape (n_images, n_dofs)
    slopes : pair of ndarrays of shape (n_draws, n_images, n_dofs)
        Derivatives of the errors by ``phi``, each from differences of other images.
    phi : sequence of float
        How far to go along them.

    Returns
    -------
    ndarray of shape (len(phi), n_dofs)
        Over draws and images.

    Notes
    -----
    With ``e`` the clean errors and ``d``, ``d'`` the two derivatives, the mean square is
    ``<e^2> + phi <e (d + d')> + phi^2 <d d'>``. Features that count pixels change by leaps, and
    what a difference has of those is divided by a small step and would be multiplied by a large
    ``phi``. The leaps of the two differences have nothing to do with each other: in the product
    they average out, where the square of one would add them up. For smooth features
    ``d = d'``, and this is the mean square of ``e + phi d``.

    Examples
    --------
    >>> e, d = np.ones((1, 1)), np.full((1, 1, 1), 2.0)
    >>> predict_rms(e, (d, d), [-1.0, 3.0])[:, 0]
    array([1., 7.])
    """
    first, second = slopes
    square = (clean_errors**2).mean(axis=0)
    linear = (clean_errors * (first + second)).mean(axis=(0, 1))
    quadratic = np.maximum((first * second).mean(axis=(0, 1)), 0)
    strengths = np.asarray(phi, dtype=float)[:, None]
    mean_square = square + strengths * linear + strengths**2 * quadratic
    return np.asarray(np.sqrt(np.maximum(mean_square, 0)))
