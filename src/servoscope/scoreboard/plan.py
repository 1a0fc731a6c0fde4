"""What is measured: images to learn from, conditions, and how many starts each method has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from servoscope.acquisition import AcquisitionConfig
from servoscope.data.schedule import parse_schedule
from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS
from servoscope.scoreboard.conditions import CONDITIONS
from servoscope.scoreboard.methods import METHODS

QUICK_CONDITIONS = ("range_1.0", "gain_0.8", "covered_10", "noise_10")
SCHEDULES = {"ours": "40@1.6", "networks": "1000@1.6"}
"""The images that each method learns from."""

QUICK_SCHEDULES = {"ours": "40@1.6", "networks": "400@1.6"}

STARTS, QUICK_STARTS = 100, 10

_BASELINE_STARTS = {"cylinder_head": (40, 15), "textured_plane": (100, 40)}
"""Trials of the baseline at range 1.0 and elsewhere: an image of the head takes 25 ms, one of the
plane 2 ms, and each trial a hundred of them."""

_QUICK_BASELINE_STARTS = {"cylinder_head": (3, 3), "textured_plane": (10, 10)}


@dataclass(frozen=True)
class Plan:
    """What a run of the scoreboard measures.

    Parameters
    ----------
    quick : bool
        Fewer images, conditions and starts.
    seed : int
        Of the starts, the images, the noise and the nets.
    starts : int, optional
        Starts of each method under each condition; the baseline has no more than fit in the time.
    image_size : int
        Height and width, [px].
    schedules : dict of str, optional
        The images that each method learns from, instead of `SCHEDULES`, see `parse_schedule`.
    conditions : sequence of str, optional
        Names of `CONDITIONS`, instead of those that are meant.

    Raises
    ------
    InvalidInputError
        If there is no start, or no such condition.

    Examples
    --------
    >>> Plan(quick=True).n_trials("cylinder_head", "noise_10", "photometric")
    3
    """

    quick: bool = False
    seed: int = 0
    starts: int | None = None
    image_size: int = 256
    schedules: Mapping[str, str] = field(default_factory=dict)
    conditions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.n_starts, int) or self.n_starts < 1:
            raise InvalidInputError(f"starts must be a whole number from 1, got {self.starts!r}.")
        if not self.schedules:
            meant = QUICK_SCHEDULES if self.quick else SCHEDULES
            object.__setattr__(self, "schedules", dict(meant))
        if not self.conditions:
            conditions = QUICK_CONDITIONS if self.quick else tuple(CONDITIONS)
            object.__setattr__(self, "conditions", conditions)
        if unknown := sorted(set(self.conditions) - set(CONDITIONS)):
            raise InvalidInputError(
                f"A condition is one of {', '.join(CONDITIONS)}, got {unknown[0]!r}."
            )
        for method in self.schedules:
            self.acquisition("textured_plane", "free", method)

    @property
    def n_starts(self) -> int:
        """Starts of a method that learns, under each condition."""
        if self.starts is None:
            return QUICK_STARTS if self.quick else STARTS
        return self.starts

    def acquisition(
        self, scene: str, robot: str, method: str, dofs: tuple[str, ...] = DOFS
    ) -> AcquisitionConfig:
        """The images that a method learns from."""
        return AcquisitionConfig(
            image_size=self.image_size,
            seed=self.seed,
            schedule=parse_schedule(self.schedules[method]),
            part=scene,
            robot=robot,
            dofs=dofs,
        )

    def methods(self, condition: str) -> tuple[str, ...]:
        """The methods that are measured under a condition: ours alone moves in some dofs only."""
        return METHODS if CONDITIONS[condition].dofs == DOFS else METHODS[:1]

    def n_trials(self, scene: str, condition: str, method: str) -> int:
        """How many starts a method has; 0 where its trials are those of range 1.0."""
        if method != "photometric":
            return 0 if self.is_repeated(condition) else self.n_starts
        numbers = _QUICK_BASELINE_STARTS if self.quick else _BASELINE_STARTS
        at_full_range, elsewhere = numbers[scene]
        return min(self.n_starts, at_full_range if condition == "range_1.0" else elsewhere)

    def is_repeated(self, condition: str) -> bool:
        """Whether a condition is range 1.0 over again for all but the baseline."""
        there = condition != "range_1.0" and "range_1.0" in self.conditions
        return there and CONDITIONS[condition].is_for_baseline_alone
