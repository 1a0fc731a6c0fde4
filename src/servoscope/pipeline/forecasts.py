"""What recipes are forecast to reach before anything is trained, and which are chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.pipeline.feature_table import FeatureTable
from servoscope.pipeline.recipe import Recipe
from servoscope.poses import DOFS
from servoscope.processes import in_processes
from servoscope.selection import Forecast, forecast_errors, forecast_from_folds
from servoscope.selection.forecast import Fold
from servoscope.selection.rms_interval import root_mean_square

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

HARDLY_BEHIND = 1.1
"""A forecast up to this many times the least is as good for fewer features."""

QUICK: dict[str, Any] = {"max_samples": 160, "max_iter": 15}
"""How many samples choose a kernel and for how long: enough to compare recipes."""

THOROUGH: dict[str, Any] = {"max_samples": 360, "max_iter": 30}
"""The same for the forecast of a recipe that may be chosen."""

NEARLY_BEST = 1.2
"""A quick forecast is this many times off at most."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A recipe that might be chosen, and what it is forecast to reach.

    Parameters
    ----------
    recipe : Recipe
    n_features : int
    forecasts : dict of Forecast
        By degree of freedom, each of one target.
    """

    recipe: Recipe
    n_features: int
    forecasts: Mapping[str, Forecast]


def forecast(
    table: FeatureTable,
    targets: Array,
    groups: Indices | None,
    recipe: Recipe,
    *,
    poses: Indices | None = None,
    n_jobs: int | None = 1,
    max_samples: int = QUICK["max_samples"],
    max_iter: int = QUICK["max_iter"],
) -> Forecast:
    """The errors that a Gaussian process on a recipe's features will reach on new images.

    For features that need no fitting the forecast is in closed form; those that are fitted to
    images are taken from the folds of the table.

    Parameters
    ----------
    table : FeatureTable
    targets : ndarray of shape (n_images, n_targets)
        In any unit.
    groups : ndarray of shape (n_images,), optional
        Images that belong together, and are left out together.
    recipe : Recipe
        With any regressor.
    poses : ndarray of shape (n_images,), optional
        Images of equal value are repeated shots of one pose; they are found by default.
    n_jobs, max_samples, max_iter
        As of `servoscope.selection.forecast_errors`.

    Raises
    ------
    InvalidInputError
        If the features are fitted to images and the table has no folds.
    """
    effort = {"max_samples": max_samples, "max_iter": max_iter}
    parts = _parts(table, targets, groups, poses, recipe)
    return _forecast(*parts, effort=effort, n_jobs=n_jobs)


def forecast_all(
    table: FeatureTable,
    targets: Array,
    groups: Indices | None,
    jobs: Sequence[tuple[Recipe, str]],
    *,
    dofs: Sequence[str] = DOFS,
    poses: Indices | None = None,
    effort: Mapping[str, int] = QUICK,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> list[Forecast]:
    """The forecast of every recipe for a degree of freedom; see `forecast`.

    Returns
    -------
    list of Forecast
        In the order of the jobs, each of one target.
    """
    poses = table.poses(targets) if poses is None else poses
    calls = []
    for number, (recipe, dof) in enumerate(jobs):
        own = targets[:, [list(dofs).index(dof)]]
        calls.append((number, _parts(table, own, groups, poses, recipe), effort))
    calls.sort(key=lambda call: -len(call[1][2]))  # those that take longest first
    found: dict[int, Forecast] = {}
    for number, one in in_processes(_forecast_one, calls, n_jobs, batch_size=1):
        found[number] = one
        if on_progress is not None:
            on_progress(len(found))
    return [found[number] for number in range(len(jobs))]


def find_candidates(
    table: FeatureTable,
    targets: Array,
    groups: Indices | None,
    recipes: Sequence[Recipe],
    moving: Sequence[str],
    **options: Any,
) -> dict[str, Candidate]:
    """Recipes by name, each with a quick forecast of some degrees of freedom.

    Parameters
    ----------
    table, targets, groups
        As of `forecast`.
    recipes : sequence of Recipe
        Those whose features the table does not have are left out.
    moving : sequence of str
        The degrees of freedom.
    **options
        Of `forecast_all`.
    """
    known = [recipe for recipe in recipes if table.has(recipe.name)]
    jobs = [(recipe, dof) for recipe in known for dof in moving]
    found = iter(forecast_all(table, targets, groups, jobs, **options))
    return {
        recipe.name: Candidate(
            recipe, len(table.columns(recipe)), {dof: next(found) for dof in moving}
        )
        for recipe in known
    }


def shortlist(candidates: Mapping[str, Candidate], n_best: int = 2) -> list[tuple[str, str]]:
    """The candidates that may be the best of a dof, by their quick forecasts, with that dof."""
    found = []
    for dof in _dofs_of(candidates):
        rms = {name: float(one.forecasts[dof].rms[0]) for name, one in candidates.items()}
        best = sorted(rms, key=lambda name: rms[name])[:n_best]
        found += [(name, dof) for name in best if rms[name] <= NEARLY_BEST * rms[best[0]]]
    return found


def choose(candidates: Mapping[str, Candidate], among: Indices | None = None) -> dict[str, str]:
    """For every dof the candidate of fewest features that is hardly behind the best forecast.

    Parameters
    ----------
    candidates : dict of Candidate
        Those that have a forecast of a dof may be chosen for it.
    among : ndarray, optional
        Of the images learned from, those whose residuals count; all by default.

    Returns
    -------
    dict of str
        Name of a candidate by dof.
    """
    chosen = {}
    counted = slice(None) if among is None else among
    for dof in _dofs_of(candidates):
        rms = {
            name: float(root_mean_square(one.forecasts[dof].residuals[counted])[0])
            for name, one in candidates.items()
            if dof in one.forecasts
        }
        limit = HARDLY_BEHIND * min(rms.values())
        good = [name for name, error in rms.items() if error <= limit]
        chosen[dof] = min(good, key=lambda name: candidates[name].n_features)
    return chosen


def _dofs_of(candidates: Mapping[str, Candidate]) -> list[str]:
    """The dofs of which there are forecasts, in `DOFS` order where they have one."""
    dofs = dict.fromkeys(dof for one in candidates.values() for dof in one.forecasts)
    return sorted(dofs, key=lambda dof: DOFS.index(dof) if dof in DOFS else len(DOFS))


def _forecast_one(
    number: int, parts: tuple[Any, ...], effort: Mapping[str, int]
) -> tuple[int, Forecast]:
    return number, _forecast(*parts, effort=effort, n_jobs=1)


def _parts(
    table: FeatureTable,
    targets: Array,
    groups: Indices | None,
    poses: Indices | None,
    recipe: Recipe,
) -> tuple[Any, ...]:
    learn, columns = table.learn, table.columns(recipe)
    is_learned = table.is_learned(recipe)
    if is_learned and not table.folds:
        raise InvalidInputError(
            f"The features {recipe.name} are fitted to images: their forecast needs a feature "
            "table with folds."
        )
    folds = table.folds if is_learned else ()
    own = {
        "groups": None if groups is None else groups[learn],
        "poses": None if poses is None else poses[learn],
    }
    return table.values, learn, columns, folds, targets[learn], own


def _forecast(
    values: Array,
    learn: Indices,
    columns: Indices,
    folds: Sequence[Fold],
    targets: Array,
    own: Mapping[str, Indices | None],
    *,
    effort: Mapping[str, int],
    n_jobs: int | None,
) -> Forecast:
    options: dict[str, Any] = {**own, "n_jobs": n_jobs, **effort}
    if folds:
        return forecast_from_folds(folds, targets, columns=columns, **options)
    return forecast_errors(values[np.ix_(learn, columns)], targets, **options)
