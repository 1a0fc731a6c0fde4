"""Robust Gauss-Newton: the displacement at which a learned image resembles the one seen."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.positioning.polynomials import differentiate_terms, evaluate_terms
from servoscope.positioning.reference_view import similarity

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

CUT = 3.0
"""Residuals of this many standard deviations and more count for nothing."""

LEAST_SCALE = 0.3
"""Residuals are never taken for less than this share of what training left."""

_BLOCKS = 16
_DAMPING = 1e-6
_LEAST_SLOPE = 0.1


@dataclass(frozen=True, eq=False)
class ImageModel:
    """What an image looks like at a displacement: a polynomial for every pixel.

    Parameters
    ----------
    powers : ndarray of shape (n_terms, 6)
        Exponents of the polynomial's terms.
    coefficients : ndarray of shape (n_terms, height * width), float32
    precision : ndarray of shape (height * width,), float32
        One over the standard deviation of each pixel about the polynomial.
    shape : tuple of 2 int
        Height and width.
    """

    powers: NDArray[np.int64]
    coefficients: Floats
    precision: Floats
    shape: tuple[int, int]

    def linearise(self, p: Array) -> tuple[Floats, Floats]:
        """The image at a displacement, (n_pixels,), and its interaction matrix, (6, n_pixels)."""
        terms = np.vstack([evaluate_terms(self.powers, p), differentiate_terms(self.powers, p)])
        rows = terms.astype(np.float32) @ self.coefficients
        return rows[0], rows[1:]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where an image was found to be taken.

    Parameters
    ----------
    p : ndarray of shape (6,)
        The displacement, in shares of the level's radius.
    covariance : ndarray of shape (6, 6)
        Of `p`, from how the residuals agree with each other from block to block of the image.
    unlikeness : float
        Median absolute residual over that of the image about its own median; 0 is a perfect
        likeness, 1 tells nothing.
    """

    p: Array
    covariance: Array
    unlikeness: float
    similarity: float


def align(
    model: ImageModel, image: Floats, start: Array, *, max_iter: int = 10, tolerance: float = 1e-3
) -> Alignment:
    """Find the displacement, gain, offset and defocus at which the model resembles an image.

    Parameters
    ----------
    model : ImageModel
    image : ndarray of shape (height, width), float32
    start : ndarray of shape (6,)
        Where to begin, in shares of the level's radius.
    max_iter : int
    tolerance : float
        A smaller step of every dof is the last.

    Returns
    -------
    Alignment

    Notes
    -----
    The image is taken for ``g m(p) + b + d (laplacian of m)``: gain, offset and, to first order,
    defocus are estimated along with `p`. Residuals are weighted by Tukey's biweight.
    """
    seen = image.ravel()
    p = np.clip(start, -1.0, 1.0)
    expected, interaction = model.linearise(p)
    light = _first_light(model, expected, seen)
    for _ in range(max_iter):
        columns, residuals = _weigh(model, expected, interaction, light, seen)
        weights = _tukey(residuals)
        hessian = ((columns * weights) @ columns.T).astype(float)
        hessian[np.diag_indices(len(hessian))] *= 1 + _DAMPING
        step = np.linalg.lstsq(hessian, columns @ (weights * residuals), rcond=1e-12)[0]
        p = np.clip(p + step[:6], -1.5, 1.5)
        light = light + step[6:]
        expected, interaction = model.linearise(p)
        if np.abs(step[:6]).max() < tolerance:
            break
    columns, residuals = _weigh(model, expected, interaction, light, seen)
    weights = _tukey(residuals)
    spread = float(np.median(np.abs(seen - np.median(seen)) * model.precision))
    return Alignment(
        p,
        _covariance(columns, residuals, weights, model.shape),
        float(np.median(np.abs(residuals)) / max(spread, 1e-6)),
        similarity(seen.reshape(model.shape), expected.reshape(model.shape)),
    )


def _first_light(model: ImageModel, expected: Floats, seen: Floats) -> Array:
    """Gain, offset and defocus to begin with."""
    weights = model.precision**2
    centred = weights * (expected - np.average(expected, weights=weights))
    gain = float(np.clip(centred @ seen / max(float(centred @ expected), 1e-6), 0.3, 3.0))
    return np.array([gain, float(np.median(seen - gain * expected)), 0.0])


def _weigh(
    model: ImageModel, expected: Floats, interaction: Floats, light: Array, seen: Floats
) -> tuple[Floats, Floats]:
    """Derivatives by p, gain, offset and defocus, (9, n_pixels), and residuals, both weighed."""
    laplacian = cv2.Laplacian(
        expected.reshape(model.shape), cv2.CV_32F, borderType=cv2.BORDER_REPLICATE
    ).ravel()
    gain, offset, defocus = light.astype(np.float32)
    residuals = (seen - gain * expected - offset - defocus * laplacian) * model.precision
    columns = np.empty((9, seen.size), np.float32)
    np.multiply(interaction, gain * model.precision, out=columns[:6])
    columns[6], columns[7], columns[8] = expected, 1.0, laplacian
    columns[6:] *= model.precision
    return columns, residuals


def _tukey(residuals: Floats) -> Floats:
    """Weights of residuals by their robust standard deviation."""
    scale = max(LEAST_SCALE, 1.4826 * float(np.median(np.abs(residuals))))
    inside = 1 - (residuals / np.float32(CUT * scale)) ** 2
    return np.where(inside > 0, inside * inside, np.float32(0))


def _covariance(
    columns: Floats, residuals: Floats, weights: Floats, shape: tuple[int, int]
) -> Array:
    """Covariance of p by the sandwich formula, with residuals correlated inside blocks.

    The slope of Tukey's psi is ``5 w - 4 sqrt(w)``: the biweight holds less than its weights say.
    """
    scores = (columns * (weights * residuals)).reshape(len(columns), *shape)
    rows, columns_of = (np.arange(min(n, _BLOCKS)) * n // min(n, _BLOCKS) for n in shape)
    sums = np.add.reduceat(np.add.reduceat(scores, rows, axis=1), columns_of, axis=2)
    sums = sums.reshape(len(columns), -1).astype(float)
    slope = float(np.mean(5 * weights - 4 * np.sqrt(weights)) / np.mean(weights))
    hessian = max(slope, _LEAST_SLOPE) * ((columns * weights) @ columns.T).astype(float)
    bread = np.linalg.pinv(hessian, rcond=1e-12, hermitian=True)
    return (bread @ (sums @ sums.T) @ bread)[:6, :6]
