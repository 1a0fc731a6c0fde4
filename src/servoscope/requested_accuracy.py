"""The accuracy that is asked for, as ``t=0.1mm,r=0.02deg``."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError

_PART = re.compile(r"([tr])=([0-9.eE+-]+)(mm|m|deg|rad)")
_UNITS = {"t": {"mm": 1e-3, "m": 1.0}, "r": {"deg": math.pi / 180, "rad": 1.0}}


@dataclass(frozen=True)
class RequestedAccuracy:
    """Largest median errors that are wanted.

    Parameters
    ----------
    translation, rotation : float
        Of each translation, [m], and of each rotation, [rad].

    Raises
    ------
    InvalidInputError
        If they are not positive.
    """

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


def parse_accuracy(text: str) -> RequestedAccuracy:
    """The accuracy that a text names: ``t=NUMBERmm,r=NUMBERdeg``, or in m and rad.

    Raises
    ------
    InvalidInputError
        If it cannot be read, or a number is not positive.

    Examples
    --------
    >>> str(parse_accuracy("r=0.02deg, t=0.0001m"))
    't=0.1mm,r=0.02deg'
    """
    found: dict[str, float] = {}
    for word in text.split(","):
        match = _PART.fullmatch(word.strip())
        value = math.nan
        if match is not None and match[1] not in found:
            with suppress(ValueError):
                value = float(match[2]) * _UNITS[match[1]].get(match[3], math.nan)
        if not (math.isfinite(value) and value > 0) or match is None:
            raise InvalidInputError(
                f"An accuracy is t=NUMBERmm,r=NUMBERdeg with positive numbers, such as "
                f"t=0.1mm,r=0.02deg; got {word.strip()!r}."
            )
        found[match[1]] = value
    if len(found) < 2:
        raise InvalidInputError(
            f"An accuracy names both t and r, such as t=0.1mm,r=0.02deg; got {text!r}."
        )
    return RequestedAccuracy(found["t"], found["r"])
