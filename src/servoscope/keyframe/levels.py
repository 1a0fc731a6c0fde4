"""The keyframe at one resolution, and how an image is compared with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.linalg import block_diag, lapack
from scipy.spatial.transform import Rotation

from servoscope.compiled import compiled
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.lighting import Light, LightGrid
from servoscope.keyframe.motion import Freedom, exponential
from servoscope.keyframe.robust import curvature_ratio, robust_scale, robust_weights
from servoscope.keyframe.warping import MOTION, N_ALIGNED, UNSEEN, _look, linearise, sample

Array = NDArray[np.float64]


def spread_rotations(n: int) -> Array:
    """The 24 turns of a cube and n rotations spread evenly, shape (24 + n, 3, 3).

    The latter are a super-Fibonacci spiral (Alexa, CVPR 2022).
    """
    s = np.arange(n) + 0.5
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    r, R = np.sqrt(s / n), np.sqrt(1 - s / n)
    xyzw = np.stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)], 1)
    cube = Rotation.create_group("O").as_matrix()
    order = np.argsort(Rotation.from_matrix(cube).magnitude(), kind="stable")
    return np.concatenate([cube[order], Rotation.from_quat(xyzw).as_matrix()])


@compiled(fastmath=True, error_model="numpy")
def correlation(
    image: NDArray[Any],
    T: NDArray[Any],
    camera: NDArray[Any],
    aspect: float,
    rays: NDArray[Any],
    inverse_depth: NDArray[Any],
    reference: NDArray[Any],
) -> float:
    """Correlation of an image with the reference, over the points that it sees.

    Zero if it sees less than a quarter of them.

    Parameters
    ----------
    image : array of shape (height, width), float32
    T : array of shape (4, 4)
        Reference camera to this camera.
    camera : array of shape (5,)
    aspect : float
    rays : array of shape (n, 2), float32
    inverse_depth, reference : arrays of shape (n,), float32

    Returns
    -------
    float
    """
    n_points = rays.shape[0]
    n, a, b, aa, bb, ab = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n_points):
        seen = _look(image, T, camera, aspect, rays[i, 0], rays[i, 1], inverse_depth[i])
        if seen[0]:
            grey, expected = seen[1], reference[i]
            n += 1
            a += grey
            b += expected
            aa += grey * grey
            bb += expected * expected
            ab += grey * expected
    if 4 * n < n_points:
        return 0.0
    return (ab - a * b / n) / np.sqrt((aa - a * a / n) * (bb - b * b / n) + 1e-6)


Floats = NDArray[np.float32]

FAINT = 8.0
"""Deviation that is small beside noise and shades, [grey]."""


def prepare(
    image: NDArray[np.generic], width: int, sigma: float, dtype: DTypeLike = np.float32
) -> NDArray[Any]:
    """The image at a width, its height in proportion, blurred by `sigma` of the new pixels."""
    height = level_height(image.shape, width)
    grey: NDArray[Any] = np.asarray(image, dtype=dtype)
    if image.shape[1] != width:
        grey = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    if sigma > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(grey)


EVENED = 0.1
"""What is coarser than this share of the width is taken for light."""


def evened(grey: NDArray[Any]) -> NDArray[Any]:
    """What is finer than a share of the width, in units of its deviation nearby.

    It is free of light that varies slowly, and bounded, so that what covers a part of the view
    changes no more than that part. As large as grey levels: two deviations are 60.
    """
    sigma = EVENED * grey.shape[1]
    fine = grey - cv2.GaussianBlur(grey, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    square = cv2.GaussianBlur(fine * fine, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    ratio: NDArray[Any] = fine / (np.sqrt(square) + FAINT)
    evened: NDArray[Any] = 30 * ratio.clip(-2, 2)
    return evened


def level_height(shape: tuple[int, ...], width: int) -> int:
    """Height of an image of `shape` (height, width) when it is made `width` wide, [px]."""
    return max(2, round(width * shape[0] / shape[1]))


@dataclass(frozen=True, eq=False)
class View:
    """The reference image at one resolution.

    Parameters
    ----------
    grey : ndarray of shape (height, width), float32
    aspect : float
        Height over width of the full image.
    sigma : float
        Blur that other images are to be prepared with, [px].
    """

    grey: Floats
    aspect: float
    sigma: float
    width: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", self.grey.shape[1])

    @classmethod
    def of(cls, image: NDArray[np.generic], width: int, sigma: float) -> View:
        """The view of a full image."""
        return cls(prepare(image, width, sigma), image.shape[0] / image.shape[1], sigma)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, [px]."""
        return self.grey.shape[0], self.grey.shape[1]

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Where the pixels are, [image widths] from the middle, shape (n, 2)."""
        height, width = self.shape
        x = (np.arange(width) + 0.5) / width - 0.5
        y = ((np.arange(height) + 0.5) / height - 0.5) * self.aspect
        return np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2)

    @cached_property
    def slopes(self) -> Floats:
        """To the right and down, [grey / image width], shape (n, 2)."""
        down, right = np.gradient(self.grey)
        height, width = self.shape
        slopes = right * width, down * height / self.aspect
        return np.stack(slopes, axis=-1).reshape(-1, 2).astype(np.float32)

    @cached_property
    def laplacian(self) -> Floats:
        """[grey], shape (n,)."""
        bent = cv2.Laplacian(self.grey, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(bent.ravel(), dtype=np.float32)

    def prepare(self, image: NDArray[np.generic]) -> Floats:
        """Another image at this resolution."""
        return prepare(image, self.width, self.sigma)

    def resize(self, field: NDArray[Any]) -> Floats:
        """A field over the reference image, brought to this resolution, shape (height, width)."""
        field = np.asarray(field, dtype=np.float32)
        if field.shape == self.shape:
            return field
        how = cv2.INTER_AREA if field.shape[1] > self.width else cv2.INTER_LINEAR
        resized = cv2.resize(field, self.shape[::-1], interpolation=how)
        return np.asarray(resized, dtype=np.float32)


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

LEAST_DEVIATION = 1.0
LONGEST_STEP = 0.15

RELAXED, MOST_RELAXED = 1.2, 1.9
"""All steps but the first are lengthened: by so much over the `curvature_ratio`, since weights
follow the residuals, and by so much at most. Below 2 no step raises the cost that the weights are
of."""


@dataclass(frozen=True, eq=False)
class Guess:
    """Where an image may have been taken, and in what light.

    Parameters
    ----------
    T : ndarray of shape (4, 4)
        Reference camera to the image's camera.
    light : Light
    is_settled : bool
        Whether the last step at the resolution where it was made moved nothing that is seen.
    """

    T: Array
    light: Light
    is_settled: bool = False


class Level:
    """The keyframe at one resolution.

    All is computed in double precision: a descent of many steps far from the truth makes the
    rounding of single precision a thousand times larger.

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
        self.view, self.camera, self.finest = view, camera, finest
        self.freedom = None if freedom is None or freedom.is_full else freedom
        rows, columns = np.indices(view.shape)
        taken = trust > 0
        if finest and view.grey.size > _MOST_PIXELS:  # neighbours are alike: half is nearly as good
            taken &= (rows + columns) % 2 == 0
        used = np.flatnonzero(taken)
        self.grid = LightGrid(view.points[used], view.aspect, n_nodes, stiffness)
        self.used = used[self.grid.order]
        rays, by_camera = camera.rays(view.points[self.used])
        self.rays, self.by_camera, self._xy = rays, by_camera, view.points[self.used]
        self.slopes, self.laplacian, self.depth, self.grey, self.trust = (
            field[self.used].astype(float)
            for field in (
                view.slopes,
                view.laplacian,
                inverse_depth.ravel(),
                view.grey.ravel(),
                trust.ravel(),
            )
        )
        self._values = camera.values
        height, width = view.shape
        blocks = rows * N_BLOCKS // height * N_BLOCKS + columns * N_BLOCKS // width
        self.blocks = blocks.ravel()[self.used]

    def start(self, T: Array) -> Guess:
        """A guess in the light of the reference."""
        return Guess(T, Light.even(self.grid.k))

    def prepare(self, image: NDArray[np.generic]) -> Array:
        """Another image at this resolution."""
        return prepare(image, self.view.width, self.view.sigma, float)

    def correlation(self, image: Array, T: Array) -> float:
        """Correlation of an image with the keyframe as it would be seen."""
        return correlation(
            image, T, self._values, self.view.aspect, self.rays, self.depth, self.grey
        )

    def linearise(self, image: Array, guess: Guess) -> tuple[Array, Array, Array, float]:
        """Derivatives by a twist (n, 6), residuals, robust inverse variances, residuals' scale."""
        gain, offset = self.grid.at_points(guess.light)
        offset += guess.light.defocus * self.laplacian
        jacobian = np.empty((len(self.used), N_ALIGNED))
        by_depth, residuals = np.empty_like(self.grey), np.empty_like(self.grey)
        linearise(
            image, guess.T, self._values, self.view.aspect, self._xy, self.rays, self.by_camera,
            self.depth, self.grey, gain, offset, self.slopes, self.finest,
            jacobian, by_depth, residuals,
        )  # fmt: skip
        scale = robust_scale(residuals, LEAST_SCALE)
        weights = np.empty_like(self.grey)
        robust_weights(residuals, scale, weights)
        weights *= self.trust / scale**2
        return jacobian, residuals, weights, scale

    def descend(self, image: Array, guess: Guess, n_steps: int, tolerance: float = 0.01) -> Guess:
        """Robust Gauss-Newton from a guess, over-relaxed: the weights follow the residuals.

        Parameters
        ----------
        image : ndarray of shape (height, width)
            Prepared for the level.
        guess : Guess
            In the light of the reference, or as a coarser resolution found it.
        n_steps : int
        tolerance : float
            A step that moves what is seen by less is the last, [px].
        """
        width = self.view.width
        reach = width * self.camera.f
        depth = float(np.median(self.depth))
        if not guess.is_settled:  # light alone: it may be far from even
            guess = Guess(guess.T, guess.light.resized(self.grid.k))
            H, g, _ = self.normal_equations(image, guess)
            guess = Guess(guess.T, guess.light.moved(_solved(H[6:, 6:], g[6:])))
        guess = Guess(guess.T, guess.light.resized(self.grid.k))
        for k in range(n_steps):
            H, g, curvature = self.normal_equations(image, guess)
            if depth < FAR:
                H[:3], H[:, :3], g[:3] = np.eye(len(H))[:3], np.eye(len(H))[:, :3], 0.0
            if self.freedom is None:
                step = _solved(H, g)
            else:
                B = block_diag(self.freedom.twists(guess.T), np.eye(len(H) - 6))
                step = B @ _solved(B.T @ H @ B, B.T @ g)
            if k:
                step *= min(RELAXED / max(curvature, 1e-9), MOST_RELAXED)
            flow = reach * max(
                depth * float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:6]))
            )
            step *= min(1.0, LONGEST_STEP * width / max(flow, 1e-9))
            T = exponential(step[MOTION]) @ guess.T
            T = T if self.freedom is None else self.freedom.nearest(T)
            guess = Guess(T, guess.light.moved(step[6:]), flow < tolerance)
            if guess.is_settled:
                break
        return guess

    def normal_equations(self, image: Array, guess: Guess) -> tuple[Array, Array, float]:
        """Robust normal equations of a twist, defocus and light, and the `curvature_ratio`."""
        J, r, w, scale = self.linearise(image, guess)
        H, g = self.grid.normal_equations(J, r, w, self.laplacian, self.grey, guess.light)
        H[np.diag_indices(6)] += 1 / PRIOR**2
        return H, g, curvature_ratio(r, w, scale)

    def compare(self, image: Array, T: Array) -> tuple[float, float]:
        """Mean correlation of blocks with what is expected there, and the share that is seen.

        Blocks count by the deviation of their grey levels; those that are less than half in view
        do not count.
        """
        grey = np.empty_like(self.grey)
        sample(image, T, self._values, self.view.aspect, self.rays, self.depth, grey)
        seen = grey > UNSEEN
        n = N_BLOCKS**2
        a, b = np.where(seen, grey, 0), np.where(seen, self.grey, 0)
        n_seen = np.bincount(self.blocks, seen, n)
        count = np.maximum(n_seen, 1)
        mean_a, mean_b, aa, bb, ab = (
            np.bincount(self.blocks, x, n) / count for x in (a, b, a * a, b * b, a * b)
        )
        variance_a = np.maximum(aa - mean_a**2, 0) + LEAST_DEVIATION**2
        variance_b = np.maximum(bb - mean_b**2, 0) + LEAST_DEVIATION**2
        z = np.maximum(ab - mean_a * mean_b, 0) / np.sqrt(variance_a * variance_b)
        counts = 2 * n_seen > np.bincount(self.blocks, minlength=n)
        weight = np.where(counts, np.sqrt(variance_b), 0)
        return float((z * weight).sum() / max(weight.sum(), 1e-9)), float(seen.mean())


def _solved(H: Array, g: Array) -> Array:
    """The solution of equations whose matrix is positive definite, but for rounding."""
    _, solution, failed = lapack.dposv(H, g)
    return np.asarray(np.linalg.solve(H, g) if failed else solution)
