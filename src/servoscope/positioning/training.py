"""Training a model for positioning."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.data.independence import LEAST_IMAGES, independent_groups
from servoscope.data.splits import LEAST_GROUPS, MOST_IMAGES
from servoscope.dofs import mask_of
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.keyframe.fitting import evenly_spread
from servoscope.pipeline import FeatureTable, PosePipeline, Recipe, find_candidates
from servoscope.poses import DOFS
from servoscope.positioning.accuracy import ADVICE, check_observable, is_of_use, read_right
from servoscope.positioning.calibration import Calibration
from servoscope.positioning.feature_model import FeatureModel
from servoscope.positioning.keyframe_model import (
    KeyframeModel,
    fit_and_read,
    read_test_images,
)
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

METHODS = ("auto", "keyframe", "features")

N_STAGES = 3
"""Stages of training that progress is reported of."""

_JUDGES = ("moments", "log_polar", "gradient")
_NO_BETTER = 0.95
_MOST_JUDGED, _FITTED, _READ = 100, 20, 6
_OUTLYING = 1.1
_MOST_NAMED = 3


@dataclass(frozen=True, eq=False)
class Assessed:
    """What an assessment of the same images found.

    Parameters
    ----------
    pipeline : PosePipeline
        What was chosen and trained there, with the split of the images in which it was tested.
    groups : ndarray of shape (n_images,)
        Images of a group are not independent of each other.
    record : dict
        What a model shall keep of it, as plain JSON values: ``loop``, of the rehearsal of a
        keyframe, None if none explains the view, and whatever else.
    """

    pipeline: PosePipeline
    groups: NDArray[np.intp]
    record: dict[str, Any]

    def check(self, n_images: int) -> None:
        """Raise InvalidInputError unless its split is of so many images, and tests on some."""
        learned, test = self.pipeline.split_.learned, self.pipeline.split_.test
        both = np.concatenate([learned, test])
        is_of_them = bool(both.size) and 0 <= both.min() <= both.max() < n_images
        if not (is_of_them and test.size and len(np.unique(both)) == len(both)) or (
            self.groups.shape != (n_images,)
        ):
            raise InvalidInputError(
                f"The split of an assessment must be of these {n_images} images, got "
                f"{len(learned)} that are learned from and {len(test)} that test, of "
                f"{len(self.groups)}; assess these images."
            )


def train(
    data: PoseImageSet,
    *,
    method: str = "auto",
    families: Sequence[Any] | None = None,
    regressor: Any = None,
    seed: int = 0,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
    calibration: Calibration | None = None,
    assessment: Assessed | None = None,
) -> KeyframeModel | FeatureModel:
    """A model that reads where images were taken.

    Parameters
    ----------
    data : PoseImageSet
        Spread over the range that is to be covered; of more than `MOST_IMAGES` so many are used,
        evenly spread in time. Its poses may be the flange's: where the
        camera sits need not be known. The model reads and commands the degrees of freedom of
        ``data.dofs``.
    method : {"auto", "keyframe", "features"}
        Fit a keyframe, which takes 15 to 60 images, or train on image features, which takes 60 to
        1000. By default features if some are named or no keyframe explains the view, else a
        keyframe.
    families : sequence of str or transformer, optional
        The families of features to choose from: names of `servoscope.features.catalogue`, or
        objects with ``fit(images, displacements)`` and ``transform(images)``.
    regressor : str or estimator, optional
        What is trained on features: a name in `servoscope.regression.REGRESSORS`.
    seed : int
        Draws the images that test a model of features, and what is random in its regressors.
    n_jobs : int, optional
        Processes, as joblib counts them; the model does not depend on it.
    on_progress : callable, optional
        Called with the number of stages, of `N_STAGES`, that are finished.
    calibration : Calibration, optional
        What is known of lens, poses and distance, for a keyframe.
    assessment : Assessed, optional
        An assessment of these images. A model of features is then the pipeline that was assessed;
        accuracy, deviations and least similarity of a keyframe are taken from the images that it
        tested on. By default it is a keyframe if one explained the view there. The model keeps
        the record of the assessment.

    Raises
    ------
    DataSetError
        If there are too few images, nothing moves or a dof that was asked for does not, or most
        dofs of images held out are predicted no better than by their mean.
    InvalidInputError
        If the method or a family is unknown, or the assessment is of other images.

    Warns
    -----
    ServoscopeWarning
        If some dofs of images held out are predicted no better than by their mean, or a few images
        are left out as outliers.
    """
    if method not in METHODS:
        raise InvalidInputError(f"method must be one of {', '.join(METHODS)}, got {method!r}.")
    has_recipe = families is not None or regressor is not None
    if method == "keyframe" and has_recipe:
        raise InvalidInputError(
            "A keyframe takes no families and no regressor; leave them out, or train by features."
        )
    data = data.thinned(MOST_IMAGES)
    _check_dofs(data)
    if assessment is not None:
        assessment.check(len(data))
        if method == "auto" and not has_recipe:
            method = "features" if assessment.record.get("loop") is None else "keyframe"
    inside = within_range(data)

    def keyframe() -> KeyframeModel:
        known, held_out = calibration or Calibration(), None
        if assessment is not None:
            split = assessment.pipeline.split_
            held_out = read_test_images(data, split, assessment.groups, known)
        return KeyframeModel.train(
            inside, held_out=held_out, calibration=known, n_jobs=n_jobs, on_progress=on_progress
        )

    def features() -> FeatureModel:
        if assessment is not None and not has_recipe:
            return FeatureModel.of_pipeline(assessment.pipeline, data, assessment.groups)
        return FeatureModel.train(
            inside,
            families=families,
            regressor=regressor or "gaussian_process",
            seed=seed,
            n_jobs=n_jobs,
            on_progress=on_progress,
        )

    if method != "features" and not has_recipe and assessment is None:
        _check_poses(inside, calibration or Calibration(), n_jobs)
    model: KeyframeModel | FeatureModel
    if method == "features" or (method == "auto" and has_recipe):
        model = features()
    elif method == "keyframe" or len(data) < LEAST_IMAGES:
        model = keyframe()
    else:
        model = _first_of_use(keyframe, features)
    check_observable(model.accuracy["error_shares"])
    model.trained_on["fingerprint"] = data.fingerprint()
    if assessment is not None:
        model.accuracy["assessment"] = assessment.record
    if on_progress is not None:
        on_progress(N_STAGES)
    return model


def _check_dofs(data: PoseImageSet) -> None:
    still = [dof for dof in data.dofs if not data.moves()[DOFS.index(dof)]]
    if still or not data.dofs:
        raise DataSetError(
            "A model needs images displaced in each dof that it is to command, but "
            f"{', '.join(still or DOFS)} never move in this data set; take images that are, or "
            "name other dofs."
        )


def _check_poses(data: PoseImageSet, calibration: Calibration, n_jobs: int | None) -> None:
    """Refuse images that are not of their poses, which models are long in finding out.

    Raises
    ------
    DataSetError
        If features are forecast to predict no dof better than its mean, and a keyframe of a few
        of the images reads none of some others right.
    """
    if len(data) < LEAST_IMAGES:
        return
    independence = independent_groups(data)
    few = evenly_spread(np.flatnonzero(independence.labels >= 0), _MOST_JUDGED)
    if len(np.unique(independence.labels[few])) < LEAST_GROUPS:
        return
    groups = independence.dependent(few)
    groups = None if groups is None else groups[few]
    try:
        shares = _forecast_shares(data.subset(few), groups, n_jobs)
    except InvalidInputError:  # there are no such features, as of tiny images
        return
    if min(shares.values()) < _NO_BETTER:
        return
    fitted, read = evenly_spread(few[::2], _FITTED), evenly_spread(few[1::2], _READ)
    try:
        with one_blas_thread():
            _, readings = fit_and_read(data, fitted, read, calibration)
        right = read_right(np.abs(readings.errors) * mask_of(data.dofs), data.ranges())
    except InvalidInputError:
        right = np.zeros(len(read), dtype=bool)
    if not right.any():
        shown = ", ".join(f"{dof} {share:.2f}" for dof, share in shares.items())
        raise DataSetError(
            f"The images say nothing of their poses: features are forecast to err as much as the "
            f"mean ({shown} of its error), and a keyframe of {len(fitted)} of them reads none of "
            f"{len(read)} others right; no robot may be moved by that: {ADVICE}."
        )


def _forecast_shares(
    data: PoseImageSet, groups: NDArray[np.intp] | None, n_jobs: int | None
) -> dict[str, float]:
    """By dof, the least error that features are forecast to reach, as a share of the mean's."""
    moving, every = mask_of(data.dofs), np.arange(len(data))
    targets = data.delta_p()[:, moving] / data.ranges()[moving]
    table = FeatureTable.fit(data.images, targets, _JUDGES, every, n_jobs=n_jobs)
    recipes = [Recipe(name) for name in table.fitted]
    found = find_candidates(
        table, targets, groups, recipes, data.dofs, dofs=data.dofs, n_jobs=n_jobs
    )
    return {
        dof: min(
            float(one.forecasts[dof].rms[0] / max(float(one.forecasts[dof].baseline[0]), 1e-12))
            for one in found.values()
        )
        for dof in data.dofs
    }


def _first_of_use(
    keyframe: Callable[[], KeyframeModel], features: Callable[[], FeatureModel]
) -> KeyframeModel | FeatureModel:
    """A keyframe; a model of features if none explains the view and features predict better."""
    made: list[KeyframeModel | FeatureModel] = []
    failures: list[DataSetError] = []
    for make in (keyframe, features):
        try:
            made.append(make())
        except DataSetError as error:
            failures.append(error)
            continue
        if is_of_use(made[-1].accuracy["error_shares"]):
            return made[-1]
    if not made:
        raise failures[0]
    return made[0]


def within_range(data: PoseImageSet) -> PoseImageSet:
    """The images within the range; a few are not where the range is estimated without outliers.

    Warns
    -----
    ServoscopeWarning
        If some are not.
    """
    is_outlier = _is_outlying(data)
    if not is_outlier.any():
        return data
    outliers = [data.names[int(i)] for i in np.flatnonzero(is_outlier)]
    more = ", ..." if len(outliers) > _MOST_NAMED else ""
    warnings.warn(
        f"{len(outliers)} of {len(data)} images are not trained on, being more than twice as far "
        f"from the reference as all others: {', '.join(outliers[:_MOST_NAMED])}{more}; if their "
        "poses are right, take more images that far away.",
        ServoscopeWarning,
        stacklevel=3,
    )
    return replace(data.subset(np.flatnonzero(~is_outlier)), pivot_ranges=data.ranges())


def _is_outlying(data: PoseImageSet) -> NDArray[np.bool_]:
    """Which images are beyond a range that is estimated without outliers."""
    if data.pivot_ranges is not None:
        return np.zeros(len(data), dtype=bool)
    is_beyond = np.abs(data.delta_p()) > _OUTLYING * data.ranges()
    return np.asarray(is_beyond[:, mask_of(data.dofs)].any(axis=1))
