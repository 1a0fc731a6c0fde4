"""Which images to take next: those that make what is read most accurate."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.arrays import as_numbers
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.keyframe.adjustment import MOUNT, REFERENCE, Priors
from servoscope.keyframe.checks import rigid
from servoscope.keyframe.keyframe import Keyframe
from servoscope.keyframe.levels import PRIOR, View
from servoscope.keyframe.motion import adjoint, conjugate
from servoscope.keyframe.warping import CAMERA, MOTION, N_COLUMNS, UNSEEN, linearise
from servoscope.poses import displacements_from_poses, inverse_transform, poses_from_displacements
from servoscope.processes import one_blas_thread

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
        by_twist = keyframe.aligner.by_twist(D)
        known = seen.copy()
        known[MOTION, MOTION] += np.linalg.inv(np.diag(1 / self._pose) + self._misfit(T, by_twist))
        information = G.T @ HG - HG[own].T @ np.linalg.solve(known, HG[own])
        return ImageInformation(information, by_twist @ response)

    def _misfit(self, T: Array, by_twist: Array) -> Array:
        """What no keyframe explains of a view: it shifts what is read, the more the farther."""
        inverse = np.linalg.inv(by_twist)
        std = self.keyframe.model_error * self.keyframe.aligner.view_shift(T)
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


N_CANDIDATES = 200
"""Displacements that are drawn to be chosen from."""

N_APART = 10
"""Of these, as many as lie farthest from the images there are compete."""

N_READ = 40
"""Displacements at which the accuracy of a look is predicted."""


def next_displacements(
    keyframe: Keyframe,
    n: int,
    ranges: ArrayLike,
    *,
    pose_noise: tuple[float, float] = (3e-4, 5e-4),
    scale: ArrayLike | None = None,
    random_state: int | np.random.Generator = 0,
) -> Array:
    """Displacements at which the next images should be taken.

    Of `N_CANDIDATES` that are drawn evenly from the range, those are chosen, one after the other,
    that most reduce the expected square of what is read wrongly over the range (A-optimal,
    greedy): ``argmin_c mean_d tr(S^-1 A_d (P + I_c)^-1 A_d^T S^-1)``, where P is the Fisher
    information of the images that were fitted and of those chosen before, I_c that of candidate
    c, A_d how errors of the keyframe show in what is read at d, and S the scale. Information about
    lens, mount and depth counts by what it is worth for the displacements that are to be read.

    Parameters
    ----------
    keyframe : Keyframe
    n : int
    ranges : array of shape (6,)
        Displacements are at most these about the pivot, [m] and [rad], in `DOFS` order; 0 in dofs
        that the keyframe does not read.
    pose_noise : tuple of 2 floats
        Standard deviations of the reported poses, [m] and [rad].
    scale : array of shape (6,), optional
        Errors count in these units; by default in shares of the ranges.
    random_state : int or Generator
        Draws the candidates.

    Returns
    -------
    ndarray of shape (n, 6)
        About the pivot, [m] and [rad], best first, all different.

    Raises
    ------
    InvalidInputError
        If n is not from 1 to `N_CANDIDATES`, or ranges or scale are not positive numbers of each
        dof that the keyframe reads.

    References
    ----------
    .. [1] F. Pukelsheim, "Optimal design of experiments", SIAM, 2006.
    """
    if not isinstance(n, int) or not 1 <= n <= N_CANDIDATES:
        raise InvalidInputError(f"n must be a whole number from 1 to {N_CANDIDATES}, got {n!r}.")
    is_read = mask_of(keyframe.dofs)
    ranges = positive_where("ranges", ranges, is_read)
    scale = ranges if scale is None else positive_where("scale", scale, is_read)
    unit, scale = (np.where(is_read, x, np.inf) for x in (ranges, scale))
    rng = np.random.default_rng(random_state)
    candidates = rng.uniform(-1, 1, (N_CANDIDATES, 6)) * ranges
    with one_blas_thread():
        taken = displacements_from_poses(np.eye(4), keyframe.displacements, keyframe.pivot) / unit
        says = KeyframeInformation(keyframe, pose_noise)
        known = says.fitted()
        informations = [says.of(D).information for D in says.displaced(candidates)]
        worth = says.worth(says.displaced(rng.uniform(-1, 1, (N_READ, 6)) * ranges), scale)
        chosen: list[int] = []
        for _ in range(n):
            apart = _distances(candidates / unit, taken)
            apart[chosen] = -1.0  # each is taken once
            left = np.argsort(-apart, kind="stable")[: min(N_APART, N_CANDIDATES - len(chosen))]
            errors = [np.sum(np.linalg.inv(known + informations[k]) * worth) for k in left]
            best = int(left[int(np.argmin(errors))])
            chosen.append(best)
            known = known + informations[best]
            taken = np.vstack([taken, candidates[best] / unit])
    return candidates[chosen]


def _distances(points: Array, others: Array) -> Array:
    """How far each point is from the nearest of the others, (n,)."""
    return np.asarray(np.linalg.norm(points[:, None] - others, axis=2).min(axis=1))


def positive_where(name: str, values: ArrayLike, is_read: NDArray[np.bool_]) -> Array:
    """The values, if they are six finite numbers, positive where `is_read`; 0 elsewhere."""
    array = as_numbers(values, name)
    if array.shape != (6,) or not np.isfinite(array).all() or not (array[is_read] > 0).all():
        raise InvalidInputError(f"{name} must be six positive numbers, got {array.tolist()}.")
    return np.where(is_read, array, 0.0)
