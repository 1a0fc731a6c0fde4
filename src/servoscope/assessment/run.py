"""The assessment of a data set: what each dof will reach, what limits it, and what would help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.decision import Decision
from servoscope.assessment.disturbed import N_CONDITIONS, disturb
from servoscope.assessment.image_facts import describe_images
from servoscope.assessment.outcome import Assessment
from servoscope.assessment.rendered import sample_images
from servoscope.assessment.view import begin_view, finish_view
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import MOST_IMAGES
from servoscope.errors import InvalidInputError
from servoscope.features.catalogue import default_families, resolve_families
from servoscope.pipeline import (
    FeatureTable,
    Fitted,
    PosePipeline,
    Recipe,
    forecast_all,
)
from servoscope.pipeline.feature_table import N_FOLDS
from servoscope.pipeline.forecasts import QUICK
from servoscope.poses import DOFS
from servoscope.processes import ProgressBar, in_processes, no_progress, one_blas_thread
from servoscope.regression import REGRESSORS
from servoscope.regression.registry import make_regressor
from servoscope.selection import Forecast, LearningCurve, learning_curve

Array = NDArray[np.float64]

COMPARED = ("gaussian_process", "kernel_ridge", "levenberg_marquardt", "lbfgs")
"""The regressors that are quick enough on hundreds of features."""

KEPT = 0.8
"""Share of each side of the view that is kept when its border is cut away."""


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
        Of more than `MOST_IMAGES` so many are used, evenly spread in time.
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
    data = data.thinned(MOST_IMAGES)
    sample = sample_images(data, seed, n_jobs=n_jobs, progress=progress)
    return _assess(Decision(sample, tuple(tried), regressor, seed, n_jobs, progress), compare)


def _assess(decision: Decision, compare: bool) -> Assessment:
    sample, begun = decision.sample, None
    options: dict[str, Any] = {"n_jobs": decision.n_jobs, "progress": decision.progress}
    images = describe_images(sample.real)
    if images.change and decision.moving:
        begun = begin_view(  # beside all that follows
            sample.real,
            sample.real_split.learned,
            sample.split.test,
            view=sample.view,
            seed=decision.seed,
            n_jobs=decision.n_jobs,
        )
    else:  # nothing can be learned, whatever the features
        decision = replace(decision, families=("moments",))
    measured = decision.measure()
    pipeline = _pipeline(decision)
    noise, disturbed = _disturbed(decision, pipeline, images.noise)
    on_moments = dict.fromkeys(decision.choice, Recipe("moments"))
    return Assessment(
        decision,
        images,
        measured,
        pipeline,
        {dof: one.best_features(decision.table) for dof, one in decision.fitted.items()},
        curves=_learning_curves(decision),
        noise=noise,
        disturbed=disturbed,
        without_border=_without_border(decision),
        at_random=_at_random(decision),
        view=None if begun is None else finish_view(begun, sample.real, decision.groups, **options),
        regressors=_regressors(decision, decision.recipes, COMPARED) if compare else [],
        regressors_on_moments=_regressors(decision, on_moments, tuple(REGRESSORS.built_in))
        if compare
        else [],
    )


def _pipeline(decision: Decision) -> PosePipeline | None:
    """The pipeline of the choice, which remembers what was forecast for it and measured."""
    fitted, data = decision.fitted, decision.sample.data
    if not fitted:
        return None
    ranges = data.ranges()[[DOFS.index(dof) for dof in fitted]]
    return PosePipeline.from_fitted(
        decision.table,
        list(fitted.values()),
        ranges,
        decision.sample.real_split,
        data.images[decision.sample.split.learned[0]],
        forecast={
            dof: float(decision.forecasts[dof].rms[0] * scale)
            for dof, scale in zip(fitted, ranges, strict=True)
        },
        pivot=float(data.pivot),
    )


def _disturbed(
    decision: Decision, pipeline: PosePipeline | None, noise: float
) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    if pipeline is None:
        return {}, {}
    test = decision.sample.split.test
    with decision.progress("disturbances", N_CONDITIONS) as advance:
        return disturb(
            pipeline,
            decision.sample.data.images[test],
            decision.targets[test],
            noise,
            seed=decision.seed,
            n_jobs=decision.n_jobs,
            on_progress=advance,
        )


def _learning_curves(decision: Decision) -> dict[str, LearningCurve]:
    learn, curves = decision.sample.split.learned, []
    groups = None if decision.groups is None else decision.groups[learn]
    calls = [
        (
            decision.table.values[np.ix_(learn, decision.table.columns(recipe))],
            decision.targets[learn, DOFS.index(dof)],
            groups,
            decision.poses[learn],
            None
            if decision.table.is_learned(recipe)
            else decision.candidates[decision.choice[dof]].forecasts[dof],
        )
        for dof, recipe in decision.recipes.items()
    ]
    with decision.progress("learning curves", len(calls)) as advance:
        for curve in in_processes(_learning_curve, calls, decision.n_jobs, batch_size=1):
            curves.append(curve)
            advance(len(curves))
    return dict(zip(decision.recipes, curves, strict=True))


def _without_border(decision: Decision) -> dict[str, float | None]:
    """Forecasts from the middle of the view; None where a family cannot be had of it."""
    if not decision.choice:
        return {}
    learn = decision.sample.split.learned
    groups = None if decision.groups is None else decision.groups[learn]
    try:
        table = FeatureTable.fit(
            np.ascontiguousarray(crop_centre(decision.sample.data.images[learn])),
            decision.targets[learn],
            decision.families_of(decision.choice),
            groups=groups,
            n_folds=N_FOLDS,
            n_jobs=decision.n_jobs,
        )
    except InvalidInputError:
        return dict.fromkeys(decision.choice)
    rms = _quick_forecasts(
        decision, table, decision.targets[learn], groups, decision.poses[learn], "narrower view"
    )
    return {dof: rms.get(dof) for dof in decision.choice}


def _at_random(decision: Decision) -> dict[str, float] | None:
    """What a forecast promises that does not know that images are dependent."""
    if decision.groups is None:
        return None
    table = decision.table
    if table.folds:
        table = FeatureTable.fit(
            decision.sample.data.images,
            decision.targets,
            decision.families_of(decision.choice),
            decision.sample.split.learned,
            n_folds=N_FOLDS,
            known=table,
            n_jobs=decision.n_jobs,
        )
    return _quick_forecasts(
        decision, table, decision.targets, None, decision.poses, "forecasts at random"
    )


def _quick_forecasts(
    decision: Decision,
    table: FeatureTable,
    targets: Array,
    groups: NDArray[np.intp] | None,
    poses: NDArray[np.intp],
    title: str,
) -> dict[str, float]:
    """What the chosen recipes are forecast to reach from another table, by dof."""
    jobs = [(one, dof) for dof, one in decision.recipes.items() if table.has(one.name)]
    with decision.progress(title, len(jobs)) as advance:
        found = forecast_all(
            table,
            targets,
            groups,
            jobs,
            poses=poses,
            n_jobs=decision.n_jobs,
            on_progress=advance,
        )
    return {dof: float(one.rms[0]) for (_, dof), one in zip(jobs, found, strict=True)}


def _regressors(
    decision: Decision, recipes: dict[str, Recipe], names: Sequence[str]
) -> list[Fitted]:
    """Regressors side by side on the same features."""
    if not all(decision.table.has(recipe.name) for recipe in recipes.values()):
        return []
    jobs = [
        (replace(recipe, regressor=name, settings={}), dof)
        for name in names
        for dof, recipe in recipes.items()
    ]
    return decision.train(jobs, "regressors")


def _learning_curve(
    X: Array, y: Array, groups: Array | None, poses: Array, whole: Forecast | None
) -> LearningCurve:
    with one_blas_thread():
        return learning_curve(X, y, groups=groups, poses=poses, n_draws=2, whole=whole, **QUICK)


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
