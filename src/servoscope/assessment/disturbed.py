"""What noise and other disturbances do to trained models, without training them anew."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from servoscope.pipeline import PosePipeline
from servoscope.poses import DOFS
from servoscope.processes import in_processes, one_blas_thread
from servoscope.scene.disturbances import SINGLE_DISTURBANCES, Disturbances

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

N_CONDITIONS = 2 + len(SINGLE_DISTURBANCES)

MOST_IMAGES = 60
"""So many images show what a disturbance does."""


def disturb(
    pipeline: PosePipeline,
    images: NDArray[np.uint8],
    targets: Array,
    sigma: float,
    *,
    seed: int = 0,
    n_jobs: int | None = 1,
    on_progress: Callable[[int], object] | None = None,
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """What noise and other disturbances do to the predictions.

    Parameters
    ----------
    pipeline : PosePipeline
    images : ndarray of shape (n, height, width), uint8
        Not learned from; the first `MOST_IMAGES` count.
    targets : ndarray of shape (n, 6)
        Displacements in units of the range.
    sigma : float
        Standard deviation of the noise that the images have, [grey].
    seed : int
        Draws where things are covered, and the noise.
    n_jobs : int, optional
        Processes, as joblib counts them.
    on_progress : callable, optional
        Called with the number of `N_CONDITIONS` done.

    Returns
    -------
    changes : dict
        RMS change of the prediction by dof when as much noise again is added.
    errors : dict
        RMS error under each of `SINGLE_DISTURBANCES`, and under none, as ``clean``, by dof. Both
        in units of the range.
    """
    images, targets = images[:MOST_IMAGES], targets[:MOST_IMAGES]
    own = Disturbances.only(noise=min(sigma, 255.0)) if sigma > 0 else None
    conditions = [None, own, *SINGLE_DISTURBANCES.values()]
    calls = ((pipeline, images, how, seed) for how in conditions)
    found: list[dict[str, Array]] = []
    for predicted in in_processes(_predict, calls, n_jobs, batch_size=1):
        found.append(predicted)
        if on_progress is not None:
            on_progress(len(found))
    clean, noisy, *disturbed = found
    changes = {dof: _rms(noisy[dof] - clean[dof]) for dof in pipeline.dofs}
    errors = {
        name: {dof: _rms(one[dof] - targets[:, DOFS.index(dof)]) for dof in pipeline.dofs}
        for name, one in zip(("clean", *SINGLE_DISTURBANCES), (clean, *disturbed), strict=True)
    }
    return changes, errors


def _predict(
    pipeline: PosePipeline, images: NDArray[np.uint8], how: Disturbances | None, seed: int
) -> dict[str, Array]:
    """Displacements of disturbed images by dof, in units of the range."""
    with one_blas_thread():
        predicted = pipeline.predict(_disturbed(images, how, seed)) / pipeline.ranges_
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
