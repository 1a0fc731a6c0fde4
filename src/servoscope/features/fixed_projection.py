"""Families of features that are the same functions of every set of images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.image_transformer import FixedProjection, ImageShape, check_whole_number
from servoscope.features.normalised_images import brightness_gains, working_dtype
from servoscope.processes import one_blas_thread


class TchebichefMoments(FixedProjection):
    """Tchebichef moments of brightness-normalised images.

    Parameters
    ----------
    order : int
        Highest degree of the polynomials in x and y, both degrees together; there are
        ``(order + 1) (order + 2) / 2`` moments. Images with a side of `order` pixels or less
        have fewer.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Raises
    ------
    InvalidInputError
        If the order is not a whole number from 0.

    Notes
    -----
    ``t_ij = sum t_i(x) t_j(y) f(x, y)`` [1]_, with x the column, y the row and f the grey level
    divided by the Euclidean length of the image. The polynomials are orthonormal on the pixels
    themselves, so, other than geometric moments, these are computed without quadrature, do not
    repeat one another, and have sizes alike whatever the order.

    References
    ----------
    .. [1] R. Mukundan, S. H. Ong and P. A. Lee, "Image analysis by Tchebichef moments", IEEE
       Transactions on Image Processing 10 (2001), 1357-1364.

    Examples
    --------
    >>> images = np.full((1, 6, 8), 7, np.uint8)
    >>> moments = TchebichefMoments(order=2).fit(images)
    >>> moments.get_feature_names_out()
    array(['t_00', 't_10', 't_01', 't_20', 't_11', 't_02'], dtype=object)
    >>> abs(moments.transform(images).round(6))
    array([[1., 0., 0., 0., 0., 0.]])
    """

    def __init__(self, order: int = 7, image_shape: ImageShape | None = None) -> None:
        self.order = order
        self.image_shape = image_shape

    def _check_parameters(self) -> None:
        check_whole_number("order", self.order, 0)

    def _prepare(self) -> None:
        """Nothing is computed beforehand."""

    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        rows, columns = (
            tchebichef_polynomials(min(self.order + 1, n), n) for n in self.image_shape_
        )
        i, j = np.transpose(self._orders())
        return _project_separably(flat, self.image_shape_, rows, columns)[:, j, i]

    def _feature_names(self) -> list[str]:
        digits = len(str(self.order))
        return [f"t_{i:0{digits}d}{j:0{digits}d}" for i, j in self._orders()]

    def _orders(self) -> list[tuple[int, int]]:
        """Orders (i, j) along x and y, the lowest sum first."""
        height, width = self.image_shape_
        sums = range(self.order + 1)
        return [(s - j, j) for s in sums for j in range(s + 1) if s - j < width and j < height]


def tchebichef_polynomials(n_polynomials: int, n_points: int) -> NDArray[np.float64]:
    """Orthonormal discrete Tchebichef polynomials of degree 0, 1, ...

    on 0..n_points - 1, a row each.

    Notes
    -----
    The three-term recurrence of orthonormal polynomials, on points centred on 0:
    ``b_n t_n = x t_{n-1} - b_{n-1} t_{n-2}`` with ``b_n^2 = n^2 (N^2 - n^2) / (4 (4 n^2 - 1))``.
    What rounding leaves of the earlier polynomials, which the recurrence would magnify where the
    degree comes near to the number of points, is taken from each.

    Examples
    --------
    >>> tchebichef_polynomials(2, 3).round(4)
    array([[ 0.5774,  0.5774,  0.5774],
           [-0.7071,  0.    ,  0.7071]])
    """
    x = np.arange(n_points) - (n_points - 1) / 2
    t = np.zeros((n_polynomials, n_points))
    t[0] = 1 / np.sqrt(n_points)
    previous, b = np.zeros(n_points), 0.0
    for n in range(1, n_polynomials):
        t[n] = x * t[n - 1] - b * previous
        t[n] -= t[:n].T @ (t[:n] @ t[n])
        b = n * np.sqrt((n_points**2 - n**2) / (4 * n**2 - 1)) / 2
        t[n] /= b
        previous = t[n - 1]
    return t


def _project_separably(
    flat: NDArray[Any],
    image_shape: ImageShape,
    rows: NDArray[np.float64],
    columns: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Projections of brightness-normalised images, ``rows @ image @ columns.T``."""
    dtype = working_dtype(flat)
    gains = brightness_gains(flat)
    left, right = rows.astype(dtype), columns.T.astype(dtype)
    projections = np.empty((len(flat), len(rows), len(columns)))
    with one_blas_thread():
        for image, gain, projection in zip(flat, gains, projections, strict=True):
            normalised = image.reshape(image_shape).astype(dtype)
            normalised *= gain
            projection[:] = left @ normalised @ right
    return projections


class ImageProjections(FixedProjection):
    """Low cosine coefficients of the profiles of brightness-normalised images.

    Parameters
    ----------
    n_angles : int
        Number of directions; the first is along x, and they divide half a turn evenly. Two are
        the sums over columns and over rows.
    n_coefficients : int
        Number of coefficients of each profile.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    components_ : ndarray of shape (1 + n_angles * n_coefficients, n_pixels)
        What images are projected onto.

    Raises
    ------
    InvalidInputError
        If a number is not a whole one from 1.

    Notes
    -----
    The profile in a direction, ``g(s)``, is the sum of the image over the lines across it, its
    Radon transform [1]_. With s from 0 to 1 where these lines cross the image at all, coefficient
    k is ``sum g(s) cos(k pi s)``, over the root of the number of pixels. The sum of all grey
    levels, ``k = 0``, is the same in all directions and stands once. As cosines of lines are
    functions of the pixels, each coefficient is one product with the image: no profile is ever
    binned, and nothing is interpolated.

    References
    ----------
    .. [1] S. R. Deans, "The Radon Transform and Some of Its Applications", Wiley, 1983.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> projections = ImageProjections(n_angles=2, n_coefficients=2).fit(images)
    >>> projections.get_feature_names_out()
    array(['p_sum', 'p_0_1', 'p_0_2', 'p_90_1', 'p_90_2'], dtype=object)
    """

    def __init__(
        self,
        n_angles: int = 8,
        n_coefficients: int = 7,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.n_angles = n_angles
        self.n_coefficients = n_coefficients
        self.image_shape = image_shape

    def _prepare(self) -> None:
        check_whole_number("n_angles", self.n_angles, 1)
        check_whole_number("n_coefficients", self.n_coefficients, 1)
        height, width = self.image_shape_
        y, x = np.indices((height, width)).reshape(2, -1) + 0.5
        scale = 1 / np.sqrt(height * width)
        orders = range(1, self.n_coefficients + 1)
        self.components_ = np.empty((1 + self.n_angles * self.n_coefficients, height * width))
        self.components_[0] = scale
        for i, angle in enumerate(np.pi * np.arange(self.n_angles) / self.n_angles):
            c, s = np.cos(angle), np.sin(angle)
            extent = abs(c) * width + abs(s) * height
            along = 0.5 + (c * (x - width / 2) + s * (y - height / 2)) / extent
            for k in orders:
                self.components_[i * len(orders) + k] = scale * np.cos(np.pi * k * along)

    def _feature_names(self) -> list[str]:
        degrees = [f"{180 * i / self.n_angles:.4g}" for i in range(self.n_angles)]
        orders = range(1, self.n_coefficients + 1)
        return ["p_sum", *(f"p_{angle}_{k}" for angle in degrees for k in orders)]


class LogPolarFeatures(FixedProjection):
    """Waves of angle and of log radius in brightness-normalised images, about their centre.

    Parameters
    ----------
    max_turns : int
        Highest number of waves around a circle.
    max_scales : int
        Highest number of waves from the inner to the outer radius, either way wound.
    inner_radius : float
        Share of the outer radius, half the shorter side; nothing nearer to the centre counts.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default, too thin for a ring: all features are 0.

    Attributes
    ----------
    components_ : ndarray of shape (n_features, n_pixels)
        What images are projected onto.

    Raises
    ------
    InvalidInputError
        If a parameter is out of range.

    Notes
    -----
    The Fourier-Mellin transform [1]_ ``M(m, k) = sum f(x, y) exp(-i m theta - 2 pi i k rho)``
    over the pixels of the ring, over the root of their number, with f the grey level divided by
    the Euclidean length of the image, theta the angle from x towards y, and rho the log radius, 0
    at the outer radius and -1 at the inner. Features are the real part ``c`` and the imaginary
    part ``s``. Nothing is resampled: as functions of the pixels, the waves are taken where the
    pixels are, and all pixels count the same.

    A picture that turns by ``alpha`` about the centre turns the phase of ``M(m, k)`` by
    ``-m alpha``; one that is enlarged by ``a``, by ``-2 pi k ln(a) / ln(1 / inner_radius)``,
    and has its magnitude times ``a``, as far as it stays within the ring.

    References
    ----------
    .. [1] F. Ghorbel, "A complete invariant description for gray-level images by the harmonic
       analysis approach", Pattern Recognition Letters 15 (1994), 1043-1051.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> log_polar = LogPolarFeatures(max_turns=1, max_scales=1).fit(images)
    >>> log_polar.get_feature_names_out()[:6]
    array(['l_c_0_0', 'l_c_0_1', 'l_s_0_1', 'l_c_1_-1', 'l_s_1_-1', 'l_c_1_0'],
          dtype=object)
    """

    def __init__(
        self,
        max_turns: int = 4,
        max_scales: int = 2,
        inner_radius: float = 1 / 16,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.max_turns = max_turns
        self.max_scales = max_scales
        self.inner_radius = inner_radius
        self.image_shape = image_shape

    def _prepare(self) -> None:
        check_whole_number("max_turns", self.max_turns, 0)
        check_whole_number("max_scales", self.max_scales, 0)
        if not 0 < self.inner_radius < 1:
            raise InvalidInputError(
                f"inner_radius must be between 0 and 1, got {self.inner_radius!r}."
            )
        theta, rho = _log_polar(self.image_shape_, self.inner_radius)
        ring = (rho >= -1) & (rho < 0)
        weight = 1 / np.sqrt(max(int(ring.sum()), 1))
        self.components_ = np.zeros((len(self._waves()), ring.size))
        for component, (part, m, k) in zip(self.components_, self._waves(), strict=True):
            phase = -m * theta[ring] - 2 * np.pi * k * rho[ring]
            component[ring] = weight * (np.cos(phase) if part == "c" else np.sin(phase))

    def _feature_names(self) -> list[str]:
        return [f"l_{part}_{m}_{k}" for part, m, k in self._waves()]

    def _waves(self) -> list[tuple[str, int, int]]:
        """Part and numbers of waves of each feature; opposite waves are the same two."""
        turns, scales = range(self.max_turns + 1), range(-self.max_scales, self.max_scales + 1)
        pairs = [(m, k) for m in turns for k in scales if m > 0 or k > 0]
        return [("c", 0, 0), *((part, m, k) for m, k in pairs for part in "cs")]


def _log_polar(
    image_shape: ImageShape, inner_radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angle, and log radius from -1 (inner) to 0 (half the shorter side), of every pixel."""
    height, width = image_shape
    rows, columns = np.indices(image_shape).reshape(2, -1)
    x, y = columns - (width - 1) / 2, rows - (height - 1) / 2
    radius = np.hypot(x, y) / (min(height, width) / 2)
    # The pixel at the very centre, if there is one, is left out by any inner radius.
    log_radius = np.log(np.where(radius > 0, radius, inner_radius / 2))
    return np.arctan2(y, x), log_radius / np.log(1 / inner_radius)
