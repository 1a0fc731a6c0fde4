"""The error under a disturbance: simulated, and predicted from derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition_config import AcquisitionConfig
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.processes import in_processes, one_blas_thread
from servoscope.sensitivity.disturbances import Disturbance
from servoscope.sensitivity.first_order import predict_rms
from servoscope.sensitivity.growth import ErrorGrowth
from servoscope.sensitivity.looks import take_images
from servoscope.sensitivity.pose_model import PoseModel

Array = NDArray[np.float64]

Growths = dict[str, dict[str, ErrorGrowth]]
"""By model and dof."""

Features = dict[float, Array]
"""Of the images at each strength, 0 being undisturbed, (n_draws, n_images, n_features)."""

N_DRAWS = 2
"""Draws of a random disturbance for each image."""


def measure(
    disturbance: Disturbance,
    models: Mapping[str, PoseModel],
    config: AcquisitionConfig,
    numbers: Sequence[int],
    *,
    n_draws: int = N_DRAWS,
    n_jobs: int = -1,
    on_progress: Callable[[int], object] | None = None,
) -> Growths:
    """How the errors of trained models grow with a disturbance that they were not trained for.

    Parameters
    ----------
    disturbance : Disturbance
    models : dict of PoseModel
    config : AcquisitionConfig
        What the models were trained for.
    numbers : sequence of int
        The images of it that test.
    n_draws : int
        Draws of a random disturbance for each image.
    n_jobs : int
        Processes, as joblib counts them; every number of them gives the same errors.
    on_progress : callable, optional
        Called with the number of sets of images that were taken, of `n_sets`.

    Returns
    -------
    dict of dicts of ErrorGrowth
        By model and dof.

    Notes
    -----
    The error is that of the displacement about the pivot, against the one that the robot reports.
    With ``p`` the prediction, ``f`` the features and ``phi`` the strength, or its square where
    the image changes with that, the error of image ``i`` is to first order ``e_i(0) +
    (dp/df)(df/dphi)_i phi``. The first derivative is the regressors' own, the second a central
    difference of images taken at a small strength to both sides (to one side of ``phi = 0``
    where it cannot be negative). A random disturbance goes another way in every image and draw,
    so that over many the mean square grows by ``phi^2`` times the sum of the squared derivatives
    by all that is drawn.
    """
    draws = range(n_draws if disturbance.is_random else 1)
    strengths = all_strengths(disturbance)
    calls: list[tuple[Any, ...]] = [(config, numbers)]
    calls += [(config, numbers, disturbance, s, k) for s in strengths for k in draws]
    rows: dict[str, list[Array]] = {name: [] for name in models}
    with one_blas_thread():
        for n_done, images in enumerate(in_processes(take_images, calls, n_jobs), start=1):
            for name, model in models.items():
                rows[name].append(model.transform(images))
            if on_progress is not None:
                on_progress(n_done)
        told = config.displacements()[list(numbers)]
        growths = {}
        for name, model in models.items():
            clean, *disturbed = rows[name]
            blocks = np.stack(disturbed).reshape(len(strengths), len(draws), *clean.shape)
            features = {0.0: clean[None], **dict(zip(strengths, blocks, strict=True))}
            growths[name] = _growths(disturbance, model, features, told)
    return growths


def n_sets(disturbance: Disturbance, n_draws: int = N_DRAWS) -> int:
    """How many sets of images `measure` takes."""
    return 1 + len(all_strengths(disturbance)) * (n_draws if disturbance.is_random else 1)


def all_strengths(disturbance: Disturbance) -> list[float]:
    """All strengths at which images are taken, those of the derivatives too."""
    behind = {-step for step in disturbance.steps} if disturbance.power == 1 else set()
    return sorted({*disturbance.strengths, *disturbance.steps, *behind})


def _growths(
    disturbance: Disturbance, model: PoseModel, features: Features, told: Array
) -> dict[str, ErrorGrowth]:
    clean_errors = _errors(model, features[0.0], told)[0]
    simulated = np.stack([_errors(model, features[s], told) for s in disturbance.strengths])
    first, second = (_slopes(disturbance, model, features, step) for step in disturbance.steps)
    return error_growths(disturbance, clean_errors, simulated, (first, second))


def error_growths(
    disturbance: Disturbance, clean_errors: Array, simulated: Array, slopes: tuple[Array, Array]
) -> dict[str, ErrorGrowth]:
    """The growth of each dof's error.

    Parameters
    ----------
    disturbance : Disturbance
    clean_errors : ndarray of shape (n_images, 6)
        [mm] and [deg].
    simulated : ndarray of shape (n_strengths, n_draws, n_images, 6)
        Errors at the strengths of the disturbance.
    slopes : pair of ndarrays of shape (n_draws, n_images, 6)
        Derivatives of the errors, see `predict_rms`.
    """
    phi = [s**disturbance.power for s in disturbance.strengths]
    predicted_rms = predict_rms(clean_errors, slopes, phi)
    simulated_rms = np.sqrt((simulated**2).mean(axis=(1, 2)))
    bias = simulated.mean(axis=(1, 2))
    clean_rms = np.sqrt((clean_errors**2).mean(axis=0))
    return {
        dof: ErrorGrowth(
            strengths=disturbance.strengths,
            unit=disturbance.unit,
            simulated_rms=tuple(simulated_rms[:, i].tolist()),
            predicted_rms=tuple(predicted_rms[:, i].tolist()),
            simulated_bias=tuple(bias[:, i].tolist()),
            clean_rms=float(clean_rms[i]),
            error_unit=DISPLAY_UNITS[i],
            power=disturbance.power,
        )
        for i, dof in enumerate(DOFS)
    }


def _errors(model: PoseModel, features: Array, told: Array) -> Array:
    """Told from the features minus told by the robot, (n_draws, n_images, 6), [mm] and [deg]."""
    return (np.stack([model.predict(X) for X in features]) - told) * DISPLAY_FACTORS


def _slopes(disturbance: Disturbance, model: PoseModel, features: Features, step: float) -> Array:
    """Derivatives of the errors by ``phi``, (n_draws, n_images, 6), [mm] and [deg]."""
    directions = differences(disturbance, features, step)
    clean = features[0.0][0]
    return np.stack([model.slope(clean, d) for d in directions]) * DISPLAY_FACTORS


def differences(disturbance: Disturbance, values: Mapping[float, Array], step: float) -> Array:
    """Derivatives of values by ``phi``, from those at a step of the strength and without it."""
    if disturbance.power == 1:
        return (values[step] - values[-step]) / (2 * step)
    return (values[step] - values[0.0]) / step**disturbance.power
