"""What every family of features is forecast to reach, and which one tells each dof best."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

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
    return candidates


def choose_families(candidates: Mapping[str, Candidate]) -> dict[str, str]:
    """The candidate of least forecast error for every dof."""
    return {
        dof: min(candidates, key=lambda name: float(candidates[name].forecast.rms[i]))
        for i, dof in enumerate(DOFS)
    }


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
