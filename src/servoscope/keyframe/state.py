"""What is adjusted, and what is known of it before any image is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.motion import conjugate
from servoscope.poses import inverse_transform

Array = NDArray[np.float64]

MOUNT, REFERENCE, OPTICS, PLANE = slice(0, 6), slice(6, 12), slice(12, 17), slice(17, 20)
"""Unknowns that all images share: twists of the mount and of the reference's pose, the camera, and
factor and slopes of the relief."""

N_GLOBAL = 20

N_LOCAL = 10
"""Unknowns of each image: a twist of its pose, and its light."""

_SURE = 0.3


@dataclass(frozen=True)
class Priors:
    """Standard deviations of what is known before any image is seen.

    Parameters
    ----------
    camera : tuple of 5 floats
        Of ln f, cx, cy, k1 and k2; zero holds a parameter.
    principal_and_distortion : tuple of 4 floats
        What is expected of cx, cy, k1 and k2.
    mount : tuple of 2 floats
        Of the mount's translation [m] and rotation [rad], about where it started.
    pose : tuple of 2 floats
        Of the reported poses, [m] and [rad].
    depth : float
        Of a pixel's inverse depth about the smooth relief, relative.
    redundancy : float
        How many pixels count as one: residuals of neighbours are alike.
    """

    camera: tuple[float, float, float, float, float] = (0.7, 0.03, 0.03, 0.15, 0.1)
    principal_and_distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    mount: tuple[float, float] = (0.3, 3.0)
    pose: tuple[float, float] = (3e-4, 5e-4)
    depth: float = 0.05
    redundancy: float = 16.0


@dataclass(frozen=True, eq=False)
class State:
    """All that is adjusted.

    Parameters
    ----------
    camera : CameraModel
    mount : ndarray of shape (4, 4)
        Camera coordinates to those of the frame that the robot reports, [m].
    reference : ndarray of shape (4, 4)
        Correction of the reference's pose, in its camera.
    corrections : ndarray of shape (n, 4, 4)
        Of the images' poses, each in its camera.
    light : ndarray of shape (n, 4)
        Gain, offset, and slopes of the gain.
    relief : ndarray of shape (height, width)
        Inverse depth of the reference image, [1 / m]; of any resolution.
    """

    camera: CameraModel
    mount: Array
    reference: Array
    corrections: Array
    light: Array
    relief: NDArray[np.floating]

    @classmethod
    def start(cls, camera: CameraModel, mount: Array, n: int, inverse_depth: float) -> State:
        """A plane that stands across the view, poses as they are reported, even light."""
        return cls(
            camera,
            mount,
            np.eye(4),
            np.tile(np.eye(4), (n, 1, 1)),
            np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
            np.full((2, 2), inverse_depth),
        )

    def light_at(
        self, i: int, points: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Gain and offset of image i at points of the reference image, (n,) each."""
        gain, offset, right, down = self.light[i].astype(np.float32)
        gains = gain + right * points[:, 0] + down * points[:, 1]
        return gains, np.full_like(gains, offset)

    def transforms(self, displacements: Array) -> Array:
        """Reference camera to each camera, shape (n, 4, 4)."""
        nominal = inverse_transform(conjugate(self.mount, displacements))
        return self.corrections @ nominal @ self.reference


def sees_translations(covariance: Array) -> bool:
    """Whether the images inform how far a translation moves what is seen: focal length / depth.

    Parameters
    ----------
    covariance : ndarray of shape (20, 20)
        Of the unknowns that all images share.
    """
    both = np.zeros(N_GLOBAL)
    both[[OPTICS.start, PLANE.start]] = 1  # ln f, and the factor of inverse depths
    return bool(np.sqrt(both @ covariance @ both) < _SURE)


def observable(covariance: Array) -> dict[str, bool]:
    """What the images inform: its deviation is below 0.3 of what was assumed before.

    Parameters
    ----------
    covariance : ndarray of shape (20, 20)
        Of the unknowns that all images share.
    """
    std, before = np.sqrt(np.diag(covariance)), Priors()
    shares = {
        "depth": std[PLANE][0],
        "mount_translation": std[MOUNT][:3].max() / before.mount[0],
        "mount_rotation": std[MOUNT][3:].max(),
        "focal_length": std[OPTICS][0] / before.camera[0],
    }
    return {name: bool(share < _SURE) for name, share in shares.items()}
