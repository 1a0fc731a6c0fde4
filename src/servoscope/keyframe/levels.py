"""The keyframe at one resolution, and how an image is compared with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.freedom import Freedom
from servoscope.keyframe.lighting import Light, LightGrid
from servoscope.keyframe.motion import exponential
from servoscope.keyframe.starts import correlation
from servoscope.keyframe.views import View
from servoscope.keyframe.warping import MOTION, N_ALIGNED, UNSEEN, linearise, sample

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

BEND = 2.5
"""Residuals of this many standard deviations count a quarter."""

LEAST_SCALE = 0.5
"""Residuals are never taken to spread less than this, [grey]."""

CUT = 3.0
"""Residuals of this many standard deviations say that something else is seen."""

PRIOR = np.array([0.3] * 3 + [1.0] * 3)
"""Standard deviations of a displacement before the image is seen, [m] and [rad]."""

N_BLOCKS = 12
"""Blocks along each side of the view, inside which residuals are taken to be correlated."""

_MOST_PIXELS = 10000
FAR = 0.01
"""Inverse depth of views that inform rotations alone: translations stay what they are, [1 / m]."""

_LEAST_DEVIATION = 1.0
_MOST_RANKED = 4096
_LONGEST_STEP = 0.15


def robust_scale(residuals: Floats) -> float:
    """Standard deviation of most residuals, [grey]; 255 where little is seen."""
    some = residuals[:: max(1, len(residuals) // _MOST_RANKED)]
    seen = some[some > UNSEEN]
    if 4 * len(seen) < len(some):
        return 255.0
    return max(LEAST_SCALE, 1.4826 * float(np.median(np.abs(seen))))


@dataclass(frozen=True, eq=False)
class Guess:
    """Where an image may have been taken, and in what light.

    Parameters
    ----------
    T : ndarray of shape (4, 4)
        Reference camera to the image's camera.
    light : Light
    """

    T: Array
    light: Light


class Level:
    """The keyframe at one resolution.

    Parameters
    ----------
    view : View
    camera : CameraModel
    inverse_depth : ndarray of shape (height, width), float32
    trust : ndarray of shape (height, width), float32
        Weight of each pixel; those of zero are left out.
    n_nodes : int
        Nodes of the light along each side of the view.
    stiffness : float
        By how much light is less uneven than is expected elsewhere: far from the truth, light that
        bends would explain much.
    finest : bool
        Take every other pixel of many, and derivatives of the keyframe instead of the image: they
        are free of the image's noise, but good only near the truth.
    freedom : Freedom, optional
        What the camera can have done; anything by default.
    """

    def __init__(
        self,
        view: View,
        camera: CameraModel,
        inverse_depth: Floats,
        trust: Floats,
        n_nodes: int = 2,
        stiffness: float = 1.0,
        finest: bool = False,
        freedom: Freedom | None = None,
    ) -> None:
        self.view, self.camera, self._finest = view, camera, finest
        self._freedom = None if freedom is None or freedom.is_full else freedom
        rows, columns = np.indices(view.shape)
        taken = trust > 0
        if finest and view.grey.size > _MOST_PIXELS:  # neighbours are alike: half is nearly as good
            taken &= (rows + columns) % 2 == 0
        used = np.flatnonzero(taken)
        self.grid = LightGrid(view.points[used], view.aspect, n_nodes, stiffness)
        self.used = used[self.grid.order]
        rays, by_camera = camera.rays(view.points[self.used])
        self._by_camera = by_camera.astype(np.float32)
        self.slopes, self.laplacian = view.slopes[self.used], view.laplacian[self.used]
        self._xy = view.points[self.used].astype(np.float32)
        self._rays = rays.astype(np.float32)
        self._depth = inverse_depth.ravel()[self.used].astype(np.float32)
        self.grey = view.grey.ravel()[self.used]
        self._trust = trust.ravel()[self.used].astype(np.float32)
        self._values = camera.values
        height, width = view.shape
        blocks = rows * N_BLOCKS // height * N_BLOCKS + columns * N_BLOCKS // width
        self.blocks = blocks.ravel()[self.used]

    def start(self, T: Array) -> Guess:
        """A guess in the light of the reference."""
        return Guess(T, Light.even(self.grid.k))

    def correlation(self, image: Floats, T: Array) -> float:
        """Correlation of an image with the keyframe as it would be seen."""
        return correlation(
            image, T, self._values, self.view.aspect, self._rays, self._depth, self.grey
        )

    def linearise(self, image: Floats, guess: Guess) -> tuple[Floats, Floats, Floats, float]:
        """Derivatives by a twist (n, 6), residuals, robust inverse variances, residuals' scale."""
        gain, offset = self.grid.at_points(guess.light)
        offset += np.float32(guess.light.defocus) * self.laplacian
        jacobian = np.empty((len(self.used), N_ALIGNED), np.float32)
        by_depth, residuals = np.empty_like(self.grey), np.empty_like(self.grey)
        linearise(
            image, guess.T, self._values, self.view.aspect, self._xy, self._rays, self._by_camera,
            self._depth, self.grey, gain, offset, self.slopes, self._finest,
            jacobian, by_depth, residuals,
        )  # fmt: skip
        seen = residuals > UNSEEN
        scale = robust_scale(residuals)
        ratio = residuals * np.float32(1 / (BEND * scale))
        ratio *= ratio
        ratio += 1
        ratio *= ratio
        ratio *= np.float32(scale**2)
        weights = self._trust / ratio
        weights[~seen] = 0
        return jacobian, residuals, weights, scale

    def descend(self, image: Floats, guess: Guess, n_steps: int, tolerance: float = 0.01) -> Guess:
        """Robust Gauss-Newton from a guess.

        Parameters
        ----------
        image : ndarray of shape (height, width), float32
            Prepared for the level.
        guess : Guess
        n_steps : int
        tolerance : float
            A step that moves what is seen by less is the last, [px].
        """
        width = self.view.width
        reach = width * self.camera.f
        depth = float(np.median(self._depth))
        guess = Guess(guess.T, guess.light.resized(self.grid.k))
        for k in range(n_steps + 1):
            H, g = self.normal_equations(image, guess)
            if k == 0:  # light alone: it may be far from even
                step = np.linalg.solve(H[6:, 6:], g[6:])
                guess = Guess(guess.T, guess.light.moved(step))
                continue
            if depth < FAR:
                H[:3], H[:, :3], g[:3] = np.eye(len(H))[:3], np.eye(len(H))[:, :3], 0.0
            if self._freedom is None:
                step = np.linalg.solve(H, g)
            else:
                B = block_diag(self._freedom.twists(guess.T), np.eye(len(H) - 6))
                step = B @ np.linalg.solve(B.T @ H @ B, B.T @ g)
            flow = reach * max(
                depth * float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:6]))
            )
            step *= min(1.0, _LONGEST_STEP * width / max(flow, 1e-9))
            T = exponential(step[MOTION]) @ guess.T
            T = T if self._freedom is None else self._freedom.nearest(T)
            guess = Guess(T, guess.light.moved(step[6:]))
            if flow < tolerance:
                break
        return guess

    def normal_equations(self, image: Floats, guess: Guess) -> tuple[Array, Array]:
        """Robust normal equations of a twist, defocus and light."""
        J, r, w, _ = self.linearise(image, guess)
        H, g = self.grid.normal_equations(J, r, w, self.laplacian, self.grey, guess.light)
        H[np.diag_indices(6)] += 1 / PRIOR**2
        return H, g

    def compare(self, image: Floats, T: Array) -> tuple[float, float]:
        """Mean correlation of blocks with what is expected there, and the share that is seen.

        Blocks count by the deviation of their grey levels; those that are less than half in view
        do not count.
        """
        grey = np.empty_like(self.grey)
        sample(image, T, self._values, self.view.aspect, self._rays, self._depth, grey)
        seen = grey > UNSEEN
        n = N_BLOCKS**2
        a, b = np.where(seen, grey, 0), np.where(seen, self.grey, 0)
        n_seen = np.bincount(self.blocks, seen, n)
        count = np.maximum(n_seen, 1)
        mean_a, mean_b, aa, bb, ab = (
            np.bincount(self.blocks, x, n) / count for x in (a, b, a * a, b * b, a * b)
        )
        variance_a = np.maximum(aa - mean_a**2, 0) + _LEAST_DEVIATION**2
        variance_b = np.maximum(bb - mean_b**2, 0) + _LEAST_DEVIATION**2
        z = np.maximum(ab - mean_a * mean_b, 0) / np.sqrt(variance_a * variance_b)
        counts = 2 * n_seen > np.bincount(self.blocks, minlength=n)
        weight = np.where(counts, np.sqrt(variance_b), 0)
        return float((z * weight).sum() / max(weight.sum(), 1e-9)), float(seen.mean())
