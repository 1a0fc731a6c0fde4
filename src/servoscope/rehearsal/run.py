"""A rehearsal: the loop under the scoreboard's conditions, on images rendered of a model's view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from servoscope.acquisition.simulated import MOST_DEG, MOST_MM
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.processes import ProgressBar, in_processes, no_progress, one_blas_thread
from servoscope.rehearsal.rendered_cell import cell_at_reference, cell_at_start
from servoscope.rehearsal.true_view import OwnErrors
from servoscope.scoreboard.cell import CONDITIONS, start_direction
from servoscope.scoreboard.methods import loop_settings
from servoscope.scoreboard.summary import summarise
from servoscope.scoreboard.trial import Trial, run_trial

ENOUGH = 0.95
"""Share of the starts that has to arrive for a condition to be called safe."""


def summarise_rehearsal(trials: Sequence[Trial]) -> dict[str, Any]:
    """The numbers of one condition, as plain JSON values.

    Parameters
    ----------
    trials : sequence of Trial
        One at least.
    """
    numbers = summarise(trials)
    del numbers["decision_ms_median"]  # another one at every run
    low, high = _interval(numbers)
    wrong = sum(trial.status == "converged" and not trial.succeeded for trial in trials)
    return {
        **numbers,
        "success_interval": [round(low, 4), round(high, 4)],
        "wrongly_converged": wrong,
    }


def _interval(numbers: Mapping[str, Any]) -> tuple[float, float]:
    """95 % interval of the share of starts that arrive (Wilson)."""
    found = binomtest(numbers["success"], numbers["trials"]).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def verdict(results: Mapping[str, Mapping[str, Any]]) -> str:
    """One sentence: where the camera arrives, and where not.

    Examples
    --------
    >>> verdict({"x": {"success": 7, "trials": 20, "wrongly_converged": 2}})
    "Fewer than 95% of 20 starts arrive under x (35%); 2 runs say 'converged' farther away."
    """
    shares = {name: numbers["success"] / numbers["trials"] for name, numbers in results.items()}
    few = {name: share for name, share in shares.items() if share < ENOUGH}
    wrong = sum(numbers["wrongly_converged"] for numbers in results.values())
    n_starts = max(numbers["trials"] for numbers in results.values())
    where = "under every condition" if len(shares) > 1 else f"under {next(iter(shares))}"
    if not few:
        low = min(_interval(numbers)[0] for numbers in results.values())
        said = (
            f"At least {ENOUGH:.0%} of {n_starts} starts arrive {where}, which of all starts may "
            f"be as few as {low:.0%}"
        )
    else:
        weak = ", ".join(f"{name} ({share:.0%})" for name, share in few.items())
        rest = len(shares) - len(few)
        fewer = f"fewer than {ENOUGH:.0%} of {n_starts} starts arrive under {weak}"
        others = f"; under the other {rest} at least as many do" if rest else ""
        said = fewer[0].upper() + fewer[1:] + others
    runs = "run says" if wrong == 1 else "runs say"
    trust = f"{wrong or 'no'} {runs} 'converged' farther away"
    return f"{said}; {trust}."


Array = NDArray[np.float64]

STARTS = 20
"""Starts under each condition."""

REHEARSED = tuple(name for name in CONDITIONS if CONDITIONS[name].is_of_images)
"""The conditions that can be made of images of a part."""

_STARTS_PER_CALL = 2


@dataclass(frozen=True)
class Rehearsal:
    """What a rehearsal is made of.

    Parameters
    ----------
    model : KeyframeModel
        Features hold no view to render: see `as_keyframe_model`.
    starts : int
        Under each condition.
    seed : int
        Of the starts, of the views' errors, of disturbances and noise.
    range_mm, range_deg : float, optional
        Largest displacement of a start along and about each axis, about the pivot; by default the
        range that the model's images were asked for with, or else the largest of its images.
        Not above 200 mm and 60 deg, or the largest of the model's images where that is more.

    Raises
    ------
    InvalidInputError
        If there is no start, or a range is not positive or too large.
    """

    model: KeyframeModel
    starts: int = STARTS
    seed: int = 0
    range_mm: float | None = None
    range_deg: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.starts, int) or self.starts < 1:
            raise InvalidInputError(f"starts must be a whole number from 1, got {self.starts!r}.")
        reach = np.array(self.model.reach) * DISPLAY_FACTORS
        for name, limit in (
            ("range_mm", max(MOST_MM, *reach[:3])),
            ("range_deg", max(MOST_DEG, *reach[3:])),
        ):
            value = getattr(self, name)
            if value is not None and not 0 < value <= limit:
                raise InvalidInputError(
                    f"{name} must be above 0 and at most {limit:g}, got {value!r}."
                )

    @cached_property
    def ranges(self) -> Array:
        """Largest displacements of a start about the pivot, [m] and [rad], 0 in other dofs."""
        source = self.model.trained_on
        asked = np.array(self.model.reach, dtype=float)
        for part, name, given in (
            (slice(0, 3), "translation_mm", self.range_mm),
            (slice(3, 6), "rotation_deg", self.range_deg),
        ):
            value = source.get(name) if given is None else given
            if isinstance(value, int | float) and 0 < value < np.inf:
                asked[part] = value / DISPLAY_FACTORS[part]
        return np.where(mask_of(self.model.dofs), asked, 0.0)

    @cached_property
    def errors(self) -> OwnErrors:
        """How far the model's keyframe is from the truth."""
        with one_blas_thread():
            return OwnErrors.of(self.model)

    def run(
        self, condition: str, *, n_jobs: int = -1, progress: ProgressBar = no_progress
    ) -> dict[str, Any]:
        """All starts under a condition of `REHEARSED`.

        Parameters
        ----------
        condition : str

        Returns
        -------
        dict
            What `summarise_rehearsal` says, and ``starts``: for each its direction in shares of
            the range, how it ended, and where.
        """
        check_conditions([condition])
        numbers = range(self.starts)
        blocks = [numbers[k : k + _STARTS_PER_CALL] for k in numbers[::_STARTS_PER_CALL]]
        what = (self.model, self.errors, self.ranges, condition, self.seed)
        trials: list[Trial] = []
        with progress(condition, self.starts) as advance:
            calls = [(block, *what) for block in blocks]
            for block in in_processes(_run_block, calls, n_jobs):
                trials += block
                advance(len(trials))
        shares = CONDITIONS[condition].factor * mask_of(self.model.dofs)
        return {
            **summarise_rehearsal(trials),
            "starts": [
                {
                    "shares": (shares * start_direction(self.seed, k)).round(4).tolist(),
                    "succeeded": trial.succeeded,
                    "status": trial.status,
                    "message": trial.message,
                    "moves": trial.moves,
                    "end_mm": trial.end_mm,
                    "end_deg": trial.end_deg,
                }
                for k, trial in enumerate(trials)
            ],
        }

    def first_image(self, condition: str) -> NDArray[np.uint8]:
        """What is seen from the first start under a condition."""
        with one_blas_thread():
            cell = cell_at_start(
                self.model, self.errors, self.ranges, condition, self.seed, start=0
            )
            return cell.read()

    def described_ranges(self) -> dict[str, dict[str, Any]]:
        """Largest displacement of a start in each dof, ``{"value", "unit"}``."""
        values = (self.ranges * DISPLAY_FACTORS).round(6).tolist()
        return {
            dof: {"value": value, "unit": unit}
            for dof, value, unit in zip(DOFS, values, DISPLAY_UNITS, strict=True)
            if dof in self.model.dofs
        }


def check_conditions(names: Sequence[str]) -> tuple[str, ...]:
    """The names themselves, if all are of `REHEARSED`."""
    for name in names:
        if name not in REHEARSED:
            needs = " (that needs another part or robot)" if name in CONDITIONS else ""
            raise InvalidInputError(
                f"A condition that can be rehearsed is one of {', '.join(REHEARSED)}, got "
                f"{name!r}{needs}."
            )
    return tuple(names)


def as_keyframe_model(model: Any, where: str) -> KeyframeModel:
    """The model itself, if it has a keyframe to render from."""
    if isinstance(model, KeyframeModel):
        return model
    raise InvalidInputError(
        f"Views are rendered from a keyframe, but {where} is a model of features, which has none; "
        "make one of 20 to 60 images of the range: servoscope train DATASET --method keyframe."
    )


def _run_block(
    starts: range,
    model: KeyframeModel,
    errors: OwnErrors,
    ranges: Array,
    condition: str,
    seed: int,
) -> list[Trial]:
    settings = loop_settings("ours", CONDITIONS[condition].repeatability)
    reference = cell_at_reference(model)
    with one_blas_thread():
        return [
            run_trial(
                cell_at_start(model, errors, ranges, condition, seed, start),
                reference,
                model,
                settings,
            )
            for start in starts
        ]
