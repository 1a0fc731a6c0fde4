"""What every family of features is forecast to reach, and which one tells each dof best."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.families import (
    MIXES,
    FamilyFeatures,
    FamilyTransformer,
    join_families,
)
from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS
from servoscope.processes import in_processes
from servoscope.selection import Forecast, crossfit_forecast, forecast_errors

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

HARDLY_BEHIND = 1.1
"""A forecast up to this many times the least is as good for fewer features."""

FULL_EFFORT = {"max_samples": 600, "max_iter": 60}
"""How many samples choose a kernel and for how long, as in training."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Features that might be used, and what they are forecast to reach.

    Parameters
    ----------
    features : FamilyFeatures
    forecast : Forecast
        Of errors in units of the range.
    """

    features: FamilyFeatures
    forecast: Forecast


def join_candidates(found: Mapping[str, FamilyFeatures]) -> dict[str, FamilyFeatures]:
    """The families that were found, and those of `MIXES` of which all were."""
    whole = [mix for mix in MIXES if found.keys() >= set(mix)]
    joined = [join_families([found[name] for name in mix]) for mix in whole]
    return {**found, **{features.family: features for features in joined}}


def forecast_candidates(
    images: NDArray[np.uint8],
    targets: Array,
    learn: Indices,
    groups: Indices,
    features: Mapping[str, FamilyFeatures],
    *,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> dict[str, Candidate]:
    """Forecast what every candidate reaches, from the images that are learned from.

    Features that are fitted to images are fitted anew for each fold of a cross-validation; for
    the others the forecast is in closed form.

    Parameters
    ----------
    images : ndarray of shape (n_images, height, width), uint8
    targets : ndarray of shape (n_images, 6)
        Displacements in units of the range.
    learn : ndarray
        Images to learn from.
    groups : ndarray of shape (n_images,)
        Images that belong together.
    features : dict of FamilyFeatures

    Raises
    ------
    InvalidInputError
        If none of the features can be forecast.
    """
    shared = images[learn], targets[learn], own_groups(groups[learn])
    calls = ((*shared, one.family, one.values[learn]) for one in features.values())
    candidates: dict[str, Candidate] = {}
    results = in_processes(forecast_family, calls, n_jobs)
    for n_done, (one, forecast) in enumerate(zip(features.values(), results, strict=True), start=1):
        if forecast is not None:
            candidates[one.family] = Candidate(one, forecast)
        if on_progress is not None:
            on_progress(n_done)
    if not candidates:
        raise InvalidInputError(
            f"None of the families can be had of these {len(learn)} images of "
            f"{images.shape[2]} x {images.shape[1]} px; try other families or larger images."
        )
    return candidates


def choose_families(candidates: Mapping[str, Candidate]) -> dict[str, str]:
    """For every dof the candidate of fewest features that is hardly behind the best forecast."""
    chosen = {}
    for i, dof in enumerate(DOFS):
        rms = {name: float(one.forecast.rms[i]) for name, one in candidates.items()}
        limit = HARDLY_BEHIND * min(rms.values())
        good = [name for name, error in rms.items() if error <= limit]
        chosen[dof] = min(good, key=lambda name: len(candidates[name].features.names))
    return chosen


def refine_forecasts(
    images: NDArray[np.uint8],
    targets: Array,
    groups: Indices | None,
    chosen: Mapping[str, FamilyFeatures],
    *,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> dict[str, Forecast]:
    """The forecast of each dof from its chosen features, with as much effort as training takes.

    Parameters
    ----------
    images : ndarray of shape (n, height, width), uint8
        To learn from; the features in `chosen` are of these.
    targets : ndarray of shape (n, 6)
    groups : ndarray of shape (n,), optional
    chosen : dict of FamilyFeatures
        By dof.
    """
    options: dict[str, Any] = {"groups": groups, "n_jobs": n_jobs, **FULL_EFFORT}
    forecasts: dict[str, Forecast] = {}
    for dof, features in chosen.items():
        y = targets[:, [DOFS.index(dof)]]
        transformer = FamilyTransformer(features.family)
        if transformer.is_learned:
            forecasts[dof] = crossfit_forecast(transformer, images, y, **options)
        else:
            forecasts[dof] = forecast_errors(features.values, y, **options)
        if on_progress is not None:
            on_progress(len(forecasts))
    return forecasts


def own_groups(groups: Indices) -> Indices | None:
    """None where every image is by itself."""
    return None if len(np.unique(groups)) == len(groups) else groups


def forecast_family(
    images: NDArray[np.uint8],
    targets: Array,
    groups: Indices | None,
    family: str,
    values: Array | None = None,
) -> Forecast | None:
    """What one family, or several, are forecast to reach; None if they cannot be had.

    Parameters
    ----------
    images : ndarray of shape (n, height, width), uint8
    targets : ndarray of shape (n, 6)
    groups : ndarray of shape (n,), optional
    family : str
    values : ndarray of shape (n, n_features), optional
        The features of these images, where they are known and not learned.
    """
    transformer = FamilyTransformer(family)
    try:
        if transformer.is_learned:
            return crossfit_forecast(transformer, images, targets, groups=groups)
        if values is None:
            values = transformer.fit(images, targets).transform(images)
        return forecast_errors(values, targets, groups=groups)
    except InvalidInputError:
        return None
