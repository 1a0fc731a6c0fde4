"""What a viewer shows, as plain data: the reference view in space, and a run look by look.

All is in the axes of the reference camera: x to the right, y down, z forward, [m].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.keyframe import Keyframe
from servoscope.keyframe.levels import FAR, View
from servoscope.keyframe.motion import conjugate
from servoscope.poses import (
    DISPLAY_FACTORS,
    DOFS,
    displacements_from_poses,
    inverse_transform,
)
from servoscope.positioning.guard import as_text, is_finite_rigid
from servoscope.positioning.interfaces import Array, Estimator, Image, dofs_of
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.positioning.result import Step
from servoscope.viewer.way import Way

WIDEST_RELIEF = 240
"""Points of the relief along the width of the view, at most."""

UNKNOWN_FOCAL_LENGTH = 1.0
"""What a camera that is not known is drawn with, [image widths]."""

BAND = 2.0
"""Half the width of the band of what is believed, in standard deviations."""

_STRONGEST = 64.0
_FALLBACK_DISTANCE = 0.5


class Relief(NamedTuple):
    """The reference view as points in space.

    Parameters
    ----------
    points : ndarray of shape (n, 3), float32
        [m].
    grey : ndarray of shape (n,), uint8
        What is seen there.
    trust : ndarray of shape (n,), float32
        How well the images of training agree with each point, 0 to 1.
    spacing : float
        Typical distance of neighbours, [m].
    """

    points: NDArray[np.float32]
    grey: NDArray[np.uint8]
    trust: NDArray[np.float32]
    spacing: float

    @classmethod
    def of(cls, keyframe: Keyframe) -> Relief | None:
        """The points of a keyframe; None if it knows of no depth.

        Points that the keyframe does not use are left out.
        """
        width = min(WIDEST_RELIEF, keyframe.reference_image.shape[1])
        view = View.of(keyframe.reference_image, width, 0.0)
        inverse_depth = view.resize(keyframe.inverse_depth).ravel()
        trust = view.resize(keyframe.trust).ravel().clip(0, 1)
        used = (inverse_depth > FAR) & (trust > 0)
        if not used.any():
            return None
        rays, _ = keyframe.camera.rays(view.points[used])
        depth = 1 / inverse_depth[used].astype(float)
        points = np.column_stack([rays * depth[:, None], depth]).astype(np.float32)
        grey = np.rint(view.grey.ravel()[used]).astype(np.uint8)
        spacing = float(np.median(depth)) / (keyframe.camera.f * view.width)
        return cls(points, grey, trust[used], spacing)

    def colours(self, by: str) -> NDArray[np.uint8]:
        """Red, green and blue of each point, (n, 3), by ``"image"``, ``"depth"`` or ``"trust"``.

        Of depth and trust, brighter is nearer and better.
        """
        if by == "image":
            return np.repeat(self.grey[:, None], 3, axis=1)
        if by == "trust":
            share = self.trust
        else:
            near, far = np.quantile(self.points[:, 2], [0.02, 0.98])
            share = (far - self.points[:, 2]) / max(far - near, 1e-9)
        levels = np.rint(255 * share.clip(0, 1)).astype(np.uint8)
        return np.asarray(cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1])


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same through a run.

    Parameters
    ----------
    reference_image : ndarray of shape (height, width), uint8
    pivot : float
        Distance along z of the point that displacements are taken about, [m].
    dofs : tuple of str
        The degrees of freedom that are commanded.
    mount : ndarray of shape (4, 4)
        Camera coordinates to those of the frame whose poses the robot reports, [m].
    focal_length : float or None
        [image widths]; None if the camera is not known.
    relief : Relief or None
        None if no depth is known.
    """

    reference_image: Image
    pivot: float
    dofs: tuple[str, ...] = DOFS
    mount: Array = field(default_factory=lambda: np.eye(4))
    focal_length: float | None = None
    relief: Relief | None = None

    @classmethod
    def of_estimator(cls, estimator: Estimator) -> Setting:
        """That of a model or any other estimator; only a keyframe knows camera and depth."""
        image, pivot, dofs = estimator.reference_image, estimator.pivot, dofs_of(estimator)
        if not isinstance(estimator, KeyframeModel):
            return cls(image, float(pivot), dofs)
        keyframe = estimator.keyframe
        return cls(
            image, float(pivot), dofs, keyframe.mount, keyframe.camera.f, Relief.of(keyframe)
        )

    def known_by(self, estimator: Estimator | None) -> Setting:
        """The same with what an estimator of this view knows, if there is one.

        Raises
        ------
        InvalidInputError
            If it has another reference image.
        """
        if estimator is None:
            return self
        if not np.array_equal(estimator.reference_image, self.reference_image):
            raise InvalidInputError(
                "The model must be of the same reference image as what is shown; leave it out to "
                "see that without the relief."
            )
        return Setting.of_estimator(estimator)

    @property
    def distance(self) -> float:
        """Of the part from the reference camera, roughly, [m]."""
        if self.relief is not None:
            return float(np.median(self.relief.points[:, 2]))
        return self.pivot if self.pivot > 0 else _FALLBACK_DISTANCE

    @property
    def field_of_view(self) -> float:
        """From the top to the bottom of the image, [rad]."""
        height, width = self.reference_image.shape
        return float(
            2 * np.arctan(0.5 * height / width / (self.focal_length or UNKNOWN_FOCAL_LENGTH))
        )

    def camera_at(self, displacement: Array) -> Array:
        """Pose of the camera where the reported frame is displaced so, (4, 4)."""
        return conjugate(self.mount, displacement)

    def dofs_at(self, displacement: Array) -> Array:
        """The six numbers of a displacement about the pivot, [mm] and [deg]."""
        delta_p = displacements_from_poses(np.eye(4), displacement[None], self.pivot)[0]
        return np.asarray(DISPLAY_FACTORS * delta_p)


@dataclass(frozen=True, eq=False)
class Look:
    """One image, and where it was taken.

    Parameters
    ----------
    image : ndarray of shape (height, width), uint8
    camera : ndarray of shape (4, 4)
        Where the camera is believed to be, [m].
    displacement, std : ndarray of shape (6,)
        From the reference, and its believed standard deviation, about the pivot, [mm] and [deg];
        NaN where nothing is believed.
    next_camera : ndarray of shape (4, 4) or None
        Where the move that follows would bring the camera; None if none follows.
    truth : ndarray of shape (6,) or None
        What the displacement is in truth, [mm] and [deg]; None if that is not known.
    words : str
        The same for a person.
    """

    image: Image
    camera: Array
    displacement: Array
    std: Array
    next_camera: Array | None = None
    truth: Array | None = None
    words: str = ""

    @classmethod
    def of_step(
        cls, step: Step, image: Image, setting: Setting, truth: Array | None = None
    ) -> Look:
        """The look of a step of the loop.

        Parameters
        ----------
        step : Step
        image : ndarray of shape (height, width), uint8
        setting : Setting
        truth : ndarray of shape (4, 4), optional
            The displacement of the reported frame as it is, [m].

        Raises
        ------
        InvalidInputError
            If the image has another size than the reference image, or a displacement is not rigid.
        """
        if image.shape != setting.reference_image.shape:
            raise InvalidInputError(
                f"A look must have the size of the reference image, "
                f"{_size(setting.reference_image)}, got {_size(image)}."
            )
        believed, move = step.estimate.displacement, step.commanded
        if not is_finite_rigid(believed) or (move is not None and not is_finite_rigid(move)):
            raise InvalidInputError(
                "The displacements of a look must be finite and rigid; those of a damaged log "
                "cannot be shown."
            )
        words = (
            f"Believed {as_text(believed)} from the reference, by the stage {step.estimate.stage}."
        )
        if move is not None:
            words += f" The move from here: {as_text(move)}."
        return cls(
            image,
            setting.camera_at(believed),
            setting.dofs_at(believed),
            DISPLAY_FACTORS * np.asarray(step.estimate.std, dtype=float),
            None if move is None else setting.camera_at(believed @ move),
            None if truth is None else setting.dofs_at(truth),
            words,
        )


class Series(NamedTuple):
    """One dof through a run, each of shape (n_looks,), [mm] or [deg].

    Parameters
    ----------
    number : ndarray
        Of the look, from 1.
    believed : ndarray
        Displacement from the reference.
    low, high : ndarray
        `BAND` standard deviations around it; the same where none is believed.
    truth : ndarray
        NaN where it is not known.
    """

    number: Array
    believed: Array
    low: Array
    high: Array
    truth: Array


@dataclass(eq=False)
class History:
    """The looks of a run so far, the oldest first.

    Parameters
    ----------
    setting : Setting
    looks : list of Look
    end : str
        How the run ended; empty while it has not.
    knows_truth : bool
        Whether every look has its truth.
    way : Way or None
        Of an acquisition, where the robot is to go.
    """

    setting: Setting
    looks: list[Look] = field(default_factory=list)
    end: str = ""
    knows_truth: bool = False
    way: Way | None = None

    @classmethod
    def of_data_set(cls, data: PoseImageSet, estimator: Estimator | None = None) -> History:
        """The images of a data set, where the robot reports to have taken them.

        Parameters
        ----------
        data : PoseImageSet
        estimator : Estimator, optional
            That was trained on it: a keyframe model knows the camera and the relief.

        Raises
        ------
        InvalidInputError
            If the estimator has another reference image.
        """
        setting = Setting(data.reference_image, data.pivot, data.dofs).known_by(estimator)
        displacements = inverse_transform(data.T_world_ref) @ data.T_world_cam
        unknown = np.full(6, np.nan)
        looks = [
            Look(
                image, setting.camera_at(D), setting.dofs_at(D), unknown,
                words=f"{name}: {as_text(D)} from the reference, as the robot reports.",
            )
            for name, image, D in zip(data.names, data.images, displacements, strict=True)
        ]  # fmt: skip
        return cls(setting, looks, f"Data set of {len(looks)} images.")

    def path(self) -> Array:
        """Where the camera is believed to have been, (n_looks, 3), [m]."""
        return np.array([look.camera[:3, 3] for look in self.looks]).reshape(-1, 3)

    def series(self, dof: str) -> Series:
        """One degree of freedom through the run."""
        k = DOFS.index(dof)
        believed = np.array([look.displacement[k] for look in self.looks])
        band = np.nan_to_num([BAND * look.std[k] for look in self.looks])
        truth = [np.nan if look.truth is None else look.truth[k] for look in self.looks]
        number = np.arange(1.0, len(self.looks) + 1)
        return Series(number, believed, believed - band, believed + band, np.array(truth))

    def difference(self, k: int) -> NDArray[np.uint8]:
        """Look `k` less the reference in colours, (height, width, 3).

        White is equal, red brighter, blue darker; full colour is 64 grey levels or more.
        """
        less = self.looks[k].image.astype(float) - self.setting.reference_image
        share = (less / _STRONGEST).clip(-1, 1)
        fade = 255 * (1 - np.abs(share))
        bright, dark = np.where(share > 0, 255, fade), np.where(share < 0, 255, fade)
        return np.rint(np.stack([bright, fade, dark], axis=-1)).astype(np.uint8)


def _size(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
