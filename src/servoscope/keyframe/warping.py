"""Warps of images onto the reference view, with analytic derivatives, compiled.

A pixel of the reference image looks along ``(x, y, 1)`` and sees a point at inverse depth q. In a
camera that ``T = inv(D)`` maps the reference camera's coordinates to, the point lies along
``Q = R (x, y, 1) + q t``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled

MOTION = slice(0, 6)
"""Columns of the derivative by a twist before T, ``T <- exp(twist) T``."""

LIGHT = slice(6, 10)
"""Columns by gain, offset, and slopes of the gain to the right and down."""

CAMERA = slice(10, 15)
"""Columns by ln f, cx, cy, k1, k2."""

RELIEF = slice(15, 18)
"""Columns by a factor, and slopes to the right and down, of all inverse depths."""

N_COLUMNS = 18
N_ALIGNED = 6
"""Columns that the alignment of one image needs: the first ones."""

UNSEEN = np.float32(-1e6)
"""What stands for the grey level and the residual of a point that is not seen."""

NEAREST = 0.05
SATURATED = 250.0


@compiled(fastmath=True, error_model="numpy", inline="always")
def _look(
    image: NDArray[Any],
    T: NDArray[Any],
    camera: NDArray[Any],
    aspect: float,
    x: float,
    y: float,
    q: float,
) -> tuple[Any, ...]:
    """Where Q is seen: whether within the image, grey, its slopes, Q, and what leads there."""
    f, cx, cy, k1, k2 = camera[0], camera[1], camera[2], camera[3], camera[4]
    height, width = image.shape
    X = T[0, 0] * x + T[0, 1] * y + T[0, 2] + q * T[0, 3]
    Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] + q * T[1, 3]
    Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + q * T[2, 3]
    ok = Z > NEAREST
    iz = 1.0 / Z if ok else 1.0
    px, py = X * iz, Y * iz
    r2 = px * px + py * py
    d = 1.0 + r2 * (k1 + k2 * r2)
    u = (f * d * px + cx + 0.5) * width - 0.5
    v = ((f * d * py + cy) / aspect + 0.5) * height - 0.5
    # what distortion folds back into the image is not there
    ok = ok and 1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2) > 0.0
    ok = ok and u >= 0.0 and v >= 0.0 and u < width - 1.0 and v < height - 1.0
    if not ok:
        return False, 0.0, 0.0, 0.0, X, Y, Z, iz, px, py, r2, d, u, v
    column, row = int(u), int(v)
    a, b = u - column, v - row
    i00, i01 = image[row, column], image[row, column + 1]
    i10, i11 = image[row + 1, column], image[row + 1, column + 1]
    top, bottom = i00 + a * (i01 - i00), i10 + a * (i11 - i10)
    gx = ((i01 - i00) * (1.0 - b) + (i11 - i10) * b) * width
    gy = (bottom - top) * height / aspect
    return True, top + b * (bottom - top), gx, gy, X, Y, Z, iz, px, py, r2, d, u, v


@compiled(fastmath=True, error_model="numpy", inline="always")
def _cubic(image: NDArray[Any], u: float, v: float) -> float:
    """Grey level between pixels by the cubic convolution of Keys (a = -1/2)."""
    height, width = image.shape
    column, row = int(u), int(v)
    a, b = u - column, v - row
    a0, a1 = a * (a * (1.0 - 0.5 * a) - 0.5), 1.0 + a * a * (1.5 * a - 2.5)
    a2, a3 = a * (0.5 + a * (2.0 - 1.5 * a)), a * a * (0.5 * a - 0.5)
    b0, b1 = b * (b * (1.0 - 0.5 * b) - 0.5), 1.0 + b * b * (1.5 * b - 2.5)
    b2, b3 = b * (0.5 + b * (2.0 - 1.5 * b)), b * b * (0.5 * b - 0.5)
    before, last = max(column - 1, 0), min(column + 2, width - 1)
    grey = 0.0
    for k in range(4):
        line = image[min(max(row - 1 + k, 0), height - 1)]
        weight = b0 if k == 0 else b1 if k == 1 else b2 if k == 2 else b3
        grey += weight * (
            a0 * line[before] + a1 * line[column] + a2 * line[column + 1] + a3 * line[last]
        )
    return grey


@compiled(fastmath=True, error_model="numpy")
def sample(
    image: NDArray[Any],
    T: NDArray[Any],
    camera: NDArray[Any],
    aspect: float,
    rays: NDArray[Any],
    inverse_depth: NDArray[Any],
    grey: NDArray[Any],
) -> None:
    """Write the grey level that each point of the reference is seen with, or `UNSEEN`."""
    for i in range(rays.shape[0]):
        seen = _look(image, T, camera, aspect, rays[i, 0], rays[i, 1], inverse_depth[i])
        grey[i] = seen[1] if seen[0] else UNSEEN


@compiled(fastmath=True, error_model="numpy", inline="always")
def _carried(
    slope: NDArray[Any],
    T: NDArray[Any],
    by_camera: NDArray[Any],
    f: float,
    d: float,
    bent: float,
    px: float,
    py: float,
    iz: float,
) -> tuple[float, float]:
    """A gradient of the reference image, carried to where it is seen, for a point at rest."""
    x0, y0 = (T[0, 0] - px * T[2, 0]) * iz, (T[1, 0] - py * T[2, 0]) * iz
    x1, y1 = (T[0, 1] - px * T[2, 1]) * iz, (T[1, 1] - py * T[2, 1]) * iz
    r0, r1 = bent * (px * x0 + py * y0), bent * (px * x1 + py * y1)
    u0, v0 = f * (d * x0 + r0 * px), f * (d * y0 + r0 * py)
    u1, v1 = f * (d * x1 + r1 * px), f * (d * y1 + r1 * py)
    # a ray changes with its pixel as it does, but for the sign, with the principal point
    a, b, c, e = -by_camera[0, 1], -by_camera[0, 2], -by_camera[1, 1], -by_camera[1, 2]
    ux, uy = u0 * a + u1 * c, u0 * b + u1 * e
    vx, vy = v0 * a + v1 * c, v0 * b + v1 * e
    determinant = ux * vy - uy * vx
    return (
        (vy * slope[0] - vx * slope[1]) / determinant,
        (ux * slope[1] - uy * slope[0]) / determinant,
    )


@compiled(fastmath=True, error_model="numpy")
def linearise(
    image: NDArray[Any],
    T: NDArray[Any],
    camera: NDArray[Any],
    aspect: float,
    points: NDArray[Any],
    rays: NDArray[Any],
    by_camera: NDArray[Any],
    inverse_depth: NDArray[Any],
    reference: NDArray[Any],
    gain: NDArray[Any],
    offset: NDArray[Any],
    slopes: NDArray[Any],
    carries: bool,
    jacobian: NDArray[Any],
    by_depth: NDArray[Any],
    residuals: NDArray[Any],
) -> int:
    """Residuals of one image at the points of the reference, and their derivatives.

    The residual is ``I(u) - gain I_ref - offset``. As many columns are written as `jacobian` has;
    rows of points that are not seen, or saturated and expected to be, are zero.

    Parameters
    ----------
    image : array of shape (height, width), float32
    T : array of shape (4, 4)
        Reference camera to this camera.
    camera : array of shape (5,)
        f, cx, cy, k1, k2.
    aspect : float
        Height over width of the full image.
    points, rays : arrays of shape (n, 2), float32
        Where the points are in the reference image, and their rays.
    by_camera : array of shape (n, 2, 5), float32
    inverse_depth, reference : arrays of shape (n,), float32
    gain, offset : arrays of shape (n,), float32
        Of the light at the points.
    slopes : array of shape (n, 2), float32
        Gradient of the reference image at the points, [grey / image width]; used if `carries`.
    carries : bool
        Take derivatives of the reference image, carried to where its points are seen, instead of
        the image, whose noise would otherwise be in both derivatives and residuals; and grey
        levels between pixels by cubic convolution.
    jacobian : array of shape (n, columns), float32
        Written: derivatives by `MOTION`, and, if it is that wide, `LIGHT`, `CAMERA` and `RELIEF`.
    by_depth, residuals : arrays of shape (n,), float32
        Written: the derivative by the inverse depth, and the residual.

    Returns
    -------
    n_seen : int
    """
    f, k1, k2 = camera[0], camera[3], camera[4]
    n_columns = jacobian.shape[1]
    n_seen = 0
    for i in range(rays.shape[0]):
        x, y, q = rays[i, 0], rays[i, 1], inverse_depth[i]
        ok, grey, gx, gy, X, Y, Z, iz, px, py, r2, d, u, v = _look(
            image, T, camera, aspect, x, y, q
        )
        if not ok:
            jacobian[i] = 0.0
            by_depth[i] = 0.0
            residuals[i] = UNSEEN
            continue
        n_seen += 1
        if carries:
            grey = _cubic(image, u, v)
        residuals[i] = grey - gain[i] * reference[i] - offset[i]
        if grey > SATURATED and residuals[i] < 0.0:
            jacobian[i] = 0.0
            by_depth[i] = residuals[i] = 0.0
            continue
        bent = 2.0 * (k1 + 2.0 * k2 * r2)
        if carries:
            gx, gy = _carried(slopes[i], T, by_camera[i], f, d, bent, px, py, iz)
            gx, gy = gain[i] * gx, gain[i] * gy
        along = gx * px + gy * py
        hx = f * (d * gx + bent * along * px) * iz
        hy = f * (d * gy + bent * along * py) * iz
        hz = -(hx * px + hy * py)
        jacobian[i, 0], jacobian[i, 1], jacobian[i, 2] = q * hx, q * hy, q * hz
        jacobian[i, 3] = Y * hz - Z * hy
        jacobian[i, 4] = Z * hx - X * hz
        jacobian[i, 5] = X * hy - Y * hx
        depth_slope = hx * T[0, 3] + hy * T[1, 3] + hz * T[2, 3]
        by_depth[i] = depth_slope
        if n_columns > N_ALIGNED:
            expected, xi, yi = reference[i], points[i, 0], points[i, 1]
            jacobian[i, 6], jacobian[i, 7] = -expected, -1.0
            jacobian[i, 8], jacobian[i, 9] = -expected * xi, -expected * yi
            ax = T[0, 0] * hx + T[1, 0] * hy + T[2, 0] * hz
            ay = T[0, 1] * hx + T[1, 1] * hy + T[2, 1] * hz
            for j in range(5):
                jacobian[i, 10 + j] = ax * by_camera[i, 0, j] + ay * by_camera[i, 1, j]
            jacobian[i, 10] += f * d * along
            jacobian[i, 11] += gx
            jacobian[i, 12] += gy
            jacobian[i, 13] += f * r2 * along
            jacobian[i, 14] += f * r2 * r2 * along
            jacobian[i, 15] = depth_slope * q
            jacobian[i, 16], jacobian[i, 17] = depth_slope * xi, depth_slope * yi
    return n_seen
