"""The sensitivity analysis of a simulated data set: models, and each disturbance in turn."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

from servoscope.data.images import PoseImageSet
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.processes import in_processes
from servoscope.progress import ProgressBar, no_progress
from servoscope.sensitivity.config import FEATURES, SensitivityConfig
from servoscope.sensitivity.disturbances import DISTURBANCES
from servoscope.sensitivity.measurement import measure, n_sets
from servoscope.sensitivity.pose_model import PoseModel, fit_pose_model


class SensitivityRun:
    """Models of a simulated data set, and how their errors grow.

    Parameters
    ----------
    data : PoseImageSet
        As `acquire` takes it for ``config.acquisition()``.
    config : SensitivityConfig
    n_jobs : int
        Processes, as joblib counts them; all cores by default. Every number of them gives the
        same errors.
    progress : ProgressBar
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
