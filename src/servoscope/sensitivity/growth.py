"""How the error of one degree of freedom grows with the strength of a disturbance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

DOUBLE = 2.0
"""How many times the clean error is said to be doubled."""

PARTED = 0.2
"""Share of the simulated error that first order is off by where the two are said to part."""


@dataclass(frozen=True)
class ErrorGrowth:
    """Error of one dof at each strength of a disturbance.

    Parameters
    ----------
    strengths : tuple of float
        Without 0.
    unit : str
        Of the strengths.
    simulated_rms, predicted_rms : tuple of float
        RMS errors: in images taken anew, and by the first-order prediction, [error_unit].
    simulated_bias : tuple of float
        Mean errors in the images taken anew, which one image at a known pose would correct,
        [error_unit].
    clean_rms : float
        RMS error undisturbed, [error_unit].
    error_unit : {"mm", "deg"}
    power : {1, 2}
        To first order the error goes with this power of the strength.

    Examples
    --------
    >>> growth = ErrorGrowth((1.0, 3.0), "px", (2.0, 4.0), (2.0, 3.0), (0.0, 0.0), 1.0, "mm")
    >>> growth.doubles_at
    1.0
    >>> round(growth.parts_at, 3)
    2.6
    """

    strengths: tuple[float, ...]
    unit: str
    simulated_rms: tuple[float, ...]
    predicted_rms: tuple[float, ...]
    simulated_bias: tuple[float, ...]
    clean_rms: float
    error_unit: str
    power: int = 1

    @property
    def doubles_at(self) -> float | None:
        """The smallest strength, of either sign, at which the error is twice the clean one.

        Between strengths the mean square error is taken to go with the square of what the error
        goes with to first order. None if it is never reached.
        """
        squares = [rms**2 for rms in self.simulated_rms]
        clean = self.clean_rms**2
        return first_reached(
            self.strengths, squares, start=clean, level=DOUBLE**2 * clean, power=2 * self.power
        )

    @property
    def parts_at(self) -> float | None:
        """The smallest strength at which first order is more than a fifth off the simulation.

        Interpolated between strengths; None if it never is.
        """
        off = [
            abs(p - s) / s if s else 0.0
            for s, p in zip(self.simulated_rms, self.predicted_rms, strict=True)
        ]
        return first_reached(self.strengths, off, start=0.0, level=PARTED)

    def to_dict(self) -> dict[str, Any]:
        """All of it, as plain JSON values."""
        plain = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(self).items()}
        return {**plain, "doubles_at": self.doubles_at, "parts_at": self.parts_at}


def first_reached(
    strengths: Sequence[float],
    values: Sequence[float],
    *,
    start: float,
    level: float,
    power: int = 1,
) -> float | None:
    """The smallest strength without its sign at which values reach a level, interpolated.

    Between strengths, from `start` at 0, the values go with their power.

    Examples
    --------
    >>> first_reached((-2.0, -1.0, 1.0, 2.0), (4.0, 2.0, 1.0, 2.0), start=0.0, level=3.0)
    1.5
    """
    reached = []
    for sign in (-1, 1):
        side = sorted(
            (abs(s) ** power, v) for s, v in zip(strengths, values, strict=True) if s * sign > 0
        )
        before, value = 0.0, start
        for here, further in side:
            if further >= level:
                share = (level - value) / (further - value) if further > value else 0.0
                reached.append((before + max(share, 0.0) * (here - before)) ** (1 / power))
                break
            before, value = here, further
    return min(reached, default=None)


Array = NDArray[np.float64]


def predict_rms(clean_errors: Array, slopes: tuple[Array, Array], phi: Sequence[float]) -> Array:
    """RMS errors to first order, from two estimates of the errors' derivatives.

    Parameters
    ----------
    clean_errors : ndarray of shape (n_images, n_dofs)
    slopes : pair of ndarrays of shape (n_draws, n_images, n_dofs)
        Derivatives of the errors by ``phi``, each from differences of other images.
    phi : sequence of float
        How far to go along them.

    Returns
    -------
    ndarray of shape (len(phi), n_dofs)
        Over draws and images.

    Notes
    -----
    With ``e`` the clean errors and ``d``, ``d'`` the two derivatives, the mean square is
    ``<e^2> + phi <e (d + d')> + phi^2 <d d'>``. Features that count pixels change by leaps, and
    what a difference has of those is divided by a small step and would be multiplied by a large
    ``phi``. The leaps of the two differences have nothing to do with each other: in the product
    they average out, where the square of one would add them up. For smooth features
    ``d = d'``, and this is the mean square of ``e + phi d``.

    Examples
    --------
    >>> e, d = np.ones((1, 1)), np.full((1, 1, 1), 2.0)
    >>> predict_rms(e, (d, d), [-1.0, 3.0])[:, 0]
    array([1., 7.])
    """
    first, second = slopes
    square = (clean_errors**2).mean(axis=0)
    linear = (clean_errors * (first + second)).mean(axis=(0, 1))
    quadratic = np.maximum((first * second).mean(axis=(0, 1)), 0)
    strengths = np.asarray(phi, dtype=float)[:, None]
    mean_square = square + strengths * linear + strengths**2 * quadratic
    return np.asarray(np.sqrt(np.maximum(mean_square, 0)))
