"""Training a model for positioning."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.data.independence import independent_groups
from servoscope.data.splits import Split
from servoscope.dofs import mask_of
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.poses import DISPLAY_FACTORS, DOFS, displacements_from_poses
from servoscope.positioning.calibration import Calibration
from servoscope.positioning.decision import compare_methods
from servoscope.positioning.keyframe_model import KeyframeModel, error_shares, read_test_images
from servoscope.positioning.ladder import HeldOut, has_images_for_levels, learn_levels, plan_rungs
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.pose_networks import PoseNetworks
from servoscope.processes import one_blas_thread
from servoscope.scene.disturbances import Disturbances

Array = NDArray[np.float64]

METHODS = ("auto", "keyframe", "levels")

N_STAGES = 3
"""Stages of training that progress is told of: levels, networks, and what they reach."""

LEAST_GAIN = 0.8
"""A dof is observable if its error is at most this share of that of predicting the mean."""

_OUTER = 0.3
_OUTLYING = 1.1
_MOST_NAMED = 3
_N_GROUPS = 6
_MOST_CHECKED = 40
_LEAST_OUTER = 10


@dataclass(frozen=True, eq=False)
class Assessed:
    """What an assessment of the same images found.

    Parameters
    ----------
    split : Split
        The images that it learned from, and those that it tested on.
    groups : ndarray of shape (n_images,)
        Images of a group are not independent of each other.
    record : dict
        What a model shall keep of it, as plain JSON values: ``loop``, of the rehearsal of a
        keyframe, None if none explains the view, and whatever else.
    """

    split: Split
    groups: NDArray[np.intp]
    record: dict[str, Any]

    def parts(self, n_images: int) -> NDArray[np.intp]:
        """0 for each image that tests, 1 for those learned from, and -1 for those of neither.

        Raises
        ------
        InvalidInputError
            If these are not parts of so many images.
        """
        learned, test = self.split.learned, self.split.test
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
        parts = np.full(n_images, -1)
        parts[learned], parts[test] = 1, 0
        return parts


def train(
    data: PoseImageSet,
    *,
    method: str = "auto",
    seed: int = 0,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
    calibration: Calibration | None = None,
    assessment: Assessed | None = None,
) -> PositioningModel | KeyframeModel:
    """A model that reads where images were taken.

    Parameters
    ----------
    data : PoseImageSet
        Best taken in rings around the reference, see ``servoscope acquire --schedule``. Its poses
        may be the flange's: where the camera sits need not be known. The model reads and commands
        the degrees of freedom of ``data.dofs``.
    method : {"auto", "keyframe", "levels"}
        Fit a keyframe, which takes 15 to 60 images, or learn levels and networks, which take
        hundreds and all six degrees of freedom; by default a keyframe if the images are too few
        for levels, else what reads images held out better.
    seed : int
        Draws the nets' starts, what is held out, and the disturbances.
    n_jobs : int, optional
        Processes, as joblib counts them; the model does not depend on it.
    on_progress : callable, optional
        Called with the number of stages, of `N_STAGES`, that are finished.
    calibration : Calibration, optional
        What is known of lens, poses and distance, for a keyframe.
    assessment : Assessed, optional
        An assessment of these images. Accuracy, deviations and least similarity are then taken from
        the images that it tested on, the method is by default the keyframe if one explained the
        view there, and the model keeps its record.

    Returns
    -------
    PositioningModel or KeyframeModel

    Raises
    ------
    DataSetError
        If there are too few images, nothing moves or a dof that was asked for does not, or most
        dofs of images held out are predicted no better than by their mean.
    InvalidInputError
        If levels are to be learned of images that are not displaced in all six dofs, or the
        assessment is of other images.

    Warns
    -----
    ServoscopeWarning
        If some dofs of images held out are predicted no better than by their mean, or a few images
        are left out as outliers.
    """
    if method not in METHODS:
        raise InvalidInputError(f"method must be one of {', '.join(METHODS)}, got {method!r}.")
    method = _method_for(data, method)
    parts = None if assessment is None else assessment.parts(len(data))
    if method == "auto" and assessment is not None and assessment.record.get("loop") is not None:
        method = "keyframe"
    whole, data = data, within_range(data)
    calibration = calibration or Calibration()
    found = {} if assessment is None else {"assessment": assessment.record}
    if method == "keyframe" or (
        method == "auto" and not has_images_for_levels(data.delta_p() / data.ranges())
    ):
        keyframe = _keyframe(whole, data, assessment, calibration, n_jobs, on_progress)
        keyframe.accuracy.update(found)
        return keyframe
    tell = on_progress or (lambda _: None)
    groups = None if parts is None else parts[~_is_outlying(whole)]
    with one_blas_thread():
        levels, held_out = _levels(data, groups, seed, n_jobs, tell)
        if method == "auto":
            found["decision"] = compare_methods(levels, data, held_out, calibration)
            if found["decision"]["chosen"] == "keyframe":
                keyframe = _keyframe(whole, data, assessment, calibration, n_jobs, None)
                keyframe.accuracy.update(found)
                tell(N_STAGES)
                return keyframe
    levels.accuracy.update(found)
    check_observable(levels.accuracy["error_shares"])
    tell(N_STAGES)
    return levels


def _method_for(data: PoseImageSet, method: str) -> str:
    """The method for the degrees of freedom of a data set: a keyframe if they are not all six."""
    still = [dof for dof in data.dofs if not data.moves()[DOFS.index(dof)]]
    if still or not data.dofs:
        raise DataSetError(
            "A model needs images displaced in each dof that it is to command, but "
            f"{', '.join(still or DOFS)} never move in this data set; take images that are, or "
            "name other dofs."
        )
    if data.dofs == DOFS:
        return method
    if method == "levels":
        raise InvalidInputError(
            "Levels are learned of images displaced in all six dofs, but these are for "
            f"{', '.join(data.dofs)}; leave --method out: a keyframe reads them."
        )
    return "keyframe"


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


def _keyframe(
    whole: PoseImageSet,
    data: PoseImageSet,
    assessment: Assessed | None,
    calibration: Calibration,
    n_jobs: int | None,
    on_progress: Callable[[int], object] | None,
) -> KeyframeModel:
    """A keyframe of the images within the range; the assessment is of all of them."""
    held_out = None
    if assessment is not None:
        held_out = read_test_images(whole, assessment.split, assessment.groups, calibration)
    model = KeyframeModel.train(
        data,
        held_out=held_out,
        calibration=calibration,
        n_jobs=n_jobs,
        on_progress=on_progress,
    )
    check_observable(model.accuracy["error_shares"])
    return model


def _levels(
    data: PoseImageSet,
    groups: NDArray[np.intp] | None,
    seed: int,
    n_jobs: int | None,
    tell: Callable[[int], object],
) -> tuple[PositioningModel, HeldOut]:
    """A model of levels and networks, and the images that no level learned from: of group 0."""
    reach, delta_p = data.ranges(), data.delta_p()
    p = delta_p / reach
    rng = np.random.default_rng([seed, len(data)])
    plan_rungs(p)  # or say that there are too few images, before they are put into groups
    if groups is None:
        independence = independent_groups(data, _N_GROUPS)
        groups = None if independence.kind == "independent" else independence.labels
    levels, held_out = learn_levels(data.images, p, data.reference_image, rng, groups=groups)
    tell(1)
    is_kept = np.zeros(len(p), dtype=bool)
    is_kept[held_out.kept] = True
    outer = is_kept & (np.abs(p).max(axis=1) > _OUTER)
    networks = PoseNetworks.train(
        data.images[outer],
        delta_p[outer],
        reach,
        disturbances=Disturbances(),
        seed=seed,
        n_jobs=n_jobs,
    )
    tell(2)
    model = PositioningModel(
        networks, levels, data.reference_image, data.pivot, reach, dict(data.source)
    )
    model.accuracy.update(_measure(model, held_out))
    return model, held_out


def check_observable(error_shares: Mapping[str, float]) -> None:
    """Say which dofs a model cannot predict, or refuse one that is of no use.

    Parameters
    ----------
    error_shares : mapping of str to float
        By dof: RMS error of images held out, as a share of that of their mean.

    Raises
    ------
    DataSetError
        If most dofs are predicted no better than by the mean.

    Warns
    -----
    ServoscopeWarning
        If some are.
    """
    unobservable = [dof for dof, share in error_shares.items() if not share < LEAST_GAIN]
    if not unobservable:
        return
    shown = ", ".join(f"{dof} {error_shares[dof]:.2f}" for dof in unobservable)
    found = (
        f"Images held out are predicted hardly better than by their mean in {shown} (error as a "
        f"share of the mean's, at most {LEAST_GAIN:g})"
    )
    advice = "see that every image belongs to its pose, none late, and that it shows the part"
    if 2 * len(unobservable) > len(error_shares):
        raise DataSetError(f"{found}; no robot may be moved by that: {advice}.")
    warnings.warn(
        f"{found}; the robot will not be positioned in these dofs: {advice}.",
        ServoscopeWarning,
        stacklevel=3,
    )


def _measure(model: PositioningModel, held_out: HeldOut) -> dict[str, Any]:
    """Median absolute error of one look, in mm and degrees, by how far away the camera is."""
    size = np.abs(held_out.p).max(axis=1)
    outer = np.flatnonzero(size > _OUTER)
    outer = outer if len(outer) >= _LEAST_OUTER else np.arange(len(size))
    errors = _errors(model, held_out.images[outer], held_out.p[outer])
    truth = held_out.p[outer] * model.reach * DISPLAY_FACTORS
    rms, shares = np.sqrt(np.mean(errors**2, axis=0)), error_shares(errors, truth)
    rings = []
    for level in model.levels:
        near = np.flatnonzero((size <= level.radius) & (size > level.radius / 2))[:_MOST_CHECKED]
        if not near.size:
            continue
        ring: dict[str, Any] = {
            "mm": 1e3 * level.radius * float(model.reach[:3].max()),
            "deg": float(np.degrees(level.radius * model.reach[3:].max())),
            "n_images": int(near.size),
        }
        for kind, images in (("clean", held_out.images), ("disturbed", held_out.disturbed)):
            errors = _errors(model, images[near], held_out.p[near])
            ring[kind] = dict(zip(DOFS, np.median(errors, axis=0).tolist(), strict=True))
        rings.append(ring)
    return {
        "rms": dict(zip(DOFS, rms.tolist(), strict=True)),
        "held_out": {"images": len(outer)},
        "rings": rings,
        "error_shares": dict(zip(DOFS, shares.tolist(), strict=True)),
        "networks": model.networks.report(),
    }


def _errors(model: PositioningModel, images: NDArray[np.uint8], p: Array) -> Array:
    """Absolute errors of first looks, (n, 6), [mm] and [deg]."""
    said = np.stack([model.estimate(image).displacement for image in images])
    delta_p = displacements_from_poses(np.eye(4), said, model.pivot)
    return np.abs(delta_p - p * model.reach) * DISPLAY_FACTORS
