"""What the view allows, and what a keyframe of it reaches, before a robot moves."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError, ServoscopeError
from servoscope.keyframe import Keyframe, Readings
from servoscope.keyframe.fitting import evenly_spread
from servoscope.poses import DISPLAY_FACTORS, DOFS
from servoscope.positioning.arrival import Reached
from servoscope.positioning.keyframe_model import (
    MOST_FITTED,
    MOST_READ,
    KeyframeModel,
    fit_and_read,
    read_right,
)
from servoscope.positioning.settings import LoopSettings
from servoscope.processes import ProgressBar, in_processes, no_progress, one_blas_thread
from servoscope.rehearsal.run import Rehearsal
from servoscope.rehearsal.true_view import reference_noise
from servoscope.selection.rms_interval import rms_interval

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LEAST_RIGHT = 0.5
"""Of fewer images read right the view is not explained by a relief."""

STARTS = 8
"""Starts of the rehearsed loop."""

_LOOKS = 16
_NO_END = dict.fromkeys(("end_mm", "end_deg", "end_rms"))
_LEAST_FITTED, _LEAST_READ = 10, 5


@dataclass(frozen=True, eq=False)
class FittedView:
    """A keyframe, and what it reads of images that it was not fitted to.

    Parameters
    ----------
    keyframe : Keyframe
    fitted, read : ndarray
        The images that it was fitted to, and those that it read.
    readings : Readings
    right : ndarray of bool
        Which of these it read right.
    """

    keyframe: Keyframe
    fitted: Indices
    read: Indices
    readings: Readings
    right: NDArray[np.bool_]

    @property
    def explains(self) -> bool:
        """Whether enough images are read right."""
        return bool(self.right.mean() >= LEAST_RIGHT)


def fit_view(data: PoseImageSet, learn: Indices, test: Indices) -> FittedView | None:
    """A keyframe of the images learned from, and how it reads the others; None if none fits.

    Parameters
    ----------
    data : PoseImageSet
    learn, test : ndarray
        Images that are independent of each other.
    """
    if len(learn) < _LEAST_FITTED or len(test) < _LEAST_READ:
        return None
    fitted, read = evenly_spread(learn, MOST_FITTED), evenly_spread(test, MOST_READ)
    try:
        keyframe, readings = fit_and_read(data, fitted, read)
    except InvalidInputError:
        return None
    right = read_right(np.abs(readings.errors) * mask_of(data.dofs), data.ranges())
    return FittedView(keyframe, fitted, read, readings, right)


@dataclass(frozen=True, eq=False)
class ViewFindings:
    """What a keyframe says of a view, by dof about the pivot, in mm and degrees.

    Parameters
    ----------
    model : KeyframeModel
        Without first guesses.
    limit : dict of str to float
        Standard deviation that no estimate from one image goes below: the Cramer-Rao bound of the
        grey levels at the reference.
    rms, interval : dict
        RMS error of one image each over those that were not learned from and were read right, and
        its 90 % interval.
    share_right : float
        Of these images.
    n_read : int
    loop : dict
        ``success``, the share of rehearsed starts that arrive; ``moves``, their median;
        ``end_rms`` by dof, ``end_mm`` and ``end_deg``, from the noise of the images; None where no
        start arrives.
    """

    model: KeyframeModel
    limit: dict[str, float]
    rms: dict[str, float]
    interval: dict[str, tuple[float, float]]
    share_right: float
    n_read: int
    loop: dict[str, Any]


@dataclass(frozen=True, eq=False)
class _Explained:
    """A view that a keyframe explains, and what it takes to rehearse on it."""

    view: FittedView
    limit: Array
    rehearsal: Rehearsal
    end: dict[str, Any]


Begun = Iterator[tuple["_Explained | None", list[Warning | str]]]
"""What `begin_view` began."""


def begin_view(
    data: PoseImageSet,
    learn: Indices,
    test: Indices,
    *,
    view: FittedView | None = None,
    seed: int = 0,
    n_jobs: int | None = -1,
) -> Begun:
    """Begin to fit a keyframe to the images learned from, in one of the processes.

    Parameters
    ----------
    data : PoseImageSet
    learn, test : ndarray
        Images that are independent of each other.
    view : FittedView, optional
        Of these images, where it is known.
    seed : int
        Of the rehearsed starts.
    n_jobs : int, optional
        Processes, as joblib counts them. One alone begins when `finish_view` asks.

    Returns
    -------
    iterator
        For `finish_view`.
    """
    return in_processes(_explain, [(data, learn, test, view, seed)], n_jobs)


def finish_view(
    begun: Begun,
    data: PoseImageSet,
    groups: Indices | None = None,
    *,
    n_jobs: int | None = -1,
    progress: ProgressBar = no_progress,
) -> ViewFindings | None:
    """What a keyframe of the images learned from reaches on the others; None if none fits.

    Parameters
    ----------
    begun : iterator
        From `begin_view`.
    data : PoseImageSet
        As it was begun with.
    groups : ndarray of shape (n_images,), optional
        Images that belong together.
    n_jobs : int, optional
        Processes, as joblib counts them; every number of them gives the same.
    progress : ProgressBar
    """
    with progress("keyframe", 1) as advance:
        explained, warned = next(begun)
        advance(1)
    for message in warned:
        warnings.warn(message, stacklevel=2)
    if explained is None:
        return None
    view, model = explained.view, explained.rehearsal.model
    errors = view.readings.errors[view.right] * DISPLAY_FACTORS
    of_group = None if groups is None else groups[view.read][view.right]
    if of_group is not None and len(np.unique(of_group)) < 2:
        of_group = None
    interval = rms_interval(errors, of_group)
    limit = explained.limit * DISPLAY_FACTORS
    loop = _rehearsed(explained.rehearsal, n_jobs, progress)
    loop |= explained.end if loop["success"] else _NO_END
    indices = [DOFS.index(dof) for dof in data.dofs]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    return ViewFindings(
        model,
        {DOFS[i]: float(limit[i]) for i in indices},
        {DOFS[i]: float(rms[i]) for i in indices},
        {DOFS[i]: (float(interval[0, i]), float(interval[1, i])) for i in indices},
        float(view.right.mean()),
        len(view.read),
        loop,
    )


def _explain(
    data: PoseImageSet, learn: Indices, test: Indices, view: FittedView | None, seed: int
) -> tuple[_Explained | None, list[Warning | str]]:
    """What one process finds of a view, and what it would have warned of."""
    with warnings.catch_warnings(record=True) as caught, one_blas_thread():
        warnings.simplefilter("always")
        view = view or fit_view(data, learn, test)
        explained = None if view is None or not view.explains else _explained(view, data, seed)
    return explained, [one.message for one in caught]


def _explained(view: FittedView, data: PoseImageSet, seed: int) -> _Explained | None:
    fitted, truth = data.subset(view.fitted), data.delta_p()[view.read]
    try:
        model = KeyframeModel.of_readings(view.keyframe, data, fitted, view.readings, truth)
    except ServoscopeError:
        return None
    rehearsal = Rehearsal(model, STARTS, seed)
    rehearsal.errors  # noqa: B018  found once, and kept
    limit = view.keyframe.limit().std
    return _Explained(view, limit, rehearsal, _end(model, seed))


def _rehearsed(rehearsal: Rehearsal, n_jobs: int | None, progress: ProgressBar) -> dict[str, Any]:
    """Whether the loop would arrive, on images rendered of the keyframe."""
    found = rehearsal.run("range_1.0", n_jobs=-1 if n_jobs is None else n_jobs, progress=progress)
    return {
        "success": found["success"] / found["trials"],
        "success_interval": found["success_interval"],
        "moves": found["moves_median"],
        "starts": found["trials"],
    }


def _end(model: KeyframeModel, seed: int) -> dict[str, Any]:
    """Where the loop ends by the noise of the images and of the reference image.

    Of the images that are averaged at the end the noise falls with the root of their number; that
    of the reference image, by which all are read, is the same for all. The rehearsed end is not
    taken: images rendered less than a pixel from the reference are smoother than real ones.
    """
    keyframe, rng = model.keyframe, np.random.default_rng([seed, _LOOKS])
    clean = keyframe.reference_image.astype(float)
    noisy = [clean + rng.normal(0, keyframe.noise, clean.shape) for _ in range(_LOOKS)]
    images = [np.rint(image.clip(0, 255)).astype(np.uint8) for image in noisy]
    read = np.array([keyframe.align(image, np.eye(4)).delta_p for image in images])
    shares = 1 / LoopSettings().final_images + (reference_noise(model) / keyframe.noise) ** 2
    std = np.where(mask_of(model.dofs), np.sqrt(shares * np.mean(read**2, axis=0)), 0.0)
    reached = Reached.of_deviation(std, keyframe.pivot)
    end_rms = dict(zip(DOFS, (std * DISPLAY_FACTORS).tolist(), strict=True))
    return {"end_mm": reached.mm, "end_deg": reached.deg, "end_rms": end_rms}
