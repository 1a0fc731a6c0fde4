"""What the loop refuses to do. Every check answers None, or the reason in a line."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from servoscope.poses import (
    DISPLAY_FACTORS,
    DISPLAY_UNITS,
    DOFS,
    displacements_from_poses,
    inverse_transform,
    is_rigid,
    pose_error,
    rigid_transform,
)
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.reference_view import thumbnail
from servoscope.positioning.settings import LoopSettings
from servoscope.wording import one_line

Array = NDArray[np.float64]

LEAST_CONTRAST = 0.1
"""Share of the reference's contrast that an image must have."""

NOTICEABLE = 0.01
"""Share of the reach that a motion must have for the image to change for certain."""

FARTHEST_M = 1000.0
"""No camera is farther from its reference."""

_FULL = 1 - 1e-6
"""Share of its limit that a step is cut to, so that no rounding carries it beyond."""

STANDING_M, STANDING_RAD = 2e-4, float(np.radians(0.04))
"""Changes of the reported pose up to this are no motion, whatever the repeatability."""


def image_format_fault(image: Any, image_shape: tuple[int, int]) -> str | None:
    """Of anything but a uint8 array of the shape that the estimator takes."""
    if not isinstance(image, np.ndarray):
        return f"The camera must give an array, but gave a {type(image).__name__}."
    if image.dtype != np.uint8 or image.ndim != 2:
        return (
            "The camera must give grey images, uint8 of shape (height, width), but gave "
            f"{image.dtype} of shape {image.shape}; convert them."
        )
    if image.shape != tuple(image_shape):
        height, width = image_shape
        return (
            f"The model takes images of {width} x {height} pixels, but the camera gave "
            f"{image.shape[1]} x {image.shape[0]}; set the camera to that size, or train a model "
            "with this camera."
        )
    return None


def exposure_fault(image: NDArray[np.uint8], reference: NDArray[np.uint8]) -> str | None:
    """Of a black, a saturated, or an empty image.

    A white part in a bright cell may be clipped over much of the reference itself: what counts
    is that most of what was not clipped there is clipped now.
    """
    for level, what, remedy in (
        (0, "black", "check the lens cap, the lights and the exposure"),
        (255, "saturated", "check the exposure and the lights"),
    ):
        share, at_reference = (
            np.count_nonzero(pixels == level) / pixels.size for pixels in (image, reference)
        )
        if share > (1 + at_reference) / 2:
            return (
                f"The image is {what}: {100 * share:.0f} % of it, {100 * at_reference:.0f} % of "
                f"the reference; {remedy}."
            )
    contrast, wanted = thumbnail(image).std(), LEAST_CONTRAST * thumbnail(reference).std()
    if contrast < wanted:
        what = "black" if image.mean() < LEAST_CONTRAST * reference.mean() else "empty"
        return (
            f"The image is {what}: its contrast is {contrast:.1f} grey levels, and at least "
            f"{wanted:.1f} are needed; check that the lens is free, the lights, and the part."
        )
    return None


def clipping_fault(usable: float, settings: LoopSettings) -> str | None:
    """Of an image with too many pixels that are clipped, though not in the reference."""
    if usable >= settings.least_usable:
        return None
    return (
        f"The image is clipped in {1 - usable:.0%} of what the reference shows, and at most "
        f"{1 - settings.least_usable:.0%} may be; check the exposure and the lights."
    )


def frozen_fault(moved: Array, reach: Array, pivot: float) -> str | None:
    """Of an image that is the same, bit for bit, as before the robot moved.

    Parameters
    ----------
    moved : ndarray of shape (4, 4)
        Displacement of the robot since the image changed last.
    reach : ndarray of shape (6,)
    pivot : float
    """
    size = np.abs(displacements_from_poses(np.eye(4), moved[None], pivot)[0])
    least = np.where(reach > 0, np.maximum(NOTICEABLE * reach, 1e-6), np.inf)
    if not (size > least).any():
        return None
    return (
        f"The image is frozen: not a bit of it changed while the robot moved {as_text(moved)}; "
        "start the camera again, and see that the robot really moves."
    )


def estimate_fault(estimate: Any) -> str | None:
    """Of what an estimator returns, if it is no estimate."""
    if not isinstance(estimate, Estimate):
        return f"The estimator must return an Estimate, but returned {type(estimate).__name__}."
    if not is_finite_rigid(estimate.displacement):
        return "The estimator gave no rigid displacement; nothing can be said of this image."
    if np.abs(estimate.displacement[:3, 3]).max() > FARTHEST_M:
        return f"The estimator gave a displacement of more than {FARTHEST_M:g} m."
    std = estimate.std
    if not isinstance(std, np.ndarray) or std.shape != (6,) or std.dtype.kind != "f":
        return f"The estimator must give six deviations as an array, but gave {one_line(std)}."
    if (std < 0).any():
        return f"The estimator must give deviations of 0 or more, but gave {one_line(std)}."
    for name in ("novelty", "similarity", "least_similarity"):
        value = getattr(estimate, name)
        if not isinstance(value, Real):
            return f"The estimator must give its {name} as a number, but gave {one_line(value)}."
    if np.isnan(estimate.least_similarity):  # no similarity would be below it
        return "The estimator must give its least_similarity as a number, but gave nan."
    if not isinstance(estimate.is_finest, bool | np.bool_):
        return "The estimator must say whether its stage is the finest by True or False."
    return None


def novelty_fault(estimate: Estimate, settings: LoopSettings) -> str | None:
    """Of an image unlike the training images, or unlike what is expected where it was taken."""
    advice = (
        "see that the part, its place, the lights and the lens are those of training, or train "
        "with these."
    )
    if estimate.novelty > settings.novelty_limit:
        return (
            f"The image is unlike the training images, {estimate.novelty:.2f} where at most "
            f"{settings.novelty_limit:.2f} is allowed; {advice}"
        )
    least = settings.least_similarity
    least = estimate.least_similarity if least is None else least
    if estimate.similarity < least:
        return (
            "The image is unlike the training images: its similarity with what is expected is "
            f"{estimate.similarity:.2f}, and at least {least:.2f} is needed; "
            f"{advice}"
        )
    return None


def workspace_fault(T_start: Array, T_next: Array, half_widths: Array) -> str | None:
    """Of a pose outside the box around the start, camera form, [m] and [rad]."""
    offset = np.abs(displacements_from_poses(T_start, T_next[None], pivot=0.0)[0])
    excess = offset / half_widths
    worst = int(np.argmax(excess))
    if excess[worst] <= 1:
        return None
    shown = DISPLAY_FACTORS[worst]
    return (
        f"The next move would carry {DOFS[worst]} {shown * offset[worst]:.1f} "
        f"{DISPLAY_UNITS[worst]} from the start, and {shown * half_widths[worst]:.1f} is the "
        "most; see that the view is free and lit as in training, and start nearer to the reference."
    )


def standing_fault(T_before: Array, T_now: Array, settings: LoopSettings) -> str | None:
    """Of a robot that has moved though nothing was commanded."""
    moved = inverse_transform(T_before) @ T_now
    distance, angle = (float(x) for x in pose_error(np.eye(4), moved))
    scatter_m, scatter_rad = settings.repeatability_mm / 1e3, np.radians(settings.repeatability_deg)
    if distance <= max(3 * scatter_m, STANDING_M) and angle <= max(3 * scatter_rad, STANDING_RAD):
        return None
    return (
        f"The robot was moved {as_text(moved)} since the image was taken, though no move was "
        "commanded, and none is from there; see that nothing else moves it, or give its "
        "repeatability if it was still settling."
    )


def execution_fault(commanded: Array, executed: Array, settings: LoopSettings) -> str | None:
    """Of a motion that is not the one that was asked for."""
    if settings.execution_share is None:  # it cannot go to every pose
        return None
    asked, missed = (
        np.array(pose_error(T, executed_from)).ravel()
        for T, executed_from in ((np.eye(4), commanded), (commanded, executed))
    )
    least = np.array([settings.execution_mm / 1e3, np.radians(settings.execution_deg)])
    if (missed <= np.maximum(settings.execution_share * asked, least)).all():
        return None
    return (
        f"The robot was to move {as_text(commanded)} and moved {as_text(executed)}; see what "
        "holds it back, and that it reports its pose in the frame that it moves in."
    )


def is_wandering(believed: Sequence[float], patience: int) -> bool:
    """Whether the believed distances of the last looks are all no less than the least before.

    Examples
    --------
    >>> is_wandering([40.0, 90.0, 60.0, 80.0], patience=3)
    True
    >>> is_wandering([90.0, 60.0, 40.0, 30.0], patience=3)
    False
    """
    return len(believed) > patience > 0 and min(believed[-patience:]) >= min(believed[:-patience])


def is_diverging(errors: Sequence[float], growth: float) -> bool:
    """Whether the image error has risen over two moves, clearly and in both of them.

    A hand in the view raises it once, and it does not rise on.

    Examples
    --------
    >>> is_diverging([0.5, 0.7, 0.8], 0.05), is_diverging([0.5, 0.7, 0.6], 0.05)
    (True, False)
    """
    if len(errors) < 3:
        return False
    *before, last_but_one, last = errors
    return last_but_one > min(before) + growth and last > last_but_one + growth / 5


def limited(displacement: Array, pivot: float, limits: tuple[float, float]) -> Array:
    """A displacement cut to a longest distance [m] and angle [rad], never beyond either.

    The cut motion turns about the pivot and carries it straight, so that the part stays in view.

    Examples
    --------
    >>> D = rigid_transform(np.eye(3), [0.1, 0.0, 0.0])
    >>> limited(D, 0.55, (0.025, 1.0))[:3, 3].round(4)
    array([0.025, 0.   , 0.   ])
    """
    P = rigid_transform(np.eye(3), [0.0, 0.0, pivot])
    about_pivot = inverse_transform(P) @ displacement @ P
    shift, centre = about_pivot[:3, 3], P[:3, 3]
    turn = Rotation.from_matrix(about_pivot[:3, :3]).as_rotvec()

    def use_of(share: float) -> float:
        """Of the limit that is nearer; the distance does not grow evenly with the turn."""
        moved = share * shift + centre - Rotation.from_rotvec(share * turn).apply(centre)
        sizes = np.array([np.linalg.norm(moved), share * np.linalg.norm(turn)])
        return float(np.max(sizes / limits))

    if not use_of(1.0) > 1:
        return displacement
    share = brentq(lambda share: use_of(share) - _FULL, 0.0, 1.0, xtol=1e-15)
    R = Rotation.from_rotvec(share * turn).as_matrix()
    return P @ rigid_transform(R, share * shift) @ inverse_transform(P)


def is_finite_rigid(T: Any) -> bool:
    """Whether this is a rigid transform of finite numbers, (4, 4)."""
    return (
        isinstance(T, np.ndarray)
        and T.shape == (4, 4)
        and T.dtype.kind == "f"
        and bool(np.isfinite(T).all())
        and is_rigid(T)
    )


def as_text(displacement: Array) -> str:
    """Size of a displacement for people.

    Examples
    --------
    >>> as_text(rigid_transform(np.eye(3), [0.0123, 0.0, 0.0]))
    '12.30 mm and 0.000 deg'
    """
    distance, angle = pose_error(np.eye(4), displacement)
    return f"{1e3 * float(distance):.2f} mm and {np.degrees(float(angle)):.3f} deg"
