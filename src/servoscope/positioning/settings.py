"""How long the loop goes on, when it is content, and what it never does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS, displacement_ranges
from servoscope.positioning.workspace import Workspace

Array = NDArray[np.float64]

NEAR_ENOUGH = {"mm": 0.05, "deg": 0.005}
"""Distance and angle that are always near enough where no tolerance is asked for."""

ORDINARY_MISS = {"mm": 0.5, "deg": 0.1}
"""Farther from where it is sent than this no robot comes to rest that is in order."""

LEAST_BOX = np.array([5e-3] * 3 + [np.radians(1.0)] * 3)
"""The least that a workspace measures from its middle, by dof, [m] and [rad]."""


_NO_NUMBERS = ("tolerances", "robot_workspace")


@dataclass(frozen=True)
class LoopSettings:
    """When a run ends, and the limits that it keeps to.

    Parameters
    ----------
    max_moves : int
        Moves towards the reference; a return to the best pose comes on top.
    tolerance_mm, tolerance_deg : float, optional
        Distance and angle from the reference that the run has to get under to converge. Without
        any tolerance it goes as near as the noise and the robot allow, or to `NEAR_ENOUGH`.
    tolerances : mapping of str to float, optional
        The same for single dofs about the pivot, such as ``{"tz": 0.1, "rz": 0.02}``, [mm] and
        [deg].
    noise_limit : float
        Displacements of no more than this many of their own standard deviations, as the root mean
        square over the dofs, twice in a row, are noise: there is nothing left to correct.
    repeatability_mm, repeatability_deg : float
        How far from where it is sent the robot comes to rest (one standard deviation an axis), if
        that is known; taken for noise too. Otherwise it is estimated on the way.
    max_step_mm, max_step_deg : float, optional
        A longer step is cut to this; by default the farthest that the estimator was made for.
    workspace_margin : float
        The poses stay in a box around the start, this many times the estimator's reach.
    robot_workspace : Workspace, optional
        A box in the robot's coordinates that the reported frame never leaves; by default that in
        which the images of the model were taken.
    novelty_limit : float
        The most unlike the training images that an image may be.
    least_similarity : float, optional
        The least similarity of an image with what the estimator expects at the displacement; by
        default what the estimator states.
    least_usable : float
        Share of the pixels that must not be clipped, unless the reference is clipped there.
    least_matched : float
        Share of the view that must show what the reference shows there, for the camera to have
        arrived.
    largest_innovation : float, optional
        What is seen after a move may differ from what the move led to expect by this share of it,
        if noise cannot explain the difference; None where displacements of the estimator are only
        directions, and cannot be checked.
    final_images : int
        So many images are taken where the camera seems to have arrived, and averaged: the noise of
        one is left in the end otherwise.
    largest_shift : float
        The most that the view may be displaced from the reference for the camera to have arrived,
        as the median over its matched cells, as a share of the longer side of the image.
    growth : float
        How much the image error must rise over two moves to be called divergence.
    patience : int
        Looks in a row that may bring the believed displacement to no new low, before that is called
        divergence; 0 for any number. It does not count where the finest stage answers.
    read_timeout_s, move_timeout_s : float, optional
        How long an image or a pose may take, and how long a move; None calls without a watch, in
        the thread of the caller.
    first_read_timeout_s : float, optional
        The same for the first image, for which a camera may have to start.
    execution_share : float, optional
        A robot may miss a move by this share of it, or by `execution_mm` and `execution_deg` if
        they are more; None for a robot that cannot go to every pose but reports where it went.
    execution_mm, execution_deg : float
        How far from where it is sent an ordinary move ends at most.

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
    tolerance_mm: float | None = None
    tolerance_deg: float | None = None
    tolerances: Mapping[str, float] = field(default_factory=dict)
    noise_limit: float = 2.0
    repeatability_mm: float = 0.0
    repeatability_deg: float = 0.0
    max_step_mm: float | None = None
    max_step_deg: float | None = None
    workspace_margin: float = 1.6
    robot_workspace: Workspace | None = None
    novelty_limit: float = 1.0
    least_similarity: float | None = None
    least_usable: float = 0.7
    least_matched: float = 0.5
    largest_innovation: float | None = 0.75
    final_images: int = 8
    largest_shift: float = 0.01
    growth: float = 0.05
    patience: int = 5
    read_timeout_s: float | None = 5.0
    first_read_timeout_s: float | None = 30.0
    move_timeout_s: float | None = 60.0
    execution_share: float | None = 0.2
    execution_mm: float = ORDINARY_MISS["mm"]
    execution_deg: float = ORDINARY_MISS["deg"]

    def __post_init__(self) -> None:
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _NO_NUMBERS}
        optional = {f.name for f in fields(self) if "None" in str(f.type)}
        if not isinstance(self.tolerances, Mapping):
            raise InvalidInputError(
                f"tolerances must map dofs to numbers, got a {type(self.tolerances).__name__}."
            )
        object.__setattr__(self, "tolerances", dict(self.tolerances))
        for dof, value in self.tolerances.items():
            if dof not in DOFS:
                raise InvalidInputError(
                    f"tolerances must be of dofs of {', '.join(DOFS)}, got {dof!r}."
                )
            values[f"The tolerance of {dof}"] = value
        for name, value in values.items():
            if value is None and name in optional:
                continue
            if not isinstance(value, Real) or not 0 <= float(value) < np.inf:
                raise InvalidInputError(
                    f"{name} must be a finite number that is not negative, got {value!r}."
                )
        for name in ("max_moves", "patience", "final_images"):
            value = getattr(self, name)
            if value != int(value):
                raise InvalidInputError(f"{name} must be a whole number, got {value!r}.")
        for name in ("max_step_mm", "max_step_deg"):
            if getattr(self, name) == 0:
                raise InvalidInputError(f"{name} must be more than 0, or None for the reach.")

    def for_poses_apart(self, mm: float, deg: float) -> LoopSettings:
        """The same for a robot that can only go to some poses, and reports to which it went.

        Parameters
        ----------
        mm, deg : float
            Distance and angle between neighbouring poses near the reference: it cannot be
            expected to come nearer.
        """
        return replace(self, execution_share=None, execution_mm=mm, execution_deg=deg)

    @property
    def is_coarse(self) -> bool:
        """Whether they are for a robot that can only go to some poses."""
        return self.execution_share is None

    @property
    def has_tolerance(self) -> bool:
        """Whether any tolerance was asked for."""
        return not (self.tolerance_mm is None and self.tolerance_deg is None) or bool(
            self.tolerances
        )

    def repeatability(self, pivot: float) -> Array:
        """Standard deviation that the robot's scatter makes of each dof, (6,), [m] and [rad]."""
        return _about_pivot(self.repeatability_mm, self.repeatability_deg, pivot)

    def allowed_miss(self, pivot: float) -> Array:
        """What missing a move by as much as is allowed makes of each dof, (6,), [m] and [rad]."""
        return _about_pivot(self.execution_mm, self.execution_deg, pivot)

    def step_limits(self, reach: Array, pivot: float) -> tuple[float, float]:
        """The longest step, [m] and [rad], for an estimator of the given reach."""
        ranges = np.maximum(displacement_ranges(reach, pivot, "camera"), LEAST_BOX)
        mm, deg = self.max_step_mm, self.max_step_deg
        return (
            float(np.linalg.norm(ranges[:3])) if mm is None else mm / 1e3,
            float(np.linalg.norm(ranges[3:])) if deg is None else float(np.radians(deg)),
        )

    def robot_box(self, estimator: Any) -> Workspace:
        """The box in the robot's coordinates that it does not leave with an estimator."""
        if self.robot_workspace is not None:
            return self.robot_workspace
        return Workspace.of_source(getattr(estimator, "trained_on", {}))

    def workspace(self, reach: Array, pivot: float) -> Array:
        """Half-widths of the box around the start, camera form, shape (6,), [m] and [rad].

        Infinite in dofs that are never commanded: the reach is 0 there.
        """
        ranges = displacement_ranges(reach, pivot, "camera")
        box = np.maximum(self.workspace_margin * ranges, LEAST_BOX)
        return np.where((reach > 0) | (ranges > 0), box, np.inf)


def _about_pivot(mm: float, deg: float, pivot: float) -> Array:
    position, rotation = mm / 1e3, np.radians(deg)
    sideways = np.hypot(position, pivot * rotation)
    return np.array([sideways, sideways, position, rotation, rotation, rotation])
