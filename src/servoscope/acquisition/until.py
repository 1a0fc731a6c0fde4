"""Taking images until a keyframe of them will be as accurate as is asked, and no more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from servoscope.acquisition.simulated import AcquisitionConfig, take_image, take_reference
from servoscope.data import folder as dataset_folder
from servoscope.data.folder import (
    Folder,
    Progress,
    forget_progress,
    keep_image,
    kept_images,
    read_progress,
    write_progress,
)
from servoscope.data.images import PoseImageSet
from servoscope.dofs import RequestedAccuracy
from servoscope.errors import DataSetError, FolderExistsError
from servoscope.keyframe import (
    AccuracyForecast,
    Keyframe,
    forecast_accuracy,
    next_displacements,
    read_held_out,
)
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS, displacements_from_poses
from servoscope.processes import in_processes

Array = NDArray[np.float64]
Images = NDArray[np.uint8]
Take = Callable[[int, Array], tuple[Images, Array]]

FIRST, NEXT = 15, 10
"""Images that are taken before the first forecast, and between any two."""

MOST_IMAGES = 100
"""Most images that are taken unless more are allowed."""

N_GROUPS = 3
"""Groups of images that are held out in turn."""

_SUREST = 2e-5


@dataclass(frozen=True, eq=False)
class Standing:
    """What the images that are there promise, by the keyframe that was fitted to them."""

    n_images: int
    keyframe: Keyframe
    forecast: AccuracyForecast
    request: RequestedAccuracy

    @property
    def lacking(self) -> dict[str, float]:
        """How many times too large the forecast is, by dof; empty if the request is met."""
        return _beyond(self.forecast.look, self.request)

    @property
    def unreachable(self) -> dict[str, float]:
        """How many times too large even the limit of the view is, by dof."""
        return _beyond(self.forecast.limit, self.request)

    def facts(self) -> dict[str, Any]:
        """Plain JSON values: median errors in mm and degrees, and whether they meet the request."""
        dofs = self.keyframe.dofs
        errors = {name: _shown(value, dofs) for name, value in vars(self.forecast).items()}
        return {"until": str(self.request), "met": not self.lacking, **errors}

    def __str__(self) -> str:
        dofs = self.keyframe.dofs
        line = (
            f"{self.n_images} images: one look errs by {_said(self.forecast.look, dofs)} (median)"
        )
        if self.unreachable:
            best = f"the view itself allows {_said(self.forecast.limit, dofs)} at best"
            asked = f"{_times(self.unreachable)}: go nearer, or look at more detail"
            return f"{line}; {best}, which is {asked}"
        return f"{line}; {_times(self.lacking) if self.lacking else 'the request is met'}"


def take_until(
    take: Take,
    reference_image: Images,
    T_world_ref: Array,
    request: RequestedAccuracy,
    *,
    pivot: float,
    ranges: Array,
    most: int = MOST_IMAGES,
    pose_noise: tuple[float, float] = (3e-4, 5e-4),
    taken: tuple[Images, Array] | None = None,
    seed: int = 0,
    n_jobs: int | None = -1,
    on_standing: Callable[[Standing], object] | None = None,
) -> tuple[Images, Array, Standing]:
    """Have images taken until the forecast of one look over the range meets a request.

    `FIRST` displacements are spread over the range; then, `NEXT` at a time, images are taken where
    most is learned. Between them a keyframe is fitted, and its accuracy forecast from groups that
    are held out.

    Parameters
    ----------
    take : callable
        ``take(i, displacements)`` takes images i, i + 1, ... at displacements of shape (n, 6)
        about the pivot, [m] and [rad], or near them, and returns the images, and the poses
        (n, 4, 4) that the robot reported, [m].
    reference_image : ndarray of shape (height, width), uint8
    T_world_ref : ndarray of shape (4, 4)
    request : RequestedAccuracy
    pivot : float
        [m].
    ranges : ndarray of shape (6,)
        Largest displacements about the pivot, [m] and [rad]; 0 in dofs that the robot has not.
    most : int
        Images at most.
    pose_noise : tuple of 2 floats
        Standard deviations of the reported poses, [m] and [rad].
    taken : tuple of images and poses, optional
        What an interrupted acquisition has taken already.
    seed : int
        Draws the displacements; the number of processes changes nothing.
    on_standing : callable, optional
        Called after every forecast.

    Returns
    -------
    images, poses, Standing
    """
    empty = np.empty((0, *reference_image.shape), np.uint8), np.empty((0, 4, 4))
    images, poses = empty if taken is None else taken
    n_later = max(0, len(images) - FIRST) // NEXT
    edge = min(FIRST + NEXT * n_later, most)
    wanted = spread_displacements(min(FIRST, most), ranges, seed)
    while True:
        if len(images) < edge:
            more = take(len(images), wanted[len(images) - edge :])
            images, poses = np.concatenate([images, more[0]]), np.concatenate([poses, more[1]])
        standing = _standing(
            images[:edge], poses[:edge], reference_image, T_world_ref, request, pivot, ranges,
            pose_noise, seed, n_jobs,
        )  # fmt: skip
        if on_standing is not None:
            on_standing(standing)
        is_over = not standing.lacking or standing.unreachable or edge >= most
        if is_over and len(images) <= edge:
            return images, poses, standing
        n = min(NEXT, most - edge)
        wanted = next_displacements(
            standing.keyframe, n, ranges, pose_noise=pose_noise, random_state=seed + edge
        )
        edge += n


def spread_displacements(n: int, ranges: Array, seed: int) -> Array:
    """Displacements spread over a range: a scrambled Sobol sequence, (n, 6), [m] and [rad]."""
    points = qmc.Sobol(6, rng=np.random.default_rng(seed)).random_base2(max(1, n - 1).bit_length())
    return np.asarray((2 * points[:n] - 1) * ranges)


def acquire_until(
    folder: Folder,
    config: AcquisitionConfig,
    request: RequestedAccuracy,
    *,
    n_jobs: int = -1,
    force: bool = False,
    on_progress: Callable[[int], object] | None = None,
    on_standing: Callable[[Standing], object] | None = None,
) -> PoseImageSet:
    """Take images of the simulated part until the forecast meets a request.

    Interrupted, it goes on where it stopped when it is repeated, and ends with the same images.

    Parameters
    ----------
    folder : path-like
    config : AcquisitionConfig
        Its `n_images` are the most that are taken; it has no schedule.
    request : RequestedAccuracy
    force : bool
        Replace a data set that is there.
    on_standing : callable, optional
        Called after every forecast.

    Returns
    -------
    PoseImageSet
        ``source["forecast"]`` holds the last forecast.

    Raises
    ------
    FolderExistsError
        If the folder holds a data set that was asked for otherwise.
    FolderInUseError
        If another command is writing there.
    RobotFaultError
        If the robot reaches none of the poses that are drawn for an image.
    InvalidInputError
        If no keyframe can be fitted to the images.
    """
    if config.n_reference_images is None:
        config = replace(config, n_reference_images=16)
    plan = _plan(config, request)
    begun = not dataset_folder.is_finished(folder) and _plan_in(folder) == plan
    with dataset_folder.writing(folder, replace=force and not begun, resumable=True) as place:
        if not _is_finished(place, plan, force):
            _take_all(place, plan, config, request, n_jobs, on_progress, on_standing)
    return PoseImageSet.load(folder)


def _take_all(
    folder: Path,
    plan: dict[str, Any],
    config: AcquisitionConfig,
    request: RequestedAccuracy,
    n_jobs: int,
    on_progress: Callable[[int], object] | None,
    on_standing: Callable[[Standing], object] | None,
) -> None:
    reference_image, T_world_ref, noise = take_reference(config)

    def take(start: int, displacements: Array) -> tuple[Images, Array]:
        calls = [(config, T_world_ref, start + k, d) for k, d in enumerate(displacements)]
        for i, taken in enumerate(in_processes(take_image, calls, n_jobs), start):
            keep_image(folder, i, *taken)
            write_progress(folder, Progress(plan, i + 1))
            if on_progress is not None:
                on_progress(i + 1)
        images, poses, _ = kept_images(folder)
        return images[start:], poses[start:]

    before, before_poses, _ = kept_images(folder)
    pivot, ranges = config.pivot(T_world_ref), config.pivot_ranges()
    repeatability = config.repeatability()
    sure = (max(repeatability.position, _SUREST), max(repeatability.rotation, _SUREST))
    images, poses, standing = take_until(
        take, reference_image, T_world_ref, request,
        pivot=pivot, ranges=ranges, most=config.total(), pose_noise=sure,
        taken=(before, before_poses) if len(before) else None,
        seed=config.seed, n_jobs=n_jobs, on_standing=on_standing,
    )  # fmt: skip
    n_replaced = int(kept_images(folder)[2].sum())
    dataset_folder.finish_kept(
        folder,
        images,
        reference_image=reference_image,
        T_world_ref=T_world_ref,
        T_world_cam=poses,
        names=[f"{i:06d}" for i in range(len(images))],
        times=None,
        meta={
            **config.meta(T_world_ref),
            "source": {
                **plan,
                "n_images": len(images),
                "rings": f"{len(images)}@1.0",
                "n_replaced": n_replaced,
                **noise,
                "forecast": standing.facts(),
            },
        },
    )


def _plan(config: AcquisitionConfig, request: RequestedAccuracy) -> dict[str, Any]:
    """What is being made, as plain JSON values; how many images it takes is found out."""
    plan = config.plan()
    del plan["rings"]
    return {**plan, "most_images": plan.pop("n_images"), "until": str(request)}


def _plan_in(folder: Folder) -> dict[str, Any] | None:
    try:
        progress = read_progress(folder)
    except DataSetError:
        return None
    return None if progress is None else progress.plan


def _is_finished(folder: Path, plan: dict[str, Any], force: bool) -> bool:
    """Whether all is there; what is not of this plan is removed with `force`, or refused."""
    if dataset_folder.is_finished(folder):
        source = dataset_folder.read_meta(folder)["source"]
        if {key: source.get(key) for key in plan} == plan:
            forget_progress(folder)  # it may have stopped just before
            return True
    elif _plan_in(folder) == plan:
        return False
    elif not force and _plan_in(folder) is not None:
        raise FolderExistsError(
            f"{folder} holds an unfinished acquisition of other settings; repeat them to finish "
            "it, replace it with --force, or name another folder."
        )
    if force:
        dataset_folder.remove(folder)
    dataset_folder.check_free(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_progress(folder, Progress(plan, 0))
    return False


def _standing(
    images: Images,
    poses: Array,
    reference_image: Images,
    T_world_ref: Array,
    request: RequestedAccuracy,
    pivot: float,
    ranges: Array,
    pose_noise: tuple[float, float],
    seed: int,
    n_jobs: int | None,
) -> Standing:
    """Keyframe and forecast of some images."""
    groups = np.arange(len(images)) % N_GROUPS
    dofs = tuple(dof for dof, most in zip(DOFS, ranges, strict=True) if most > 0)
    looks = read_held_out(
        images, poses, reference_image, T_world_ref, groups, n_jobs=n_jobs, pivot=pivot, dofs=dofs
    )
    keyframe = Keyframe.fit(images, poses, reference_image, T_world_ref, pivot=pivot, dofs=dofs)
    forecast = forecast_accuracy(
        keyframe,
        looks,
        displacements_from_poses(T_world_ref, poses, pivot),
        ranges,
        n_groups=N_GROUPS,
        pose_noise=pose_noise,
        random_state=seed,
    )
    return Standing(len(images), keyframe, forecast, request)


def _beyond(errors: Array, request: RequestedAccuracy) -> dict[str, float]:
    ratios = zip(DOFS, errors / request.by_dof, strict=True)
    return {dof: float(ratio) for dof, ratio in ratios if not ratio <= 1}


def _shown(values: Array, dofs: tuple[str, ...]) -> dict[str, float]:
    by_dof = dict(zip(DOFS, (values * DISPLAY_FACTORS).tolist(), strict=True))
    return {dof: by_dof[dof] for dof in dofs}


def _said(errors: Array, dofs: tuple[str, ...]) -> str:
    units = dict(zip(DOFS, DISPLAY_UNITS, strict=True))
    return ", ".join(
        f"{dof} {value:.2g} {units[dof]}" for dof, value in _shown(errors, dofs).items()
    )


def _times(ratios: dict[str, float]) -> str:
    said = ", ".join(f"{dof} {ratio:.2f} times" for dof, ratio in ratios.items())
    return f"{said} what is asked"
