"""Where estimators come from: images are taken and models trained once, and kept in the folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Protocol

from servoscope import __version__
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.poses import DOFS
from servoscope.positioning import Estimator, PositioningModel
from servoscope.processes import one_blas_thread
from servoscope.progress import ProgressBar
from servoscope.scoreboard.methods import LEARNERS, make_photometric
from servoscope.scoreboard.plan import Plan


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
    """Makes the estimators of one scene and one robot.

    Parameters
    ----------
    folder : Stages
    plan : Plan
    scene, robot : str
    dofs : tuple of str
        That the robot has.
    n_jobs : int
    progress : ProgressBar
    """

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
        """The estimator of a method, once all is prepared.

        Parameters
        ----------
        method : str
        depth_factor : float
            The depth that photometric servoing is given, relative to the truth.
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
