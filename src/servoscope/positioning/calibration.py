"""What is known beforehand of the camera and of the poses that a keyframe is fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from servoscope.errors import InvalidInputError
from servoscope.keyframe import CameraModel

TRACKER = 2e-3, 3e-3
"""Deviations of the poses of a sequence, [m] and [rad], unless others are given."""

_SQUARE = 0.02
_STRONGEST = 2.0
_CHECKED = 33
_MISSES = 1e-3
"""Rays miss their points by at most this, [image widths]."""


@dataclass(frozen=True)
class Calibration:
    """What need not be found from images.

    Parameters
    ----------
    camera : CameraModel, optional
        Its lens, which is then held.
    pose_noise : tuple of 2 floats, optional
        Standard deviations of the reported poses, [m] and [rad]; by default those of a robot, or,
        where the images are a sequence, of a tracker.
    distance : float, optional
        Of the part from the camera, within a factor of two or so, [m].
    """

    camera: CameraModel | None = None
    pose_noise: tuple[float, float] | None = None
    distance: float | None = None

    def options(self, *, is_sequence: bool) -> dict[str, Any]:
        """Options of `Keyframe.fit`."""
        given: dict[str, Any] = {name: x for name, x in vars(self).items() if x is not None}
        return ({"pose_noise": TRACKER} if is_sequence else {}) | given


def parse_intrinsics(text: str, image_shape: tuple[int, int]) -> CameraModel:
    """The camera of ``FX,FY,CX,CY[,K1,K2]``, in pixels of images of a height and width.

    Raises
    ------
    InvalidInputError
        If these are not four to six numbers, or not those of a camera with square pixels whose
        axis meets the image and whose distortion does not fold it.

    Examples
    --------
    >>> parse_intrinsics("512,512,319.5,239.5", (480, 640))
    CameraModel(f=0.8, cx=0.0, cy=0.0, k1=0.0, k2=0.0)
    """
    height, width = image_shape
    fx, fy, cx, cy, *distortion = _numbers("intrinsics", text, (4, 5, 6), "FX,FY,CX,CY[,K1,K2]")
    if not (0.1 * width <= fx <= 100 * width and abs(fx - fy) <= _SQUARE * fx):
        raise InvalidInputError(
            f"intrinsics must have focal lengths FX and FY of 0.1 to 100 image widths, alike to "
            f"{_SQUARE:.0%}, in pixels of the data set's images, which are {width} wide; got "
            f"{fx:g} and {fy:g}."
        )
    if not (0 <= cx <= width and 0 <= cy <= height):
        raise InvalidInputError(
            f"intrinsics must have a principal point CX,CY within the images of {width} x {height} "
            f"pixels, got {cx:g},{cy:g}; scale them to the size of the data set's images."
        )
    if any(abs(k) > _STRONGEST for k in distortion):
        raise InvalidInputError(
            f"intrinsics must have distortions K1 and K2 within {_STRONGEST:g}, got "
            f"{','.join(f'{k:g}' for k in distortion)}; give those of OpenCV's model."
        )
    k1, k2 = [*distortion, 0.0, 0.0][:2]
    f = float(np.sqrt(fx * fy))
    camera = CameraModel.from_pixels(f, (cx, cy), width=width, height=height, distortion=(k1, k2))
    if _folds(camera, height / width):
        raise InvalidInputError(
            f"intrinsics must have distortions K1 and K2 that do not fold the image back onto "
            f"itself, got {k1:g},{k2:g}; give those of OpenCV's radial model."
        )
    return camera


def _folds(camera: CameraModel, aspect: float) -> bool:
    """Whether rays of some points of the image are not seen where these are."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, _CHECKED), np.linspace(-0.5, 0.5, _CHECKED) * aspect)
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    rays, _ = camera.rays(points)
    r2 = (rays**2).sum(axis=1, keepdims=True)
    seen = camera.f * (1 + camera.k1 * r2 + camera.k2 * r2**2) * rays + [camera.cx, camera.cy]
    turns = 1 + 3 * camera.k1 * r2 + 5 * camera.k2 * r2**2 <= 0
    return bool((np.abs(seen - points).max() > _MISSES) or turns.any())


def parse_pose_noise(text: str) -> tuple[float, float]:
    """Deviations of ``MM,DEG`` in metres and radians.

    Raises
    ------
    InvalidInputError
        If these are not two positive numbers of at most 100 mm and 20 degrees.

    Examples
    --------
    >>> parse_pose_noise("0.5,0.1")
    (0.0005, 0.0017453292519943296)
    """
    mm, deg = _numbers("pose-noise", text, (2,), "MM,DEG")
    if not (0 < mm <= 100 and 0 < deg <= 20):
        raise InvalidInputError(
            f"pose-noise must be positive, at most 100 mm and 20 deg, got {mm:g},{deg:g}."
        )
    return mm / 1e3, float(np.radians(deg))


def _numbers(name: str, text: str, counts: tuple[int, ...], wanted: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not np.isfinite(numbers).all():
        raise InvalidInputError(f"{name} must be {wanted}, finite numbers, got {text!r}.")
    return numbers
