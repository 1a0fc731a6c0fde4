"""Photometric visual servoing: the grey levels themselves are the features."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from servoscope.compiled import compiled
from servoscope.errors import InvalidInputError
from servoscope.positioning.interfaces import Array, Estimate, Image

Floats = NDArray[np.float32]

MARGIN = 3
"""Pixels along each side of an image whose slopes are not to be relied on."""

_DERIVATIVE = np.array([-112, -913, -2047, 0, 2047, 913, 112]) / 8418
"""Weights of seven pixels in a row whose sum is the slope in the middle."""

SMOOTHING_PX = 0.99
"""Slopes of `luminance_interaction` are of an image smoothed by a Gaussian of this deviation."""

_UNKNOWN = np.full(6, np.nan)


@dataclass(frozen=True)
class PhotometricLaw:
    """The numbers of the Levenberg-Marquardt control law.

    Parameters
    ----------
    gain : float
        Share of the damped step that a move makes: lambda times the period of control. Above 1
        makes up for the damping.
    damping : float
        mu, relative to the diagonal of the Hessian.
    late_damping : float
        mu once more than `late_after` moves were made.
    late_after : int
    border : int
        Pixels along each side of the image that are left out, at least 3.
    converged_below : float
        Mean squared difference to the reference image under which it is content, [grey^2].

    Raises
    ------
    InvalidInputError
        If a number is out of its range or not finite.
    """

    gain: float = 1.2
    damping: float = 0.01
    late_damping: float = 0.0001
    late_after: int = 90
    border: int = 10
    converged_below: float = 0.15

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = MARGIN if name == "border" else 0
            if not least <= value < np.inf:
                raise InvalidInputError(f"{name} must be finite and at least {least}, got {value}.")


@dataclass(frozen=True, eq=False, kw_only=True)
class PhotometricEstimate(Estimate):
    """What photometric servoing makes of an image.

    Parameters
    ----------
    step : ndarray of shape (4, 4)
        What the law takes back of the displacement now, [m]: its move, ``inv(step)``, is the
        velocity of control kept up over one period.
    moves : int
        How many images came before this one.
    squared_difference : float
        Mean squared difference to the reference image, [grey^2].
    converged : bool
        Whether that is so little that the law stops.
    """

    step: Array
    moves: int
    squared_difference: float
    converged: bool


class PhotometricServoing:
    """Moves a camera by all differences between its image and the reference image.

    The baseline of the scoreboard. It needs what a learned positioner does not: the camera's
    calibration and the depth of what it sees.

    Parameters
    ----------
    reference_image : array of shape (height, width), uint8
    focal_px : float
        Focal length, [px].
    principal_px : tuple of 2 floats
        Column and row of the principal point, [px]; pixel centres at whole numbers.
    depth : float or array of shape (height, width)
        Along the camera's z at the reference, [m]; infinite where there is nothing.
    reach : array of shape (6,)
        Largest displacements about the pivot that it is used for, [m] and [rad].
    pivot : float
        [m].
    distortion : tuple of 2 floats
        k1 and k2 of the lens, as in OpenCV.
    law : PhotometricLaw, optional

    Attributes
    ----------
    interaction_ : ndarray of shape (6, height - 2 border, width - 2 border), float32
        `luminance_interaction` of the reference image without its border.
    hessian_ : ndarray of shape (6, 6)

    Raises
    ------
    InvalidInputError
        If the image, the calibration or the depth is not usable.

    Notes
    -----
    A pixel whose surroundings keep their light follows ``dI/dt = L_I v`` with
    ``L_I = -(grad I)^T L_x`` and L_x the interaction matrix of a point. With L_I taken once, at
    the reference, and ``H = L_I^T L_I``, the law is
    ``v = -lambda (H + mu diag(H))^-1 L_I^T (I - I*)``. [1]_

    `Estimate.displacement` is the Gauss-Newton step of the same matrices, in full and undamped:
    what the law's own model believes of where the camera is. `PhotometricEstimate.step` is a
    damped part of it, much smaller along the valleys of H, and says little about how far there
    is to go. Where an image has detail as fine as its pixels, slopes come out too small and
    what is believed too large, by a quarter or so.

    References
    ----------
    .. [1] C. Collewet and E. Marchand, "Photometric Visual Servoing", IEEE Transactions on
       Robotics 27(4), 2011.

    Examples
    --------
    >>> reference = np.random.default_rng(0).integers(0, 255, (64, 64), dtype=np.uint8)
    >>> servoing = PhotometricServoing(reference, 100.0, (31.5, 31.5), 0.55, np.ones(6), 0.55)
    >>> estimate = servoing.estimate(reference, None)
    >>> estimate.converged, estimate.moves, np.allclose(estimate.step, np.eye(4))
    (True, 0, True)
    """

    def __init__(
        self,
        reference_image: ArrayLike,
        focal_px: float,
        principal_px: tuple[float, float],
        depth: ArrayLike,
        reach: ArrayLike,
        pivot: float,
        *,
        distortion: tuple[float, float] = (0.0, 0.0),
        law: PhotometricLaw | None = None,
    ) -> None:
        self.law = PhotometricLaw() if law is None else law
        self.reference_image = _checked_image(reference_image, self.law.border)
        self.image_shape = (len(self.reference_image), len(self.reference_image[0]))
        self.reach, self.pivot = _checked_range(reach, pivot)
        depth = _checked_depth(depth, self.image_shape)
        _check_calibration(focal_px, principal_px, distortion)
        b, (height, width) = self.law.border, self.image_shape
        L = luminance_interaction(self.reference_image, depth, focal_px, principal_px, distortion)[
            :, b : height - b, b : width - b
        ]
        self.hessian_ = np.tensordot(L, L, ((1, 2), (1, 2)))
        if np.linalg.matrix_rank(self.hessian_) < 6:
            raise InvalidInputError(
                "The reference image does not inform all six dofs; use one with more texture, "
                "and see that depth is finite where the part is."
            )
        self.interaction_ = np.ascontiguousarray(L, dtype=np.float32)

    def estimate(self, image: Image, previous: Estimate | None) -> PhotometricEstimate:
        """Where an image was taken, and the move that the law makes.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        previous : Estimate or None
            Of the image before it: moves are counted from there.
        """
        moves = previous.moves + 1 if isinstance(previous, PhotometricEstimate) else 0
        slope, squared = _compare(image, self.reference_image, self.interaction_, self.law.border)
        squared /= self.interaction_[0].size
        mu = self.law.late_damping if moves > self.law.late_after else self.law.damping
        damped = self.hessian_ + mu * np.diag(np.diag(self.hessian_))
        return PhotometricEstimate(
            displacement=motion(np.linalg.solve(self.hessian_, slope)),
            std=_UNKNOWN,
            novelty=np.nan,
            stage="photometric",
            step=motion(self.law.gain * np.linalg.solve(damped, slope)),
            moves=moves,
            squared_difference=squared,
            converged=squared <= self.law.converged_below,
        )


def luminance_interaction(
    image: ArrayLike,
    depth: ArrayLike,
    focal_px: float,
    principal_px: tuple[float, float],
    distortion: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Change of each grey level with the velocity of the camera.

    Parameters
    ----------
    image : array of shape (height, width)
    depth : float or array of shape (height, width)
        Along the camera's z, [m].
    focal_px : float
        [px].
    principal_px : tuple of 2 floats
        Column and row, [px]; pixel centres at whole numbers.
    distortion : tuple of 2 floats
        k1 and k2, as in OpenCV.

    Returns
    -------
    ndarray of shape (6, height, width)
        [grey/m] for tx, ty, tz and [grey/rad] for rx, ry, rz.

    Notes
    -----
    ``L_I = -(grad I)^T L_x`` with L_x the interaction matrix of a point; Collewet and Marchand,
    "Photometric Visual Servoing", 2011, for surfaces that keep their light.

    Examples
    --------
    >>> ramp = np.tile(np.arange(9.0), (9, 1))  # a grey level each pixel to the right
    >>> luminance_interaction(ramp, 0.5, 100.0, (4.0, 4.0))[:, 4, 4].round(6) + 0.0
    array([200.,   0.,   0.,   0., 100.,   0.])
    """
    image = np.asarray(image, dtype=float)
    x, y = _unit_depth(image.shape, focal_px, principal_px, distortion)
    along_x, along_y = _slopes(image, x, y, focal_px, distortion)
    outward = x * along_x + y * along_y
    nearness = 1 / np.asarray(depth, dtype=float)
    return np.stack(
        [
            along_x * nearness,
            along_y * nearness,
            -outward * nearness,
            -along_y - y * outward,
            along_x + x * outward,
            x * along_y - y * along_x,
        ]
    )


def motion(screw: ArrayLike) -> Array:
    """The displacement that a constant velocity brings about in unit time, (4, 4).

    Parameters
    ----------
    screw : array of shape (6,)
        Linear and angular velocity in the moving frame, [m] and [rad].

    Examples
    --------
    >>> motion([0.1, 0, 0, 0, 0, np.pi / 2]).round(4)[:2, 3]
    array([0.0637, 0.0637])
    """
    v, (x, y, z) = np.reshape(screw, (2, 3))
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    twist[:3, 3] = v
    return np.asarray(expm(twist))


@compiled(fastmath={"reassoc", "contract"})
def _compare(
    image: Image, reference: Image, interaction: Floats, border: int
) -> tuple[Array, float]:
    """The sums over all pixels of interaction times difference, (6,), and of its square."""
    _, height, width = interaction.shape
    slope, squared = np.zeros(6), 0.0
    difference = np.empty(width, np.float32)
    for row in range(height):
        for column in range(width):
            now = np.float32(image[border + row, border + column])
            difference[column] = now - np.float32(reference[border + row, border + column])
        for k in range(6):
            slope[k] += _dot(interaction[k, row], difference)
        squared += _dot(difference, difference)
    return slope, squared


@njit(inline="always", fastmath={"reassoc", "contract"})
def _dot(a, b):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(a.size):
        total += a[i] * b[i]
    return total


def _checked_image(image: ArrayLike, border: int) -> Image:
    image = np.array(image)
    least = 2 * border + 1
    if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape) < least:
        raise InvalidInputError(
            f"reference_image must be uint8, (height, width), at least {least} pixels each way "
            f"with a border of {border}, got {image.dtype} of shape {image.shape}."
        )
    return image


def _checked_depth(depth: ArrayLike, image_shape: tuple[int, int]) -> Array:
    depth = np.asarray(depth, dtype=float)
    if depth.shape not in ((), image_shape):
        raise InvalidInputError(
            f"depth must be a number or of the image's shape {image_shape}, got {depth.shape}."
        )
    if not (depth > 0).all():
        raise InvalidInputError("depth must be positive everywhere, [m].")
    return np.broadcast_to(depth, image_shape)


def _checked_range(reach: ArrayLike, pivot: float) -> tuple[Array, float]:
    reach = np.array(reach, dtype=float)
    if reach.shape != (6,) or not np.isfinite(reach).all():
        raise InvalidInputError(f"reach must be 6 finite numbers, got {reach.tolist()}.")
    if not np.isfinite(pivot):
        raise InvalidInputError(f"pivot must be finite, got {pivot}.")
    return reach, float(pivot)


def _check_calibration(
    focal_px: float, principal_px: tuple[float, float], distortion: tuple[float, float]
) -> None:
    if not 0 < focal_px < np.inf:
        raise InvalidInputError(f"focal_px must be positive and finite, got {focal_px}.")
    for name, pair in (("principal_px", principal_px), ("distortion", distortion)):
        if np.shape(pair) != (2,) or not np.isfinite(pair).all():
            raise InvalidInputError(f"{name} must be 2 finite numbers, got {pair}.")


def _unit_depth(
    image_shape: tuple[int, ...],
    focal_px: float,
    principal_px: tuple[float, float],
    distortion: tuple[float, float],
) -> Array:
    """Where what each pixel sees lies at unit depth: x and y, shape (2, height, width)."""
    rows, columns = np.indices(image_shape, dtype=float)
    seen = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    K = np.array([[focal_px, 0, principal_px[0]], [0, focal_px, principal_px[1]], [0, 0, 1.0]])
    ideal = cv2.undistortPoints(seen, K, np.array([*distortion, 0.0, 0.0]))
    return np.asarray(ideal.reshape(*image_shape, 2).transpose(2, 0, 1))


def _slopes(
    image: Array, x: Array, y: Array, focal_px: float, distortion: tuple[float, float]
) -> tuple[Array, Array]:
    """Slope of the image along x and y, at unit depth, [grey]."""
    k1, k2 = distortion
    along_u = cv2.filter2D(image, -1, _DERIVATIVE[None, :])
    along_v = cv2.filter2D(image, -1, _DERIVATIVE[:, None])
    r2 = x**2 + y**2
    stretch = focal_px * (1 + k1 * r2 + k2 * r2**2)
    outward = focal_px * (2 * k1 + 4 * k2 * r2) * (x * along_u + y * along_v)
    return stretch * along_u + x * outward, stretch * along_v + y * outward
