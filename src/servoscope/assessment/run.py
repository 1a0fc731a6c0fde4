"""The assessment of a data set: what each dof will reach, what limits it, and what would help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.disturbed import N_CONDITIONS, disturb
from servoscope.assessment.image_facts import ImageFacts, describe_images
from servoscope.assessment.outcome import Assessment
from servoscope.assessment.rendered import Sample, sample_images
from servoscope.assessment.view import Begun, ViewFindings, begin_view, finish_view
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import Split
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.features.catalogue import default_families, resolve_families
from servoscope.kernels import find_repeats
from servoscope.pipeline import (
    Candidate,
    FeatureTable,
    Fitted,
    PosePipeline,
    Recipe,
    choose,
    fit_all,
    forecast_all,
    shortlist,
)
from servoscope.pipeline.feature_table import N_FOLDS
from servoscope.pipeline.forecasts import QUICK, THOROUGH
from servoscope.poses import DOFS
from servoscope.processes import in_processes, one_blas_thread
from servoscope.progress import ProgressBar, no_progress
from servoscope.regression import REGRESSORS
from servoscope.regression.registry import make_regressor
from servoscope.selection import Forecast, LearningCurve, learning_curve

Array = NDArray[np.float64]

COMPARED = ("gaussian_process", "kernel_ridge", "levenberg_marquardt", "lbfgs")
"""The regressors that are quick enough on hundreds of features."""

MIXES = (
    "moments+eigenfeatures+pose_covariance",
    "moments+projections+log_polar+gradient+intensity",
)
"""Families that are tried together: the paper's, and those that need no fitting."""

KEPT = 0.8
"""Share of each side of the view that is kept when its border is cut away."""

Choice = dict[str, str]
"""The candidate that is chosen for each dof that moves."""


def assess(
    data: PoseImageSet,
    *,
    families: Sequence[Any] | None = None,
    regressor: Any = "gaussian_process",
    seed: int = 0,
    compare: bool = False,
    n_jobs: int | None = -1,
    progress: ProgressBar = no_progress,
) -> Assessment:
    """Assess a data set.

    What every family of features will reach is forecast; the best for each degree of freedom are
    trained on and tested. No features are chosen on the test images.

    Parameters
    ----------
    data : PoseImageSet
    families : sequence of str or transformer, optional
        The families of features to try: names of `servoscope.features.catalogue`, or objects with
        ``fit(images, displacements)`` and ``transform(images)``. All the default ones by default.
    regressor : str or estimator
        What is trained on the chosen features: a name in `servoscope.regression.REGRESSORS`.
    seed : int
        Seed of the split and of the disturbances.
    compare : bool
        Whether other regressors are trained too.
    n_jobs : int, optional
        Processes, as joblib counts them; every number of them gives the same.
    progress : ProgressBar

    Raises
    ------
    InvalidInputError
        If a family is unknown, there are too few images, see `sample_images`.
    """
    tried = default_families() if families is None else list(families)
    resolve_families(tried)
    make_regressor(regressor)
    sample = sample_images(data, seed, n_jobs=n_jobs, progress=progress)
    return _Course(sample, tuple(tried), regressor, seed, compare, n_jobs, progress).run()


@dataclass(frozen=True, eq=False)
class _Course:
    """The steps of an assessment, and what they share."""

    sample: Sample
    families: tuple[Any, ...]
    regressor: Any
    seed: int
    compare: bool
    n_jobs: int | None
    progress: ProgressBar

    @property
    def data(self) -> PoseImageSet:
        return self.sample.data

    @property
    def split(self) -> Split:
        return self.sample.split

    @cached_property
    def groups(self) -> NDArray[np.intp] | None:
        """Images that belong together; None where each of those learned from is by itself."""
        labels = self.sample.independence.labels
        own = labels[self.split.learned]
        return None if len(np.unique(own)) == len(own) else labels

    @cached_property
    def targets(self) -> Array:
        """Displacements in units of the range; exactly 0 for a dof that never moves."""
        moves = mask_of(self.data.dofs)
        return np.where(moves, self.data.delta_p() / self.data.ranges(), 0.0)

    @cached_property
    def moving(self) -> list[str]:
        """The dofs that move in the images that are learned from."""
        moved = np.ptp(self.targets[self.split.learned], axis=0) > 1e-9
        return [dof for dof, moves in zip(DOFS, moved, strict=True) if moves]

    @cached_property
    def images(self) -> ImageFacts:
        """What the real images are like."""
        return describe_images(self.sample.real)

    @cached_property
    def is_hopeless(self) -> bool:
        """Whether nothing can be learned, whatever the features."""
        return not (self.images.change and self.moving)

    @cached_property
    def table(self) -> FeatureTable:
        """The features of all families that are tried."""
        tried = ("moments",) if self.is_hopeless else self.families
        return self._table(tried, self.data.images, self.targets, self.groups, "features")

    @cached_property
    def poses(self) -> NDArray[np.intp]:
        """Images learned from of equal value are repeated shots of one pose."""
        learn, poses = self.split.learned, np.full(len(self.data), -1)
        with one_blas_thread():
            poses[learn] = find_repeats(self.table.values[learn], self.targets[learn])
        return poses

    def run(self) -> Assessment:
        begun = None if self.is_hopeless else self._begin_view()  # beside all that follows
        candidates = self._forecast()
        choice, forecasts = self._choose(candidates)
        recipes = {dof: candidates[name].recipe for dof, name in choice.items()}
        fitted = self._train([(recipe, dof) for dof, recipe in recipes.items()], "training")
        pipeline = self._pipeline(fitted, forecasts)
        noise, disturbed = self._disturb(pipeline)
        curves = self._learning_curves(recipes)
        return Assessment(
            self.sample,
            self.images,
            candidates,
            choice,
            forecasts,
            dict(zip(recipes, fitted, strict=True)),
            pipeline,
            {dof: one.best_features(self.table) for dof, one in zip(recipes, fitted, strict=True)},
            curves=curves,
            noise=noise,
            disturbed=disturbed,
            without_border=self._without_border(recipes),
            at_random=self._at_random(recipes),
            view=None if begun is None else self._finish_view(begun),
            regressors=self._regressors(recipes, COMPARED),
            regressors_on_moments=self._regressors(
                dict.fromkeys(recipes, Recipe("moments")), tuple(REGRESSORS.built_in)
            ),
        )

    def _table(
        self,
        families: Sequence[Any],
        images: NDArray[np.uint8],
        targets: Array,
        groups: NDArray[np.intp] | None,
        title: str,
    ) -> FeatureTable:
        learn = self.split.learned if len(images) == len(self.data) else np.arange(len(images))
        with self.progress(title, FeatureTable.n_steps(families, N_FOLDS)) as advance:
            return FeatureTable.fit(
                images,
                targets,
                families,
                learn,
                groups=groups,
                n_folds=N_FOLDS,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _forecast(self) -> dict[str, Candidate]:
        table = self.table
        names = [*table.fitted, *(mix for mix in MIXES if table.has(mix))]
        jobs = [(Recipe(name), dof) for name in names for dof in self.moving]
        found = iter(self._forecast_all(table, self.groups, jobs, "forecasts", QUICK))
        return {
            name: Candidate(
                self._recipe(name),
                len(table.columns(Recipe(name))),
                {dof: next(found) for dof in self.moving},
            )
            for name in names
        }

    def _recipe(self, features: str) -> Recipe:
        settings = {"kernel_steps": 30} if self.regressor == "gaussian_process" else {}
        return Recipe(features, regressor=self.regressor, settings=settings)

    def _choose(self, candidates: dict[str, Candidate]) -> tuple[Choice, dict[str, Forecast]]:
        """The candidate of each dof, of those that may be best, and its thorough forecast."""
        names = shortlist(candidates)
        jobs = [(candidates[name].recipe, dof) for name, dof in names]
        found = self._forecast_all(self.table, self.groups, jobs, "best forecasts", THOROUGH)
        thorough: dict[str, dict[str, Forecast]] = {}
        for (name, dof), one in zip(names, found, strict=True):
            thorough.setdefault(name, {})[dof] = one
        choice = choose(
            {name: replace(candidates[name], forecasts=by) for name, by in thorough.items()}
        )
        return choice, {
            dof: self.sample.on_real_images(thorough[name][dof]) for dof, name in choice.items()
        }

    def _forecast_all(
        self,
        table: FeatureTable,
        groups: NDArray[np.intp] | None,
        jobs: list[tuple[Recipe, str]],
        title: str,
        effort: dict[str, int],
    ) -> list[Forecast]:
        images = slice(None) if len(table.values) == len(self.data) else self.split.learned
        with self.progress(title, len(jobs)) as advance:
            return forecast_all(
                table,
                self.targets[images],
                groups,
                jobs,
                poses=self.poses[images],
                effort=effort,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _train(self, jobs: list[tuple[Recipe, str]], title: str) -> list[Fitted]:
        with self.progress(title, len(jobs)) as advance:
            return fit_all(
                self.table,
                self.targets,
                self.split,
                jobs,
                seed=self.seed,
                poses=self.poses,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _begin_view(self) -> Begun:
        return begin_view(
            self.sample.real,
            self.sample.real_split.learned,
            self.split.test,
            view=self.sample.view,
            seed=self.seed,
            n_jobs=self.n_jobs,
        )

    def _finish_view(self, begun: Begun) -> ViewFindings | None:
        return finish_view(
            begun, self.sample.real, self.groups, n_jobs=self.n_jobs, progress=self.progress
        )

    def _pipeline(
        self, fitted: list[Fitted], forecasts: dict[str, Forecast]
    ) -> PosePipeline | None:
        """The pipeline of the choice, which remembers what was forecast for it and measured."""
        if not fitted:
            return None
        ranges = self.data.ranges()[[DOFS.index(one.dof) for one in fitted]]
        sample = self.data.images[self.split.learned[0]]
        rms = {
            dof: float(one.rms[0] * scale)
            for (dof, one), scale in zip(forecasts.items(), ranges, strict=True)
        }
        return PosePipeline.from_fitted(
            self.table,
            fitted,
            ranges,
            self.sample.real_split,
            sample,
            forecast=rms,
            pivot=float(self.data.pivot),
        )

    def _disturb(
        self, pipeline: PosePipeline | None
    ) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        if pipeline is None:
            return {}, {}
        images, targets = self.data.images[self.split.test], self.targets[self.split.test]
        with self.progress("disturbances", N_CONDITIONS) as advance:
            return disturb(
                pipeline,
                images,
                targets,
                self.images.noise,
                seed=self.seed,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def _learning_curves(self, recipes: dict[str, Recipe]) -> dict[str, LearningCurve]:
        learn, curves = self.split.learned, []
        groups = None if self.groups is None else self.groups[learn]
        calls = [
            (
                self.table.values[np.ix_(learn, self.table.columns(recipe))],
                self.targets[learn, DOFS.index(dof)],
                groups,
                self.poses[learn],
            )
            for dof, recipe in recipes.items()
        ]
        with self.progress("learning curves", len(calls)) as advance:
            for curve in in_processes(_learning_curve, calls, self.n_jobs, batch_size=1):
                curves.append(curve)
                advance(len(curves))
        return dict(zip(recipes, curves, strict=True))

    def _without_border(self, recipes: dict[str, Recipe]) -> dict[str, float | None]:
        """Forecasts from the middle of the view; None where a family cannot be had of it."""
        families = self._families_of(recipes)
        if not families:
            return {}
        learn = self.split.learned
        middle = np.ascontiguousarray(crop_centre(self.data.images[learn]))
        groups = None if self.groups is None else self.groups[learn]
        try:
            table = self._table(families, middle, self.targets[learn], groups, "narrower view")
        except InvalidInputError:
            return dict.fromkeys(recipes)
        jobs = [(recipe, dof) for dof, recipe in recipes.items() if table.has(recipe.name)]
        found = self._forecast_all(table, groups, jobs, "its forecasts", QUICK)
        rms = {dof: float(one.rms[0]) for (_, dof), one in zip(jobs, found, strict=True)}
        return {dof: rms.get(dof) for dof in recipes}

    def _at_random(self, recipes: dict[str, Recipe]) -> dict[str, float] | None:
        """What a forecast promises that does not know that images are dependent."""
        if self.groups is None:
            return None
        table = self.table
        if table.folds:
            families = self._families_of(recipes)
            images = self.data.images
            table = self._table(families, images, self.targets, None, "features at random")
        jobs = [(recipe, dof) for dof, recipe in recipes.items()]
        found = self._forecast_all(table, None, jobs, "forecasts at random", QUICK)
        return {dof: float(one.rms[0]) for dof, one in zip(recipes, found, strict=True)}

    def _families_of(self, recipes: dict[str, Recipe]) -> list[Any]:
        """The families that recipes take, as they were given."""
        used = {name for recipe in recipes.values() for name in recipe.family_names}
        known = {Recipe(family).name: family for family in self.families}
        return [known.get(name, name) for name in sorted(used)]

    def _regressors(self, recipes: dict[str, Recipe], names: Sequence[str]) -> list[Fitted]:
        """Regressors side by side on the same features; none unless they are to be compared."""
        if not self.compare or not all(self.table.has(recipe.name) for recipe in recipes.values()):
            return []
        jobs = [
            (replace(recipe, regressor=name, settings={}), dof)
            for name in names
            for dof, recipe in recipes.items()
        ]
        return self._train(jobs, "regressors")


def _learning_curve(X: Array, y: Array, groups: Array | None, poses: Array) -> LearningCurve:
    with one_blas_thread():
        return learning_curve(X, y, groups=groups, poses=poses, n_draws=2, **QUICK)


def crop_centre(images: NDArray[np.uint8], share: float = KEPT) -> NDArray[np.uint8]:
    """The middle of images, `share` of each side.

    Examples
    --------
    >>> crop_centre(np.zeros((2, 100, 50), np.uint8)).shape
    (2, 80, 40)
    """
    rows, columns = images.shape[1:]
    top, left = round((1 - share) / 2 * rows), round((1 - share) / 2 * columns)
    return images[:, top : rows - top, left : columns - left]
