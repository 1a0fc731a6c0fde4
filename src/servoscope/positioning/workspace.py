"""The box in the robot's own coordinates that it is not to leave."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError

Array = NDArray[np.float64]


class Workspace(NamedTuple):
    """A box in the robot's own coordinates, which the frame that it reports never leaves.

    Parameters
    ----------
    low, high : tuples of 3 floats
        Corners, [m]; infinite where there is no limit.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def parse(cls, text: str) -> Workspace:
        """The box that a text names, in millimetres.

        Raises
        ------
        InvalidInputError
            If it cannot be read.

        Examples
        --------
        >>> Workspace.parse("x=300:700,z=100:600").high
        (0.7, inf, 0.6)
        """
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        try:
            for word in filter(None, text.replace(" ", "").split(",")):
                axis, _, limits = word.partition("=")
                k = ["x", "y", "z"].index(axis)
                low[k], high[k] = (float(limit) / 1e3 for limit in limits.split(":"))
        except ValueError:
            low, high = np.ones(3), np.zeros(3)
        if not (low < high).all():
            raise InvalidInputError(
                "A workspace must be limits in mm, the lower first, such as "
                f"x=300:700,y=-200:200,z=100:600, got {text!r}."
            )
        return cls(tuple(low.tolist()), tuple(high.tolist()))

    @classmethod
    def of_source(cls, source: Mapping[str, Any]) -> Workspace:
        """The box that images were taken in, as the source of their data set says; or no limit."""
        try:
            low, high = source["workspace"]
            low, high = (
                np.array([side if x is None else x for x in corner], dtype=float)
                for corner, side in ((low, -np.inf), (high, np.inf))
            )
        except (KeyError, TypeError, ValueError):
            return UNLIMITED
        is_box = low.shape == high.shape == (3,) and bool((low < high).all())
        return cls(tuple(low.tolist()), tuple(high.tolist())) if is_box else UNLIMITED

    def corners(self) -> list[list[float | None]]:
        """Low and high, [m], as plain JSON values: None where there is no limit."""
        return [[float(x) if np.isfinite(x) else None for x in corner] for corner in self]

    @property
    def is_limited(self) -> bool:
        """Whether there is any limit."""
        return bool(np.isfinite([self.low, self.high]).any())

    def holds(self, T: Array) -> bool:
        """Whether the origin of a pose (4, 4), or of several, is inside."""
        t = T[..., :3, 3]
        return bool(((np.array(self.low) <= t) & (t <= np.array(self.high))).all())

    def __str__(self) -> str:
        return ", ".join(
            f"{axis} {1e3 * low:g} to {1e3 * high:g} mm"
            for axis, low, high in zip("xyz", self.low, self.high, strict=True)
            if np.isfinite([low, high]).any()
        )


UNLIMITED = Workspace((-np.inf,) * 3, (np.inf,) * 3)
