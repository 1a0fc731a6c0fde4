"""Degrees of freedom: how sets of them and tolerances are written, and which a set moves in."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLAY_UNITS, DOFS

Array = NDArray[np.float64]

ENCODER_NOISE = 3e-4, float(np.radians(0.1))
"""Standard deviations up to which motion may be noise of the reported poses, [m] and [rad]."""

HARDLY_MOVES = 0.05
"""Share of the largest motion up to which it is taken for noise, if it is as small as that."""

LEAST_JUDGED = 10
"""Of fewer displacements than this all motion counts: by chance a dof may hardly differ in them."""

_ROUNDING = 1e-9


def check_dofs(dofs: Iterable[str]) -> tuple[str, ...]:
    """The degrees of freedom themselves, in the order of `DOFS`: one at least, and each named once.

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
    """The degrees of freedom that displacements about the pivot, (n, 6), move in, and not by the
    noise of encoders alone.

    A dof does not move if its deviation is at most `HARDLY_MOVES` of the largest one, rotations
    counting by how far they carry the camera about the pivot, and at most what `ENCODER_NOISE`
    makes of it about the pivot. Fewer than `LEAST_JUDGED` images are not judged.

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


_PART = re.compile(r"\s*(\w+)\s*=\s*([-+.\deE]+?)\s*(mm|um|m|deg|mrad|rad)\s*")

_FACTORS = {
    "mm": {"mm": 1.0, "um": 1e-3, "m": 1e3},
    "deg": {"deg": 1.0, "rad": float(np.degrees(1.0)), "mrad": 1e-3 * float(np.degrees(1.0))},
}


@dataclass(frozen=True)
class RequestedAccuracy:
    """Largest median errors that are wanted of translations, [m], and of rotations, [rad]."""

    translation: float
    rotation: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value > 0):
                raise InvalidInputError(f"{name} must be a positive accuracy, got {value}.")

    @property
    def by_dof(self) -> NDArray[np.float64]:
        """Shape (6,), [m] and [rad], in `DOFS` order."""
        return np.repeat([self.translation, self.rotation], 3)

    def __str__(self) -> str:
        return f"t={1e3 * self.translation:.6g}mm,r={math.degrees(self.rotation):.6g}deg"


def parse_tolerances(text: str, dofs: Iterable[str] = DOFS) -> dict[str, float]:
    """Tolerances by dof, [mm] and [deg], in `DOFS` order, of a text such as ``tx=0.5mm,rz=0.1deg``.

    ``t`` and ``r`` stand for all dofs of a kind that there are. Units are mm, um and m, or deg, rad
    and mrad.

    Examples
    --------
    >>> parse_tolerances("rz=0.1deg, tx=500um")
    {'tx': 0.5, 'rz': 0.1}
    >>> parse_tolerances("t=1mm")
    {'tx': 1.0, 'ty': 1.0, 'tz': 1.0}
    """
    tolerances: dict[str, float] = {}
    for part in filter(str.strip, text.split(",")):
        name, value, unit = _read(part)
        named = [dof for dof in dofs if name in (dof, dof[0])]
        if not named:
            raise InvalidInputError(
                f"A tolerance must be of a dof that there is, {', '.join(dofs)}, got "
                f"{part.strip()!r}; leave it out."
            )
        for dof in named:
            if dof in tolerances:
                raise InvalidInputError(f"{dof} is named twice in {text!r}; name it once.")
            tolerances[dof] = value * _factor(part, dof, unit)
    return {dof: tolerances[dof] for dof in DOFS if dof in tolerances}


def _read(part: str) -> tuple[str, float, str]:
    match = _PART.fullmatch(part)
    try:
        name, number, unit = match.groups() if match else ("", "", "")
        value = float(number)
    except ValueError:
        value = np.nan
    if not 0 < value < np.inf or name not in {*DOFS, "t", "r"}:
        raise InvalidInputError(
            f"A tolerance is written like tx=0.5mm or rz=0.1deg, with one of {', '.join(DOFS)}, t "
            f"and r, a positive number and its unit, got {part.strip()!r}."
        )
    return name, value, unit


def _factor(part: str, dof: str, unit: str) -> float:
    factors = _FACTORS[DISPLAY_UNITS[DOFS.index(dof)]]
    if unit not in factors:
        raise InvalidInputError(
            f"The tolerance of {dof} is in {' or '.join(factors)}, got {part.strip()!r}."
        )
    return factors[unit]


def parse_accuracy(text: str) -> RequestedAccuracy:
    """One accuracy for all translations and one for all rotations, both named.

    Examples
    --------
    >>> str(parse_accuracy("r=0.02deg, t=0.0001m"))
    't=0.1mm,r=0.02deg'
    """
    values = list(parse_tolerances(text).values())
    if len(values) != len(DOFS) or len(set(values[:3])) > 1 or len(set(values[3:])) > 1:
        raise InvalidInputError(
            f"An accuracy names both t and r, such as t=0.1mm,r=0.02deg; got {text!r}."
        )
    return RequestedAccuracy(values[0] / 1e3, math.radians(values[-1]))
