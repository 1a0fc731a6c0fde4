"""Sets of degrees of freedom: how they are written, and which ones a data set moves in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS

Array = NDArray[np.float64]

ENCODER_NOISE = 3e-4, float(np.radians(0.1))
"""Standard deviations up to which motion may be noise of the reported poses, [m] and [rad]."""

HARDLY_MOVES = 0.05
"""Share of the largest motion up to which it is taken for noise, if it is as small as that."""

LEAST_JUDGED = 10
"""Of fewer displacements than this all motion counts: by chance a dof may hardly differ in them."""

_ROUNDING = 1e-9


def check_dofs(dofs: Iterable[str]) -> tuple[str, ...]:
    """The degrees of freedom themselves, in the order of `DOFS`.

    Raises
    ------
    InvalidInputError
        If there are none, one is unknown, or one is named twice.

    Examples
    --------
    >>> check_dofs(["rz", "tx"])
    ('tx', 'rz')
    """
    names = tuple(dofs)
    unknown = [name for name in names if name not in DOFS]
    if unknown or not names or len(set(names)) < len(names):
        raise InvalidInputError(
            f"dofs must be some of {', '.join(DOFS)}, each named once, got "
            f"{','.join(map(str, names)) or 'none'}."
        )
    return tuple(dof for dof in DOFS if dof in names)


def parse_dofs(text: str) -> tuple[str, ...]:
    """The degrees of freedom that a text names, with commas between them.

    Raises
    ------
    InvalidInputError
        If it names anything else, or one of them twice.

    Examples
    --------
    >>> parse_dofs("tx, ty,rz")
    ('tx', 'ty', 'rz')
    """
    return check_dofs(word.strip() for word in text.split(","))


def mask_of(dofs: Iterable[str]) -> NDArray[np.bool_]:
    """Whether each of `DOFS` is one of them, shape (6,)."""
    return np.isin(DOFS, list(dofs))


def moving_dofs(delta_p: Array, pivot: float) -> tuple[str, ...]:
    """The degrees of freedom that displacements move in, and not by the noise of encoders alone.

    A dof does not move if its deviation is at most `HARDLY_MOVES` of the largest one, rotations
    counting by how far they carry the camera about the pivot, and at most what `ENCODER_NOISE`
    makes of it about the pivot. Fewer than `LEAST_JUDGED` images are not judged.

    Parameters
    ----------
    delta_p : ndarray of shape (n, 6)
        About the pivot, [m] and [rad].
    pivot : float
        [m].

    Examples
    --------
    >>> delta_p = 0.02 * np.random.default_rng(0).uniform(-1, 1, (30, 6))
    >>> delta_p[:, 2:5] *= 0.005
    >>> moving_dofs(delta_p, pivot=0.5)
    ('tx', 'ty', 'rz')
    """
    position, rotation = ENCODER_NOISE
    sideways = float(np.hypot(position, pivot * rotation))
    noise = np.array([sideways, sideways, position, rotation, rotation, rotation])
    std = delta_p.std(axis=0)
    carried = std * np.repeat([1.0, abs(pivot) or 1.0], 3)
    moves = (std > noise) | (carried > HARDLY_MOVES * carried.max()) | (len(delta_p) < LEAST_JUDGED)
    moves &= np.ptp(delta_p, axis=0) > _ROUNDING
    return tuple(dof for dof, is_moved in zip(DOFS, moves, strict=True) if is_moved)
