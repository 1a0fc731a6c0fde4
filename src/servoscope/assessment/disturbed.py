"""What noise and other disturbances do to trained models, without training them anew."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.pipeline import PosePipeline
from servoscope.poses import DOFS
from servoscope.positioning.disturbances import SINGLE_DISTURBANCES, Disturbances
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

TITLES = {
    "clean": "none",
    "gain": "gain 0.8",
    "offset": "8 grey levels added",
    "light": "another light",
    "noise": "noise of 10 grey levels",
    "defocus": "blur of 2 px in 256",
    "covering": "a tenth covered",
}
"""The disturbances in words."""


def disturbed_errors(
    pipeline: PosePipeline, images: NDArray[np.uint8], targets: Array, seed: int = 0
) -> dict[str, dict[str, float]]:
    """RMS error under each of `SINGLE_DISTURBANCES`, and under none, as ``clean``.

    Parameters
    ----------
    pipeline : PosePipeline
    images : ndarray of shape (n, height, width), uint8
        Not learned from.
    targets : ndarray of shape (n, 6)
        Displacements in units of the range.
    seed : int
        Draws where things are covered, and the noise.

    Returns
    -------
    dict
        By disturbance and dof, in units of the range.
    """
    conditions: dict[str, Disturbances | None] = {"clean": None, **SINGLE_DISTURBANCES}
    errors: dict[str, dict[str, float]] = {}
    for name, disturbance in conditions.items():
        predicted = _predict(pipeline, _disturbed(images, disturbance, seed))
        errors[name] = {
            dof: _rms(values - targets[:, DOFS.index(dof)]) for dof, values in predicted.items()
        }
    return errors


def noise_errors(
    pipeline: PosePipeline, images: NDArray[np.uint8], sigma: float, seed: int = 0
) -> dict[str, float]:
    """RMS change of the prediction when as much noise again is added to images as they have.

    Parameters
    ----------
    pipeline : PosePipeline
    images : ndarray of shape (n, height, width), uint8
    sigma : float
        Standard deviation of the noise, [grey].

    Returns
    -------
    dict
        By dof, in units of the range.
    """
    if sigma <= 0:
        return dict.fromkeys(pipeline.dofs, 0.0)
    noisy = _disturbed(images, Disturbances.only(noise=min(sigma, 255.0)), seed)
    before, after = _predict(pipeline, images), _predict(pipeline, noisy)
    return {dof: _rms(after[dof] - before[dof]) for dof in pipeline.dofs}


def _predict(pipeline: PosePipeline, images: NDArray[np.uint8]) -> dict[str, Array]:
    """Displacements by dof, in units of the range."""
    with one_blas_thread():
        predicted = pipeline.predict(images) / pipeline.ranges_
    return dict(zip(pipeline.dofs, predicted.T, strict=True))


def _disturbed(
    images: NDArray[np.uint8], disturbance: Disturbances | None, seed: int
) -> NDArray[np.uint8]:
    if disturbance is None:
        return images
    return np.stack(
        [
            disturbance.disturb(image, np.random.default_rng([seed, i]))
            for i, image in enumerate(images)
        ]
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
