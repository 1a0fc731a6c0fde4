"""How long the loop goes on, when it is content, and what it never does."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.poses import displacement_ranges

Array = NDArray[np.float64]

_LEAST_BOX = np.array([5e-3] * 3 + [np.radians(1.0)] * 3)


@dataclass(frozen=True)
class LoopSettings:
    """When a run ends, and the limits that it keeps to.

    Parameters
    ----------
    max_moves : int
        Moves towards the reference; a return to the best pose comes on top.
    tolerance_mm, tolerance_deg : float
        The run has converged when the believed displacement is under both.
    noise_limit : float
        It has also converged when the believed displacement is twice in a row no more than this
        many of its own standard deviations, as the root mean square over the dofs.
    repeatability_mm, repeatability_deg : float
        How far from where it is sent the robot comes to rest (one standard deviation an axis);
        taken for noise too.
    max_step_mm, max_step_deg : float, optional
        A longer step is cut to this; by default the farthest that the estimator was made for.
    workspace_margin : float
        The poses stay in a box around the start, this many times the estimator's reach.
    novelty_limit : float
        The most unlike the training images that an image may be.
    growth : float
        How much the image error must rise over two moves to be called divergence.
    patience : int
        Looks in a row that may bring the believed displacement to no new low, before that is called
        divergence; 0 for any number. It does not count where the finest stage answers.
    read_timeout_s, move_timeout_s : float, optional
        How long an image, or a pose, and a move may take; None calls without a watch, in the
        thread of the caller.
    execution_share : float
        A robot may miss a move by this share of it, or by
        `execution_mm` and `execution_deg` if they are more.
    execution_mm, execution_deg : float

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite, or a longest step is 0.

    Examples
    --------
    >>> LoopSettings(max_moves=20, tolerance_mm=0.2).max_moves
    20
    """

    max_moves: int = 12
    tolerance_mm: float = 0.05
    tolerance_deg: float = 0.005
    noise_limit: float = 2.0
    repeatability_mm: float = 0.0
    repeatability_deg: float = 0.0
    max_step_mm: float | None = None
    max_step_deg: float | None = None
    workspace_margin: float = 1.3
    novelty_limit: float = 1.0
    growth: float = 0.05
    patience: int = 5
    read_timeout_s: float | None = 5.0
    move_timeout_s: float | None = 60.0
    execution_share: float = 0.2
    execution_mm: float = 0.5
    execution_deg: float = 0.1

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and "None" in str(field.type):
                continue
            if not isinstance(value, int | float) or not 0 <= value < np.inf:
                raise InvalidInputError(
                    f"{field.name} must be a finite number that is not negative, got {value!r}."
                )
        for name in ("max_moves", "patience"):
            value = getattr(self, name)
            if value != int(value):
                raise InvalidInputError(f"{name} must be a whole number, got {value!r}.")
        for name in ("max_step_mm", "max_step_deg"):
            if getattr(self, name) == 0:
                raise InvalidInputError(f"{name} must be more than 0, or None for the reach.")

    def step_limits(self, reach: Array, pivot: float) -> tuple[float, float]:
        """The longest step, [m] and [rad], for an estimator of the given reach."""
        ranges = np.maximum(displacement_ranges(reach, pivot, "camera"), _LEAST_BOX)
        mm, deg = self.max_step_mm, self.max_step_deg
        return (
            float(np.linalg.norm(ranges[:3])) if mm is None else mm / 1e3,
            float(np.linalg.norm(ranges[3:])) if deg is None else float(np.radians(deg)),
        )

    def workspace(self, reach: Array, pivot: float) -> Array:
        """Half-widths of the box around the start, camera form, shape (6,), [m] and [rad]."""
        ranges = displacement_ranges(reach, pivot, "camera")
        return np.maximum(self.workspace_margin * ranges, _LEAST_BOX)
