"""Where estimators come from: images are taken and models trained once, and kept in the folder."""

from __future__ import annotations

from functools import cached_property, partial
from pathlib import Path

from servoscope import __version__
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.poses import DOFS
from servoscope.positioning import Estimator
from servoscope.processes import one_blas_thread
from servoscope.progress import ProgressBar
from servoscope.scoreboard.learners import LEARNERS
from servoscope.scoreboard.methods import make_photometric
from servoscope.scoreboard.plan import Plan
from servoscope.scoreboard.stages import Stages


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
        inputs = {"images": self._config.plan(), "servoscope": __version__}
        whole = [f"dataset/{self.name}/{part}" for part in ("meta.json", "images.zarr")]
        self.folder.run_stage(f"images_{self.name}", inputs, self._take_images, whole)
        for method in LEARNERS if self.dofs == DOFS else ("ours",):
            stage, model = f"train_{self.name}_{method}", self._model(method)
            made = [str(model.relative_to(self.folder.path))]
            self.folder.run_stage(stage, inputs, partial(self._train, method), made)

    def estimator(self, method: str, depth_factor: float) -> Estimator:
        """The estimator of a method, once all is prepared.

        Parameters
        ----------
        method : str
        depth_factor : float
            What photometric servoing is told of the depth, relative to the truth.
        """
        if method in LEARNERS:
            return self._learned(method)
        with one_blas_thread():
            return make_photometric(self.scene, self._images, self._config, depth_factor)

    def _learned(self, method: str) -> Estimator:
        if method not in self._loaded:
            self._loaded[method] = LEARNERS[method].load(self._model(method))
        return self._loaded[method]

    @property
    def _config(self) -> AcquisitionConfig:
        return self.plan.acquisition(self.scene, self.robot, self.dofs)

    @cached_property
    def _images(self) -> PoseImageSet:
        return PoseImageSet.load(self._data_set)

    @property
    def _data_set(self) -> Path:
        return self.folder.path / "dataset" / self.name

    def _model(self, method: str) -> Path:
        return self.folder.path / "models" / f"{self.name}_{method}"

    def _take_images(self) -> None:
        self._data_set.parent.mkdir(exist_ok=True)
        with self.progress(f"{self.name}, images", self._config.total()) as advance:
            acquire(self._data_set, self._config, n_jobs=self.n_jobs, on_progress=advance)

    def _train(self, method: str) -> None:
        options = {"seed": self.plan.seed, "n_jobs": self.n_jobs}
        with self.progress(f"{self.name}, training {method}", None) as advance:
            model = LEARNERS[method].train(self._images, on_progress=advance, **options)
        self._model(method).parent.mkdir(exist_ok=True)
        LEARNERS[method].save(model, self._model(method))
