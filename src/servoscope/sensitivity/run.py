"""The sensitivity analysis: what it is made of, its models, and each disturbance in turn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from servoscope.acquisition import AcquisitionConfig
from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.features.catalogue import FAMILIES
from servoscope.pipeline import Recipe
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.processes import ProgressBar, in_processes, no_progress
from servoscope.regression import REGRESSORS
from servoscope.scene.disturbances import DISTURBANCES
from servoscope.sensitivity.measurement import PoseModel, fit_pose_model, measure, n_sets

FEATURES = {name: Recipe(name) for name in FAMILIES.built_in} | {
    "eigenfeatures": Recipe("eigenfeatures", ("e_[01]?", "e_2[0-3]"))
}
"""What a model may take, by name: the families of the catalogue; of eigenfeatures, the paper's."""

DEFAULT_FEATURES = ("moments", "eigenfeatures", "tchebichef")
"""Two of the paper's families, and a smooth one."""


@dataclass(frozen=True)
class SensitivityConfig:
    """How many images train and test, and what is disturbed.

    Parameters
    ----------
    n_images : int
        Images that train.
    n_test : int
        Poses at which images are taken anew with everything disturbed in turn.
    image_size : int
        Height and width, [px].
    seed : int
        Of poses, noise and disturbances.
    part : {"cylinder_head", "textured_plane"}
    features : tuple of str
        Names of `FEATURES`; each has a model of its own, given the same images.
    disturbances : tuple of str
        Names of `DISTURBANCES`.
    regressor : str
        Of `REGRESSORS`; ``"levenberg_marquardt"`` for the paper's nets.

    Raises
    ------
    InvalidInputError
        If there are fewer than 50 images that train or 2 that test, no features or disturbances,
        or nothing is of such a name.

    Examples
    --------
    >>> SensitivityConfig(n_images=100, n_test=3).test_numbers
    range(100, 103)
    """

    n_images: int = 400
    n_test: int = 60
    image_size: int = 128
    seed: int = 0
    part: str = "cylinder_head"
    features: tuple[str, ...] = DEFAULT_FEATURES
    disturbances: tuple[str, ...] = tuple(DISTURBANCES)
    regressor: str = "gaussian_process"

    def __post_init__(self) -> None:
        for name, least in (("n_images", 50), ("n_test", 2)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InvalidInputError(
                    f"{name} must be a whole number from {least}, got {value!r}."
                )
        for name, known in (("features", FEATURES), ("disturbances", DISTURBANCES)):
            wanted = getattr(self, name)
            if not wanted or set(wanted) - set(known):
                raise InvalidInputError(
                    f"{name} must be taken from {', '.join(known)}, got {wanted}."
                )
        if self.regressor not in REGRESSORS:
            raise InvalidInputError(
                f"regressor must be one of {', '.join(REGRESSORS)}, got {self.regressor!r}."
            )
        self.acquisition()

    def acquisition(self) -> AcquisitionConfig:
        """The images that train, then those that test."""
        return AcquisitionConfig(
            n_images=self.n_images + self.n_test,
            image_size=self.image_size,
            seed=self.seed,
            part=self.part,
        )

    @property
    def test_numbers(self) -> range:
        """Which images of the acquisition test: the last."""
        return range(self.n_images, self.n_images + self.n_test)


class SensitivityRun:
    """Models of a simulated data set, and how their errors grow.

    Parameters
    ----------
    data : PoseImageSet
        As `acquire` takes it for ``config.acquisition()``.
    config : SensitivityConfig
    """

    def __init__(
        self,
        data: PoseImageSet,
        config: SensitivityConfig,
        *,
        n_jobs: int = -1,
        progress: ProgressBar = no_progress,
    ) -> None:
        self.data, self.config = data, config
        self.n_jobs, self.progress = n_jobs, progress

    @cached_property
    def models(self) -> dict[str, PoseModel]:
        """A regressor for each dof over each of the features; trained when first used."""
        train, names = slice(self.config.n_images), self.config.features
        regressor = self.config.regressor
        learned = (
            self.data.images[train],
            self.data.delta_p()[train],
            self.data.ranges(),
        )
        calls = [(*learned, replace(FEATURES[name], regressor=regressor)) for name in names]
        models = {}
        with self.progress("training", len(calls)) as advance:
            fitted = in_processes(fit_pose_model, calls, self.n_jobs)
            for n_done, (name, model) in enumerate(zip(names, fitted, strict=True), start=1):
                models[name] = model
                advance(n_done)
        return models

    def measure(self, name: str) -> dict[str, Any]:
        """How the errors grow with a disturbance of `DISTURBANCES`.

        Returns
        -------
        dict
            By features and dof, what `ErrorGrowth.to_dict` gives.
        """
        models, disturbance = self.models, DISTURBANCES[name]
        with self.progress(name, n_sets(disturbance)) as advance:
            growths = measure(
                disturbance,
                models,
                self.config.acquisition(),
                self.config.test_numbers,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )
        return {
            features: {dof: growth.to_dict() for dof, growth in by_dof.items()}
            for features, by_dof in growths.items()
        }

    def ranges(self) -> dict[str, dict[str, Any]]:
        """Half-width of each dof's displacements, ``{"value", "unit"}`` by dof."""
        values = (self.data.ranges() * DISPLAY_FACTORS).round(6).tolist()
        return {
            dof: {"value": value, "unit": unit}
            for dof, value, unit in zip(DOFS, values, DISPLAY_UNITS, strict=True)
        }
