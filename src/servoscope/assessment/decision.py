"""Which features are chosen for each dof, what they are forecast to reach, and what they reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.rendered import Sample, other_samples
from servoscope.dofs import mask_of
from servoscope.pipeline import (
    Candidate,
    FeatureTable,
    Fitted,
    Recipe,
    choose,
    find_candidates,
    fit_all,
    forecast_all,
    shortlist,
)
from servoscope.pipeline.feature_table import N_FOLDS
from servoscope.pipeline.forecasts import THOROUGH
from servoscope.poses import DOFS
from servoscope.processes import ProgressBar, no_progress
from servoscope.selection import Forecast
from servoscope.selection.forecast import TEST_ERROR
from servoscope.selection.rms_interval import rms_ratio_interval

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MIXES = (
    "moments+eigenfeatures+pose_covariance",
    "moments+projections+log_polar+gradient+intensity",
)
"""Families that are tried together: the paper's, and those that need no fitting."""

Choice = dict[str, str]
"""The candidate that is chosen for each dof that moves."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Errors of test images, pooled over splits that test other images each.

    Parameters
    ----------
    errors : dict of ndarray
        Prediction less target by dof, in units of the range, of every image that was tested.
    images : ndarray of shape (n_tested,)
        Which these are.
    groups : ndarray of shape (n_tested,)
        Their independent groups.
    n_splits : int
    n_learned : int
        Images that the first of the splits learned from.
    """

    errors: dict[str, Array]
    images: Indices
    groups: Indices
    n_splits: int
    n_learned: int

    def rms(self, dof: str) -> float:
        """RMS error of a dof, in units of the range."""
        return float(np.sqrt(np.mean(self.errors[dof] ** 2)))

    def interval(self, dof: str) -> tuple[float, float]:
        """90 % interval of the RMS error that infinitely many test images would show."""
        errors, other = self.errors[dof][:, None], TEST_ERROR * self.n_learned**-0.5
        low, high = rms_ratio_interval(errors, self.groups, np.inf, other_error=other)[:, 0]
        return float(low) * self.rms(dof), float(high) * self.rms(dof)


@dataclass(frozen=True, eq=False)
class Decision:
    """What is chosen of some families on the images that are learned from, and what it reaches.

    Parameters
    ----------
    sample : Sample
        No image that tests has a part in the choice.
    families : tuple of str or transformer
    regressor : str or estimator
    seed : int
        Draws what is random in regressors.
    n_jobs : int, optional
        Processes, as joblib counts them; every number of them gives the same.
    progress : ProgressBar
    known : FeatureTable, optional
        Features of the same images, fitted to others.
    n_folds : int
        Of the table; there must be some where learned features are forecast.
    """

    sample: Sample
    families: tuple[Any, ...]
    regressor: Any = "gaussian_process"
    seed: int = 0
    n_jobs: int | None = -1
    progress: ProgressBar = no_progress
    known: FeatureTable | None = None
    n_folds: int = N_FOLDS

    @cached_property
    def groups(self) -> Indices | None:
        """Images that belong together; None where each of those learned from is by itself."""
        return self.sample.independence.dependent(self.sample.split.learned)

    @cached_property
    def targets(self) -> Array:
        """Displacements in units of the range; exactly 0 for a dof that never moves."""
        data = self.sample.data
        return np.where(mask_of(data.dofs), data.delta_p() / data.ranges(), 0.0)

    @cached_property
    def moving(self) -> list[str]:
        """The dofs that move in the images that are learned from."""
        moved = np.ptp(self.targets[self.sample.split.learned], axis=0) > 1e-9
        return [dof for dof, moves in zip(DOFS, moved, strict=True) if moves]

    @cached_property
    def table(self) -> FeatureTable:
        """The features of all families that are tried."""
        with self.progress(
            "features", FeatureTable.n_steps(self.families, self.n_folds)
        ) as advance:
            return FeatureTable.fit(
                self.sample.data.images,
                self.targets,
                self.families,
                self.sample.split.learned,
                groups=self.groups,
                n_folds=self.n_folds,
                known=self.known,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    @cached_property
    def poses(self) -> Indices:
        """Images learned from of equal value are repeated shots of one pose."""
        return self.table.poses(self.targets)

    @cached_property
    def candidates(self) -> dict[str, Candidate]:
        """All that is tried, with quick forecasts."""
        table = self.table
        settings = {"kernel_steps": 30} if self.regressor == "gaussian_process" else {}
        recipes = [
            Recipe(name, regressor=self.regressor, settings=settings)
            for name in (*table.fitted, *MIXES)
        ]
        n_known = sum(table.has(recipe.name) for recipe in recipes)
        with self.progress("forecasts", n_known * len(self.moving)) as advance:
            return find_candidates(
                table,
                self.targets,
                self.groups,
                recipes,
                self.moving,
                poses=self.poses,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    @cached_property
    def _thorough(self) -> dict[str, Candidate]:
        """The candidates that may be the best of a dof, with thorough forecasts."""
        names = shortlist(self.candidates)
        jobs = [(self.candidates[name].recipe, dof) for name, dof in names]
        with self.progress("best forecasts", len(jobs)) as advance:
            found = forecast_all(
                self.table,
                self.targets,
                self.groups,
                jobs,
                poses=self.poses,
                effort=THOROUGH,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )
        forecasts: dict[str, dict[str, Forecast]] = {}
        for (name, dof), one in zip(names, found, strict=True):
            forecasts.setdefault(name, {})[dof] = one
        return {
            name: replace(self.candidates[name], forecasts=of) for name, of in forecasts.items()
        }

    @cached_property
    def choice(self) -> Choice:
        """The candidate of each dof."""
        return choose(self._thorough)

    @cached_property
    def forecasts(self) -> dict[str, Forecast]:
        """Of the choice, for real images."""
        return {
            dof: self.sample.on_real_images(self._thorough[name].forecasts[dof])
            for dof, name in self.choice.items()
        }

    @cached_property
    def recipes(self) -> dict[str, Recipe]:
        """Of the choice, by dof."""
        return {dof: self.candidates[name].recipe for dof, name in self.choice.items()}

    @cached_property
    def fitted(self) -> dict[str, Fitted]:
        """The choice, trained; its errors are of the test images of this split."""
        fitted = self.train([(recipe, dof) for dof, recipe in self.recipes.items()], "training")
        return {one.dof: one for one in fitted}

    def train(self, jobs: Sequence[tuple[Recipe, str]], title: str) -> list[Fitted]:
        """Recipes of dofs, trained on the images that are learned from."""
        with self.progress(title, len(jobs)) as advance:
            return fit_all(
                self.table,
                self.targets,
                self.sample.split,
                jobs,
                seed=self.seed,
                poses=self.poses,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )

    def measure(self) -> Measured:
        """Errors of the test images, pooled over further splits where they are of few groups.

        In each split the features are chosen anew, by how well the quick forecast predicts the
        images that it does not test on, and are trained without those. The forecasts that are
        compared are shared: an image that is tested helps there to predict others.
        """
        learned = self.sample.split.learned
        tested, errors = [self.sample.split.test], [{d: o.errors for d, o in self.fitted.items()}]
        others = other_samples(self.sample, self.seed, n_jobs=self.n_jobs, progress=self.progress)
        for sample in others if self.choice else ():
            among = np.flatnonzero(~np.isin(learned, sample.split.test))
            choice = choose(self.candidates, among)
            tested.append(sample.split.test)
            errors.append(self._errors_in(sample, choice))
        images = np.concatenate(tested)
        return Measured(
            {dof: np.concatenate([one[dof] for one in errors]) for dof in self.choice},
            images,
            self.sample.independence.labels[images],
            len(tested),
            len(learned),
        )

    def interval_of(self, forecast: Forecast, measured: Measured) -> tuple[float, float]:
        """90 % interval of a forecast of this table for what is measured, in units of the range."""
        labels, learned = self.sample.independence.labels, self.sample.split.learned
        tested, share = measured.images, 1.0
        if not self.sample.n_rendered:
            is_new = ~np.isin(tested, learned)
            tested, share = tested[is_new], float(is_new.mean())
        low, high = forecast.interval_of_test(labels[learned], labels[tested], share_new=share)
        return float(low[0]), float(high[0])

    def families_of(self, choice: Choice) -> tuple[Any, ...]:
        """The families that are chosen, as they were given."""
        used = {family for name in choice.values() for family in name.split("+")}
        given = {Recipe(family).name: family for family in self.families}
        return tuple(given.get(name, name) for name in sorted(used))

    def _errors_in(self, sample: Sample, choice: Choice) -> dict[str, Array]:
        """Errors of the test images of another split; a dof that never moved there has its mean."""
        known = self.table if sample.data is self.sample.data else None
        other = replace(
            self, sample=sample, families=self.families_of(choice), known=known, n_folds=0
        )
        jobs = [
            (self.candidates[name].recipe, dof)
            for dof, name in choice.items()
            if dof in other.moving and other.table.has(name)
        ]
        errors = {one.dof: one.errors for one in other.train(jobs, "another split")}
        learned, test = sample.split.learned, sample.split.test
        for dof in set(choice) - set(errors):
            y = other.targets[:, DOFS.index(dof)]
            errors[dof] = y[learned].mean() - y[test]
        return errors
