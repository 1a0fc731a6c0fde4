"""How a person moves a camera back to where it was, from one image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from servoscope.dofs import mask_of
from servoscope.errors import CameraFaultError, ModelError
from servoscope.poses import (
    DISPLAY_FACTORS,
    DISPLAY_UNITS,
    DOFS,
    displacements_from_poses,
    inverse_transform,
    pose_error,
)
from servoscope.positioning import arrival, guard
from servoscope.positioning.interfaces import Array, Estimate, Estimator, Image, dofs_of
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.positioning.reference_view import ReferenceView
from servoscope.positioning.result import Step, plain
from servoscope.positioning.settings import LoopSettings

AIM_SETTINGS = LoopSettings(tolerance_mm=1.0, tolerance_deg=0.2)
"""When a camera that a person moves is near enough."""

WORDS = (
    ("left", "right"),
    ("up", "down"),
    ("farther", "nearer"),
    ("look down", "look up"),
    ("look left", "look right"),
    ("turn anticlockwise", "turn clockwise"),
)
"""What a negative and a positive correction asks for, by dof, seen from behind the camera."""

STATUSES = ("aimed", "move", "unrecognised")
"""What an image may say of the camera."""


@dataclass(frozen=True, eq=False)
class Aim:
    """How the camera has to be moved.

    Parameters
    ----------
    status : str
        One of `STATUSES`.
    message : str
        One line for a person.
    motion : ndarray of shape (4, 4)
        The displacement that brings the camera back, in its present axes, [m]; NaN where the view
        is not recognised.
    std : ndarray of shape (6,)
        Standard deviation that is believed of each dof of `motion`, [m] and [rad].
    dofs : tuple of str
        Degrees of freedom that are read.
    axes : str
        ``"camera"``: x right, y down, z forward. ``"poses"``: the axes of the frame whose poses
        the model was trained on, where it does not know how the camera sits in it.
    estimate : Estimate
        What the model says of the image.
    """

    status: str
    message: str
    motion: Array
    std: Array
    dofs: tuple[str, ...]
    axes: str
    estimate: Estimate

    @property
    def correction(self) -> Array:
        """`motion` as a translation and Euler angles, (6,), [m] and [rad]."""
        if not np.isfinite(self.motion).all():
            return np.full(6, np.nan)
        return displacements_from_poses(np.eye(4), self.motion[None], 0.0)[0]

    @property
    def distance(self) -> float:
        """How far the camera is from where it was, [m]."""
        return float(np.linalg.norm(self.motion[:3, 3]))

    @property
    def angle(self) -> float:
        """How far it is turned from how it was, [rad]."""
        if not np.isfinite(self.motion).all():
            return float("nan")
        return float(pose_error(np.eye(4), self.motion)[1])

    def words(self) -> list[str]:
        """What to do, dof by dof: ``right 3.20 mm``; empty where the view is not recognised.

        In the axes of the poses a dof is named instead: ``tx +3.20 mm``.
        """
        shown = DISPLAY_FACTORS * self.correction
        said = []
        for dof, value, unit, words in zip(DOFS, shown, DISPLAY_UNITS, WORDS, strict=True):
            if dof not in self.dofs or not np.isfinite(value):
                continue
            if self.axes == "camera":
                said.append(f"{words[int(value > 0)]} {abs(value):.2f} {unit}")
            else:
                said.append(f"{dof} {value:+.2f} {unit}")
        return said

    def to_dict(self) -> dict[str, Any]:
        """The facts as plain JSON values, in mm and degrees; NaN becomes None."""
        corrections = plain(DISPLAY_FACTORS * self.correction)
        deviations = plain(DISPLAY_FACTORS * self.std)
        rows = zip(DOFS, corrections, deviations, DISPLAY_UNITS, strict=True)
        return {
            "status": self.status,
            "message": self.message,
            "axes": self.axes,
            "correction": {
                dof: {"value": value, "std": std, "unit": unit}
                for dof, value, std, unit in rows
                if dof in self.dofs
            },
            "words": self.words(),
            "distance_mm": plain(np.float64(1e3 * self.distance)),
            "angle_deg": plain(np.float64(np.degrees(self.angle))),
            "similarity": plain(np.float64(self.estimate.similarity)),
            "least_similarity": plain(np.float64(self.estimate.least_similarity)),
        }


def aim(
    model: Estimator,
    image: Image,
    settings: LoopSettings = AIM_SETTINGS,
    previous: Aim | None = None,
) -> Aim:
    """How a person has to move a camera, for it to be where it was.

    Parameters
    ----------
    model : Estimator
        Such as a `PositioningModel`.
    image : ndarray of shape (height, width), uint8
    settings : LoopSettings
        Its tolerances and limits of what is recognised count.
    previous : Aim, optional
        Of the image before, near which the camera still is.

    Returns
    -------
    Aim

    Raises
    ------
    CameraFaultError
        If the image is not of the size or kind that the model takes.
    ModelError
        If the model gives no estimate.

    Examples
    --------
    >>> import servoscope as sv
    >>> def watch(model, camera):
    ...     reading = None
    ...     while reading is None or reading.status != "aimed":
    ...         reading = sv.aim(model, camera.read(), previous=reading)
    ...         print(reading.message, ", ".join(reading.words()))
    """
    reference = model.reference_image
    if fault := guard.image_format_fault(image, model.image_shape):
        raise CameraFaultError(fault)
    view = ReferenceView(reference)
    estimate = model.estimate(image, None if previous is None else previous.estimate)
    if fault := guard.estimate_fault(estimate):
        raise ModelError(fault)
    fault = (
        guard.exposure_fault(image, reference)
        or guard.clipping_fault(view.usable(image), settings)
        or guard.novelty_fault(estimate, settings)
    )
    mount, axes = _mount(model)
    dofs = dofs_of(model)
    if fault:
        unknown = np.full((4, 4), np.nan)
        said = f"The view is not recognised. {fault}"
        return Aim("unrecognised", said, unknown, np.full(6, np.nan), dofs, axes, estimate)
    motion = inverse_transform(mount) @ inverse_transform(estimate.displacement) @ mount
    std = std_of_camera(estimate.std, mount, model.pivot, dofs)
    step = Step(np.eye(4), np.nan, estimate, None, None, np.nan, view.compare(image))
    status, message = _status(step, motion, std, settings)
    return Aim(status, message, motion, std, dofs, axes, estimate)


def _status(step: Step, motion: Array, std: Array, settings: LoopSettings) -> tuple[str, str]:
    away = guard.as_text(motion)
    if not arrival.is_within_tolerance(motion, settings):
        return "move", f"The camera is {away} from where it was."
    there = f"The camera is back, {away} from where it was, as believed."
    if found := arrival.doubts(step, settings):
        return "move", f"The camera seems to be back, but {'; '.join(found)}."
    known = np.where(np.isnan(std), 0.0, std)
    if excess := arrival.Reached.of_deviation(known, 0.0).excess(settings):
        return "move", f"The camera seems to be back, but the believed deviation is {excess}."
    return "aimed", there + arrival.caution(step)


def _mount(model: Estimator) -> tuple[Array, str]:
    """Camera coordinates to those of the trained poses, and the axes that corrections are in."""
    if isinstance(model, KeyframeModel):
        informed = model.keyframe.observable
        if informed["mount_rotation"] and informed["mount_translation"]:
            return model.keyframe.mount, "camera"
    return np.eye(4), "poses"


def std_of_camera(std: Array, mount: Array, pivot: float, dofs: Sequence[str]) -> Array:
    """Deviations at the camera and in its axes of what is believed about the pivot.

    The errors about the pivot are taken to be independent. Turning the frame by a small error
    about the pivot carries the camera sideways.

    Parameters
    ----------
    std : ndarray of shape (6,)
        About the pivot, [m] and [rad].
    mount : ndarray of shape (4, 4)
        Camera coordinates to those of the frame, [m].
    pivot : float
        Distance of the pivot along z of the frame, [m].
    dofs : sequence of str
        Those that are read; nothing is wrong with the others.

    Returns
    -------
    ndarray of shape (6,)
        [m] and [rad].
    """
    is_read = mask_of(tuple(dofs))
    variances = np.where(is_read, np.square(std), 0.0)
    x, y, z = mount[:3, 3] - [0.0, 0.0, pivot]
    carried = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    to_camera = mount[:3, :3].T
    zero = np.zeros((3, 3))
    A = np.block([[to_camera, to_camera @ carried], [zero, to_camera]])
    found: Array = np.sqrt(np.square(A) @ variances)
    return found
