"""What is measured, and where estimators come from: images and models are made once, and kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol

from servoscope import __version__
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.data.schedule import parse_schedule
from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS
from servoscope.positioning import Estimator, PositioningModel
from servoscope.processes import ProgressBar, one_blas_thread
from servoscope.scoreboard.cell import CONDITIONS
from servoscope.scoreboard.methods import LEARNERS, METHODS, make_photometric

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


class Stages(Protocol):
    """A folder that remembers which stages are finished."""

    path: Path

    def run_stage(
        self, name: str, inputs: Any, make: Callable[[], object], outputs: Sequence[str] = ()
    ) -> None:
        """Call ``make()``, unless it was called for the same inputs and has left its outputs."""

    def timings(self) -> dict[str, float]:
        """How long each stage took, and ``total``, [s]."""


_DATA_SET = ("meta.json", "images.zarr")


class Factory:
    """Makes the estimators of one scene and one robot, which has some dofs."""

    def __init__(
        self,
        folder: Stages,
        plan: Plan,
        scene: str,
        robot: str,
        dofs: tuple[str, ...] = DOFS,
        *,
        n_jobs: int,
        progress: ProgressBar,
    ) -> None:
        self.folder, self.plan = folder, plan
        self.scene, self.robot, self.dofs = scene, robot, dofs
        self.n_jobs, self.progress = n_jobs, progress
        self._loaded: dict[str, Estimator] = {}

    @property
    def name(self) -> str:
        """Scene, robot and what it moves in unless that is all, as files are called."""
        only = "" if self.dofs == DOFS else "_" + "".join(self.dofs)
        return f"{self.scene}_{self.robot}{only}"

    def prepare(self) -> None:
        """Take the images and train, as far as that is not done."""
        for method in LEARNERS if self.dofs == DOFS else ("ours",):
            inputs = {"images": self._config(method).plan(), "servoscope": __version__}
            name, data, model = f"{self.name}_{method}", self._data_set(method), self._model(method)
            whole = [str((data / part).relative_to(self.folder.path)) for part in _DATA_SET]
            self.folder.run_stage(
                f"images_{name}", inputs, partial(self._take_images, method), whole
            )
            made = [str(model.relative_to(self.folder.path))]
            self.folder.run_stage(f"train_{name}", inputs, partial(self._train, method), made)

    def estimator(self, method: str, depth_factor: float) -> Estimator:
        """The estimator of a method, once all is prepared; photometric servoing is given this depth
        factor.
        """
        if method not in LEARNERS:
            with one_blas_thread():
                config = self._config("ours")
                return make_photometric(self.scene, self._images, config, depth_factor)
        if method not in self._loaded:
            self._loaded[method] = PositioningModel.load(self._model(method))
        return self._loaded[method]

    @cached_property
    def _images(self) -> PoseImageSet:
        return PoseImageSet.load(self._data_set("ours"))

    def _config(self, method: str) -> AcquisitionConfig:
        return self.plan.acquisition(self.scene, self.robot, method, self.dofs)

    def _data_set(self, method: str) -> Path:
        return self.folder.path / "dataset" / f"{self.name}_{method}"

    def _model(self, method: str) -> Path:
        return self.folder.path / "models" / f"{self.name}_{method}"

    def _take_images(self, method: str) -> None:
        config, folder = self._config(method), self._data_set(method)
        folder.parent.mkdir(exist_ok=True)
        with self.progress(f"{folder.name}, images", config.total()) as advance:
            acquire(folder, config, n_jobs=self.n_jobs, on_progress=advance)

    def _train(self, method: str) -> None:
        options: dict[str, Any] = {"seed": self.plan.seed, "n_jobs": self.n_jobs}
        data, folder = PoseImageSet.load(self._data_set(method)), self._model(method)
        with self.progress(f"{folder.name}, training", None) as advance:
            model = LEARNERS[method](data, on_progress=advance, **options)
        folder.parent.mkdir(exist_ok=True)
        model.save(folder, force=True)
