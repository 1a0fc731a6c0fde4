"""The photometric interaction matrix, learned from images at known displacements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.positioning.alignment import Alignment, ImageModel, align
from servoscope.positioning.appearance import Appearance
from servoscope.positioning.polynomials import HIGHEST_DEGREE, evaluate_terms, exponents

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

MARGIN = 1.25
"""A level learns from displacements up to this many times its radius."""

_RIDGE = 1e-4
_EVENNESS = 4.0


@dataclass(frozen=True, eq=False)
class LearnedInteraction:
    """What images look like within a radius of the reference, and how to read it backwards.

    Every pixel of the smoothed image is a polynomial of the displacement,

        image(p) = r0 + L p + quadratic terms + ...,

    fitted by least squares to images at known displacements. ``L`` is the photometric interaction
    matrix of Collewet and Marchand, for which no intrinsics, no depth and no hand-eye calibration
    were needed.

    Parameters
    ----------
    appearance : Appearance
    radius : float
        Largest displacement of any dof that the level is meant for, in shares of the reach.
    model : ImageModel
        Of displacements in shares of the radius.
    std_factor : float
        What the standard deviations of an alignment are multiplied by, so that they agree with
        the errors on images that were not trained on.
    unlikeness_limit : float
        The most unlike the model an image may be.

    Notes
    -----
    The vectors of pose-image covariance (Wells and Torras 2001, eq. 13 and 14) are ``X P``. The
    least-squares interaction matrix is ``X P (P'P)^-1``: the same, normalised by how much each dof
    moved. For displacements drawn evenly and independently the two differ by a factor for each
    dof. Errors of the robot in the displacements shrink ``L`` by ``1 / (1 + var(error) / var(p))``
    for each dof, as in any regression.
    """

    appearance: Appearance
    radius: float
    model: ImageModel
    std_factor: float = 1.0
    unlikeness_limit: float = np.inf

    def describe(self) -> dict[str, Any]:
        """What is not an array, as plain JSON values."""
        return {
            "radius": self.radius,
            "degree": int(self.model.powers.sum(axis=1).max()),
            "shape": list(self.model.shape),
            **asdict(self.appearance),
            "std_factor": self.std_factor,
            "unlikeness_limit": self.unlikeness_limit,
        }

    def to_arrays(self) -> dict[str, NDArray]:
        """What is an array."""
        return {"coefficients": self.model.coefficients, "precision": self.model.precision}

    @classmethod
    def restore(
        cls, description: Mapping[str, Any], arrays: Mapping[str, NDArray]
    ) -> LearnedInteraction:
        """The level that was described, with its arrays.

        Raises
        ------
        ValueError, KeyError, TypeError
            If they do not belong together.
        """
        height, width = map(int, description["shape"])
        degree = int(description["degree"])
        if not 1 <= degree <= HIGHEST_DEGREE:
            raise ValueError(f"a level's degree is {degree}, not 1 to {HIGHEST_DEGREE}")
        powers = exponents(degree)
        coefficients, precision = arrays["coefficients"], arrays["precision"]
        fits = coefficients.shape == (len(powers), height * width) == (len(powers), precision.size)
        if not fits or precision.ndim != 1 or min(height, width) < 1 or (precision <= 0).any():
            raise ValueError(f"a level's arrays do not fit its {height} x {width} pixels")
        positive = ("radius", "std_factor", "unlikeness_limit")
        radius, std_factor, unlikeness_limit = (float(description[name]) for name in positive)
        if not all(0 < number < np.inf for number in (radius, std_factor, unlikeness_limit)):
            raise ValueError(f"one of a level's {', '.join(positive)} is not above 0")
        return cls(
            Appearance(float(description["blur"]), float(description["high_pass"])),
            radius,
            ImageModel(powers, coefficients, precision, (height, width)),
            std_factor,
            unlikeness_limit,
        )

    def align(self, image: NDArray, start: Array, **options: float) -> Alignment:
        """Where an image was taken, seen from a first guess in shares of the reach."""
        seen = self.appearance.prepare(image)
        return align(self.model, seen, start / self.radius, **options)  # type: ignore[arg-type]

    def displacement(self, alignment: Alignment) -> Array:
        """The displacement in shares of the reach, (6,)."""
        return self.radius * alignment.p

    def std(self, alignment: Alignment) -> Array:
        """Its standard deviation, believed, in shares of the reach, (6,)."""
        spread = np.sqrt(np.maximum(np.diag(alignment.covariance), 0.0))
        return self.radius * self.std_factor * spread

    def is_alike(self, alignment: Alignment) -> bool:
        """Whether an image resembles the model as images of the part do."""
        return alignment.unlikeness <= self.unlikeness_limit

    def at_reference(self, reference_image: NDArray) -> LearnedInteraction:
        """The level with the reference image itself for what is seen at no displacement."""
        coefficients = self.model.coefficients.copy()
        coefficients[0] = self.appearance.prepare(reference_image).ravel()
        return replace(self, model=replace(self.model, coefficients=coefficients))


def learn_interaction(
    images: NDArray[np.uint8], p: Array, radius: float, degree: int, appearance: Appearance
) -> LearnedInteraction:
    """Fit a level to images.

    Parameters
    ----------
    images : ndarray of shape (n_images, height, width)
    p : ndarray of shape (n_images, 6)
        Displacements in shares of the reach; those beyond the radius and its margin are left out.
    radius : float
    degree : int
        Of the polynomial.
    appearance : Appearance

    Returns
    -------
    LearnedInteraction
    """
    near = np.flatnonzero(np.abs(p).max(axis=1) <= MARGIN * radius)
    shape = appearance.shape((images.shape[1], images.shape[2]))
    prepared = np.stack([appearance.prepare(images[i]).ravel() for i in near])
    powers = exponents(degree)
    terms = evaluate_terms(powers, p[near] / radius)
    gram = terms.T @ terms
    gram[np.diag_indices(len(gram))] *= 1 + _RIDGE
    projected = terms.astype(np.float32).T @ prepared
    coefficients = np.linalg.solve(gram, projected.astype(float)).astype(np.float32)
    residuals = prepared - terms.astype(np.float32) @ coefficients
    spare = max(len(near) - len(powers), len(near) // 4, 1)
    variance = (residuals**2).sum(axis=0) / spare
    variance = cv2.GaussianBlur(variance.reshape(shape), (0, 0), 1.0).ravel()
    variance += _EVENNESS * variance.mean() + 1e-4
    model = ImageModel(powers, coefficients, (1 / np.sqrt(variance)).astype(np.float32), shape)
    return LearnedInteraction(appearance, radius, model)
