"""The accuracy that somebody wishes for, degree of freedom by degree of freedom."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLAY_UNITS, DOFS

_WISH = re.compile(r"\s*(\w+)\s*=\s*([-+.\deE]+?)\s*(mm|um|m|deg|mrad|rad)\s*")

_FACTORS = {
    "mm": {"mm": 1.0, "um": 1e-3, "m": 1e3},
    "deg": {"deg": 1.0, "rad": float(np.degrees(1.0)), "mrad": 1e-3 * float(np.degrees(1.0))},
}


def parse_wishes(text: str, dofs: Iterable[str] = DOFS) -> dict[str, float]:
    """Wished RMS errors by dof, [mm] and [deg].

    Parameters
    ----------
    text : str
        Such as ``tx=0.5mm,rz=0.1deg``; ``t`` and ``r`` stand for all three of a kind. Units are
        mm, um and m, or deg, rad and mrad. Empty for no wish at all.
    dofs : iterable of str
        That there are: ``t`` and ``r`` stand for these alone.

    Returns
    -------
    dict of str to float
        In `DOFS` order.

    Raises
    ------
    InvalidInputError
        If a part is no wish, its unit is of the other kind, it is not positive, or a dof is
        named twice or is none of those there are.

    Examples
    --------
    >>> parse_wishes("rz=0.1deg, tx=500um")
    {'tx': 0.5, 'rz': 0.1}
    >>> parse_wishes("t=1mm")
    {'tx': 1.0, 'ty': 1.0, 'tz': 1.0}
    """
    wishes: dict[str, float] = {}
    for part in filter(str.strip, text.split(",")):
        name, value, unit = _read(part)
        named = [dof for dof in dofs if name in (dof, dof[0])]
        if not named:
            raise InvalidInputError(
                f"A tolerance must be of a dof that there is, {', '.join(dofs)}, got "
                f"{part.strip()!r}; leave it out."
            )
        for dof in named:
            if dof in wishes:
                raise InvalidInputError(f"{dof} is named twice in {text!r}; name it once.")
            wishes[dof] = value * _factor(part, dof, unit)
    return {dof: wishes[dof] for dof in DOFS if dof in wishes}


def _read(part: str) -> tuple[str, float, str]:
    match = _WISH.fullmatch(part)
    try:
        name, number, unit = match.groups() if match else ("", "", "")
        value = float(number)
    except ValueError:
        value = np.nan
    if not 0 < value < np.inf or name not in {*DOFS, "t", "r"}:
        raise InvalidInputError(
            f"An accuracy is written like tx=0.5mm or rz=0.1deg, with one of "
            f"{', '.join(DOFS)} and a positive number, got {part.strip()!r}."
        )
    return name, value, unit


def _factor(part: str, dof: str, unit: str) -> float:
    factors = _FACTORS[DISPLAY_UNITS[DOFS.index(dof)]]
    if unit not in factors:
        raise InvalidInputError(f"{dof} is told in {' or '.join(factors)}, got {part.strip()!r}.")
    return factors[unit]
