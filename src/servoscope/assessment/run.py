"""The assessment of a data set: what each dof will reach, what limits it, and what would help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.candidates import (
    Candidate,
    choose_families,
    forecast_candidates,
    join_candidates,
    own_groups,
    refine_forecasts,
)
from servoscope.assessment.disturbed import disturbed_errors, noise_errors
from servoscope.assessment.families import FAMILIES, choose_tried, compute_families
from servoscope.assessment.image_facts import ImageFacts, describe_images
from servoscope.assessment.models import DofModel, join_models, train_models
from servoscope.assessment.outcome import Assessment
from servoscope.assessment.what_if import forecast_without_border
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import (
    IndependentGroups,
    independent_groups,
    moves_enough,
    split_groups,
)
from servoscope.data.splits import Split
from servoscope.poses import DOFS
from servoscope.progress import ProgressBar, no_progress
from servoscope.regression import REGRESSORS, RegressorScore, compare_regressors
from servoscope.selection import Forecast, LearningCurve, learning_curve

Array = NDArray[np.float64]

COMPARED = ("gaussian_process", "kernel_ridge", "levenberg_marquardt", "lbfgs")
"""The regressors that are quick enough on hundreds of features."""


def assess(
    data: PoseImageSet,
    *,
    families: Sequence[str] = tuple(FAMILIES),
    seed: int = 0,
    n_jobs: int | None = -1,
    progress: ProgressBar = no_progress,
) -> Assessment:
    """Assess a data set.

    Features of every family are forecast, trained on and tested; the rest looks closer at those
    that are forecast to tell each dof best. No features are chosen on the test images; but how well
    a dof is told, what disturbs it and what another regressor would do is measured on them.

    Parameters
    ----------
    data : PoseImageSet
    families : sequence of str
        The families of features to try, of `FAMILIES`; all of them by default.
    seed : int
        Seed of the split and of the disturbances.
    n_jobs : int, optional
        Processes, as joblib counts them; every number of them gives the same.
    progress : ProgressBar

    Raises
    ------
    InvalidInputError
        If a family is unknown, there are fewer than 60 images, or too few are left to learn from.
    """
    families = choose_tried(",".join(families))
    return _Course(data, tuple(families), seed, n_jobs, progress).run()


@dataclass(frozen=True, eq=False)
class _Course:
    """The steps of an assessment, and what they share."""

    data: PoseImageSet
    families: tuple[str, ...]
    seed: int
    n_jobs: int | None
    progress: ProgressBar

    @cached_property
    def independence(self) -> IndependentGroups:
        return independent_groups(self.data)

    @cached_property
    def split(self) -> Split:
        return split_groups(self.data, self.independence, self.seed)

    @cached_property
    def learn(self) -> NDArray[np.intp]:
        return self.split.learned

    @cached_property
    def groups(self) -> NDArray[np.intp] | None:
        return own_groups(self.independence.labels[self.learn])

    @cached_property
    def targets(self) -> Array:
        """Displacements in units of the range; exactly 0 for a dof that never moves."""
        moves = moves_enough(self.data)
        return np.where(moves, self.data.delta_p() / self.data.ranges(), 0.0)

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Whether each dof moves in the images that are learned from, shape (6,)."""
        return np.asarray(np.ptp(self.targets[self.learn], axis=0) > 1e-9)

    def run(self) -> Assessment:
        split = self.split
        images = describe_images(self.data)
        candidates = self._forecast(images)
        best = choose_families(candidates)
        choice = {dof: best[dof] for dof, told in zip(DOFS, self.moving, strict=True) if told}
        trained = self._train(candidates, choice)
        noise, disturbed = self._disturb(trained, choice, images.noise)
        return Assessment(
            self.data,
            split,
            self.independence,
            images,
            candidates,
            choice,
            self._refine(candidates, choice),
            trained,
            curves=self._learning_curves(candidates, choice),
            noise=noise,
            disturbed=disturbed,
            without_border=self._without_border(choice),
            at_random=self._at_random(candidates, choice),
            regressors=self._regressors(candidates, choice),
            regressors_on_moments=self._regressors_on_moments(candidates, choice),
        )

    def _forecast(self, images: ImageFacts) -> dict[str, Candidate]:
        is_hopeless = not (images.change and self.moving.any())
        names = ["moments"] if is_hopeless else list(self.families)
        with self.progress("features", len(names)) as advance:
            found = compute_families(
                self.data.images,
                self.targets,
                self.learn,
                names,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )
        features = join_candidates(found)
        with self.progress("forecasts", len(features)) as advance:
            return forecast_candidates(
                self.data.images,
                self.targets,
                self.learn,
                self.independence.labels,
                features,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _refine(
        self, candidates: dict[str, Candidate], choice: dict[str, str]
    ) -> dict[str, Forecast]:
        with self.progress("best forecasts", len(choice)) as advance:
            return refine_forecasts(
                self.data.images[self.learn],
                self.targets[self.learn],
                self.groups,
                {dof: candidates[name].features.of(self.learn) for dof, name in choice.items()},
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _train(
        self, candidates: dict[str, Candidate], choice: dict[str, str]
    ) -> dict[str, dict[str, DofModel]]:
        features = {name: candidate.features for name, candidate in candidates.items()}
        with self.progress("training", len(features) * len(choice)) as advance:
            return train_models(
                features,
                self.targets,
                self.split,
                choice,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _disturb(
        self, trained: dict[str, dict[str, DofModel]], choice: dict[str, str], noise: float
    ) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        images, targets = self.data.images[self.split.test], self.targets[self.split.test]
        with self.progress("disturbances", 2) as advance:
            models = join_models(
                trained, choice, self.data.images[self.learn], self.targets[self.learn]
            )
            changes = noise_errors(models, images, noise, self.seed)
            advance(1)
            errors = disturbed_errors(models, images, targets, self.seed)
            advance(2)
        return changes, errors

    def _learning_curves(
        self, candidates: dict[str, Candidate], choice: dict[str, str]
    ) -> dict[str, LearningCurve]:
        curves = {}
        with self.progress("learning curves", len(choice)) as advance:
            for n_done, (dof, name) in enumerate(choice.items(), start=1):
                curves[dof] = learning_curve(
                    candidates[name].features.values[self.learn],
                    self.targets[self.learn, DOFS.index(dof)],
                    groups=self.groups,
                    n_jobs=self.n_jobs,
                )
                advance(n_done)
        return curves

    def _without_border(self, choice: dict[str, str]) -> dict[str, Array | None]:
        with self.progress("narrower view", 1) as advance:
            found = forecast_without_border(
                self.data.images[self.learn],
                self.targets[self.learn],
                self.groups,
                choice.values(),
                n_jobs=self.n_jobs,
            )
            advance(1)
        return found

    def _at_random(
        self, candidates: dict[str, Candidate], choice: dict[str, str]
    ) -> dict[str, float] | None:
        """What a forecast promises that does not know that images are dependent."""
        if self.groups is None:
            return None
        promised = forecast_candidates(
            self.data.images,
            self.targets,
            self.learn,
            np.arange(len(self.data)),
            {name: candidates[name].features for name in sorted(set(choice.values()))},
            n_jobs=self.n_jobs,
        )
        return {
            dof: float(promised[name].forecast.rms[DOFS.index(dof)]) for dof, name in choice.items()
        }

    def _regressors(
        self, candidates: dict[str, Candidate], choice: dict[str, str]
    ) -> list[RegressorScore]:
        """Other regressors on the chosen features."""
        names = sorted(set(choice.values()))
        if not names:
            return []
        ends = np.cumsum([0, *(len(candidates[name].features.names) for name in names)])
        columns = {dof: np.arange(*ends[names.index(n) :][:2]) for dof, n in choice.items()}
        with self.progress("regressors", len(COMPARED) * len(choice)) as advance:
            return compare_regressors(
                np.hstack([candidates[name].features.values for name in names]),
                self.targets[:, [DOFS.index(dof) for dof in choice]],
                self.split,
                COMPARED,
                columns=columns,
                dofs=tuple(choice),
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _regressors_on_moments(
        self, candidates: dict[str, Candidate], choice: dict[str, str]
    ) -> list[RegressorScore]:
        """Every regressor on the paper's moments."""
        if not choice or "moments" not in candidates:
            return []
        with self.progress("regressors on moments", len(REGRESSORS) * len(choice)) as advance:
            return compare_regressors(
                candidates["moments"].features.values,
                self.targets[:, [DOFS.index(dof) for dof in choice]],
                self.split,
                dofs=tuple(choice),
                n_jobs=self.n_jobs,
                on_progress=advance,
            )
