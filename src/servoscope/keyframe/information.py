"""What an image at a displacement would say of a keyframe, before it is taken."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.keyframe.checks import rigid
from servoscope.keyframe.keyframe import Keyframe
from servoscope.keyframe.levels import PRIOR
from servoscope.keyframe.motion import adjoint, conjugate
from servoscope.keyframe.state import MOUNT, REFERENCE, Priors
from servoscope.keyframe.views import View
from servoscope.keyframe.warping import CAMERA, MOTION, N_COLUMNS, UNSEEN, linearise
from servoscope.poses import inverse_transform, poses_from_displacements

Array = NDArray[np.float64]

N_PATCHES = 8
"""Inverse depths are taken to be unknown at this many places along each side of the view."""

_WIDTH, _SIGMA = 64, 1.0
_LIGHT = slice(6, 10)
_OWN_PRIOR = np.concatenate([PRIOR, [3.0, 100.0, 3.0, 3.0]])
"""Deviations of an image's pose, gain, offset [grey] and slopes of the gain before it is seen."""

_N_RIGID = 17
_REDUNDANCY = 4.0
_DEPTH_PRIOR = 0.3


@dataclass(frozen=True, eq=False)
class ImageInformation:
    """What one image says of a keyframe, and how the keyframe's errors show in what is read of it.

    Parameters
    ----------
    information : ndarray of shape (n, n)
        Fisher information about mount and reference pose (twists), camera, and relief, after the
        image's own pose and light, which are unknown too.
    sensitivity : ndarray of shape (6, n)
        Change of the displacement that is read, [m] and [rad], by those unknowns.
    """

    information: Array
    sensitivity: Array


class KeyframeInformation:
    """Fisher information about the unknowns of a keyframe, image by image.

    Parameters
    ----------
    keyframe : Keyframe
    pose_noise : tuple of 2 floats
        Standard deviations of the reported poses, [m] and [rad].
    """

    def __init__(self, keyframe: Keyframe, pose_noise: tuple[float, float]) -> None:
        self.keyframe = keyframe
        width = min(_WIDTH, keyframe.reference_image.shape[1])
        self._view = view = View.of(keyframe.reference_image, width, _SIGMA)
        self._rays, self._by_camera = (
            x.astype(np.float32) for x in keyframe.camera.rays(view.points)
        )
        self._depth = view.resize(keyframe.inverse_depth).ravel()
        self._trust = view.resize(keyframe.trust).ravel()
        size = N_PATCHES**2
        units = np.eye(size, dtype=np.float32).reshape(size, N_PATCHES, N_PATCHES)
        hats = [cv2.resize(u, view.shape[::-1], interpolation=cv2.INTER_LINEAR) for u in units]
        self._patches = np.stack([hat.ravel() for hat in hats], axis=1) * self._depth[:, None]
        priors = Priors(pose=pose_noise)
        far = float(np.hypot(pose_noise[0], pose_noise[1] * np.linalg.norm(keyframe.mount[:3, 3])))
        self._pose = 1 / np.repeat([far, pose_noise[1]], 3) ** 2
        depth = np.full(size, _DEPTH_PRIOR)
        self.prior = np.diag(
            np.concatenate(
                [
                    1 / np.repeat(priors.mount, 3) ** 2,
                    self._pose,
                    1 / np.array(priors.camera) ** 2,
                    1 / depth**2,
                ]
            )
        )

    def of(self, displacement: ArrayLike) -> ImageInformation:
        """What an image at a displacement, (4, 4), would say."""
        keyframe, view = self.keyframe, self._view
        D = rigid("displacement", displacement)
        T = inverse_transform(conjugate(keyframe.mount, D))
        n = len(self._depth)
        J = np.empty((n, N_COLUMNS), np.float32)
        by_depth, residuals = np.empty(n, np.float32), np.empty(n, np.float32)
        blank = np.full(view.shape, 128, np.float32)  # derivatives are those of the reference
        linearise(
            blank, T, keyframe.camera.values, view.aspect, view.points.astype(np.float32),
            self._rays, self._by_camera, self._depth, view.grey.ravel(), np.ones_like(self._depth),
            np.zeros_like(self._depth), view.slopes, True, J, by_depth, residuals,
        )  # fmt: skip
        scale = max(keyframe.residual, keyframe.noise)
        weight = np.where(residuals > UNSEEN, self._trust, 0) / (scale**2 * _REDUNDANCY)
        columns = np.hstack([J[:, :10], J[:, CAMERA], by_depth[:, None] * self._patches])
        H = ((columns * weight[:, None]).T @ columns).astype(float)
        own = slice(0, 10)
        chain = np.zeros((6, 12))
        chain[:, MOUNT] = adjoint(T) - np.eye(6)
        chain[:, REFERENCE] = adjoint(T)
        G = np.zeros((len(H), _N_RIGID + N_PATCHES**2))
        G[MOTION, :12] = chain
        G[10:, 12:] = np.eye(len(H) - 10)
        HG = H @ G
        seen = H[own, own] + np.diag(1 / _OWN_PRIOR**2)  # an image may see nothing
        response = -np.linalg.solve(seen, HG[own])[MOTION]
        response[:, REFERENCE] = 0  # what is read is about the reference view itself
        by_twist = keyframe._aligner.by_twist(D)
        known = seen.copy()
        known[MOTION, MOTION] += np.linalg.inv(np.diag(1 / self._pose) + self._misfit(T, by_twist))
        information = G.T @ HG - HG[own].T @ np.linalg.solve(known, HG[own])
        return ImageInformation(information, by_twist @ response)

    def _misfit(self, T: Array, by_twist: Array) -> Array:
        """What no keyframe explains of a view: it shifts what is read, the more the farther."""
        inverse = np.linalg.inv(by_twist)
        std = self.keyframe.model_error * self.keyframe._aligner.view_shift(T)
        return inverse @ np.diag(std**2) @ inverse.T

    def displaced(self, delta_p: ArrayLike) -> Array:
        """Displacements of shape (n, 4, 4) of their six numbers about the pivot."""
        return poses_from_displacements(np.eye(4), delta_p, self.keyframe.pivot)

    def fitted(self) -> Array:
        """Fisher information of the images that were fitted, with what is assumed before."""
        return self.prior + sum(self.of(D).information for D in self.keyframe.displacements)

    def worth(self, displacements: Array, scale: Array) -> Array:
        """What errors of the unknowns cost, in squares of the scale, at displacements, (n, n)."""
        A = [self.of(D).sensitivity / scale[:, None] for D in displacements]
        return np.mean([a.T @ a for a in A], axis=0)
