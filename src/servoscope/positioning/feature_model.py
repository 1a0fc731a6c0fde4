"""A positioning model of image features: what was assessed is what drives the robot."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.data.independence import independent_groups, split_groups
from servoscope.dofs import mask_of
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.features.catalogue import default_families, resolve_families
from servoscope.keyframe.fitting import evenly_spread
from servoscope.pipeline import (
    FeatureTable,
    PosePipeline,
    Recipe,
    choose,
    find_candidates,
    fit_all,
)
from servoscope.pipeline.feature_table import N_FOLDS
from servoscope.poses import DISPLAY_FACTORS, DOFS, poses_from_displacements
from servoscope.positioning.accuracy import describe_errors, deviation_factor
from servoscope.positioning.interfaces import Array, Estimate, Image
from servoscope.positioning.model import PositioningModel
from servoscope.regression.registry import make_regressor

_N_FOREIGN = 40
_RIDGE = 1e-3
FARTHEST = 2.0
"""Shares of the reach beyond which displacements count as this far in what is expected of them."""

NEAR = 0.2
"""Shares of the reach within which what is predicted at the reference is subtracted."""


@dataclass(frozen=True, eq=False)
class ExpectedFeatures:
    """The features that images of the part have at a displacement: a quadratic polynomial each.

    Parameters
    ----------
    coefficients : ndarray of shape (n_terms, n_features)
        Of displacements in shares of the reach.
    deviation : ndarray of shape (n_features,)
        Root mean square of what the polynomials leave of images of the part that were held out.
    limit : float
        The most that they may leave of an image of the part, as a multiple of these.
    """

    coefficients: Array
    deviation: Array
    limit: float

    @classmethod
    def fit(
        cls, shares: Array, X: Array, own: tuple[Array, Array], foreign: tuple[Array, Array]
    ) -> ExpectedFeatures:
        """Learn from displacements and features, and the limit from others.

        Parameters
        ----------
        shares : ndarray of shape (n, n_dofs)
            Displacements in shares of the reach.
        X : ndarray of shape (n, n_features)
        own : (shares, X)
            Of images of the part that were held out, as they are read.
        foreign : (shares, X)
            Of images of something else, as they are read.

        Warns
        -----
        ServoscopeWarning
            If the features do not separate these.
        """
        terms = _terms(shares)
        left = terms.T @ terms + _RIDGE * len(terms) * np.eye(terms.shape[1])
        coefficients = np.asarray(np.linalg.solve(left, terms.T @ X))
        rest = own[1] - _terms(own[0]) @ coefficients
        deviation = np.sqrt(np.mean(rest**2, axis=0))
        least = 1e-3 * max(float(np.median(deviation)), 1e-9)
        expected = cls(coefficients, np.maximum(deviation, least), 1.0)
        usual = float(np.quantile(expected.differences(*own), 0.95))
        chance = float(expected.differences(*foreign).min())
        if chance <= usual:
            warnings.warn(
                "Images of something else may be taken for this part: the features of its own, "
                "turned by 90 or 180 degrees, differ no more from what is expected "
                f"({chance:.2f}) than those of images held out ({usual:.2f}); add features, or "
                "train a keyframe.",
                ServoscopeWarning,
                stacklevel=2,
            )
        limit = float(np.sqrt(usual * max(chance, usual)))
        return cls(coefficients, expected.deviation, max(limit, 1e-6))

    def differences(self, shares: Array, X: Array) -> Array:
        """How much each row of features differs from what is expected, in deviations, (n,)."""
        rest = (X - _terms(shares) @ self.coefficients) / self.deviation
        return np.asarray(np.sqrt(np.mean(rest**2, axis=1)))


def _terms(shares: Array) -> Array:
    """1, the displacements, and their products by twos, (n, n_terms)."""
    i, j = np.triu_indices(shares.shape[1])
    bounded = shares.clip(-FARTHEST, FARTHEST)
    return np.hstack([np.ones((len(shares), 1)), bounded, bounded[:, i] * bounded[:, j]])


@dataclass(frozen=True, eq=False)
class FeatureModel(PositioningModel):
    """Reads displacements by a regressor a degree of freedom on features chosen for it.

    The parameters below, and those of `PositioningModel`.

    Parameters
    ----------
    pipeline : PosePipeline
        Of displacements about the pivot, [m] and [rad], with ``pivot`` in its record.
    view : ndarray of shape (height, width), uint8
        The reference image.
    expected : ExpectedFeatures
    std_factor : ndarray of shape (n_dofs,)
        What the standard deviations of the pipeline are multiplied by.

    Notes
    -----
    At the reference the displacement is 0. What the pipeline predicts there instead is subtracted
    nearby, so that the loop ends where the image has the features of the reference image.
    """

    kind: ClassVar[str] = "features"

    pipeline: PosePipeline
    view: Image
    expected: ExpectedFeatures
    std_factor: Array

    @property
    def reference_image(self) -> Image:
        """The view to bring the camera back to, uint8."""
        return self.view

    @property
    def pivot(self) -> float:
        """Distance along z of the point that displacements are taken about, [m]."""
        return float(self.pipeline.record_["pivot"])

    @classmethod
    def train(
        cls,
        data: PoseImageSet,
        *,
        families: Sequence[Any] | None = None,
        regressor: Any = "gaussian_process",
        seed: int = 0,
        n_jobs: int | None = -1,
        on_progress: Callable[[int], object] | None = None,
    ) -> FeatureModel:
        """Choose the features of each degree of freedom by a quick forecast, and train on them.

        Parameters
        ----------
        data : PoseImageSet
        families : sequence of str or transformer, optional
            The families of features to choose from, as of `servoscope.assessment.assess`.
        regressor : str or estimator
            What is trained on them.
        seed : int
            Draws the images that test, and what is random in a regressor.
        n_jobs : int, optional
            Processes, as joblib counts them; every number of them gives the same model.
        on_progress : callable, optional
            Called with the number of stages that are finished: 1 when the features are computed, 2
            when some are chosen, 3 at the end.

        Raises
        ------
        DataSetError
            If there are too few images that are independent of each other.
        InvalidInputError
            If a family or the regressor is unknown, or fails.
        """
        tried = default_families() if families is None else list(families)
        resolve_families(tried)
        make_regressor(regressor)
        tell = on_progress or (lambda _: None)
        independence = independent_groups(data)
        try:
            split = split_groups(data, independence, seed)
        except InvalidInputError as error:
            raise DataSetError(f"No features can be chosen: {error}") from error
        dofs, labels = data.dofs, independence.labels
        ranges = data.ranges()[mask_of(dofs)]
        targets = data.delta_p()[:, mask_of(dofs)] / ranges
        groups = independence.dependent(split.learned)
        options: dict[str, Any] = {"n_jobs": n_jobs}
        table = FeatureTable.fit(
            data.images, targets, tried, split.learned, groups=groups, n_folds=N_FOLDS, **options
        )
        tell(1)
        recipes = [Recipe(name, regressor=regressor) for name in table.fitted]
        candidates = find_candidates(table, targets, groups, recipes, dofs, dofs=dofs, **options)
        choice = choose(candidates)
        tell(2)
        fitted = fit_all(
            table,
            targets,
            split,
            [(candidates[choice[dof]].recipe, dof) for dof in dofs],
            dofs=dofs,
            seed=seed,
            **options,
        )
        rms = {
            dof: float(candidates[choice[dof]].forecasts[dof].rms[0] * scale)
            for dof, scale in zip(dofs, ranges, strict=True)
        }
        sample = data.images[split.train[0]]
        pipeline = PosePipeline.from_fitted(
            table, fitted, ranges, split, sample, forecast=rms, pivot=float(data.pivot)
        )
        is_taken = [family in pipeline.fitted_ for family in table.families]
        model = cls.of_pipeline(pipeline, data, labels, table.values[:, is_taken])
        tell(3)
        return model

    @classmethod
    def of_pipeline(
        cls,
        pipeline: PosePipeline,
        data: PoseImageSet,
        groups: NDArray[np.intp],
        features: Array | None = None,
    ) -> FeatureModel:
        """A model of a pipeline, measured on the test images of its split.

        Parameters
        ----------
        pipeline : PosePipeline
            Fitted to images of this data set, as that of an assessment.
        data : PoseImageSet
        groups : ndarray of shape (n_images,)
            Images of a group are not independent of each other.
        features : ndarray of shape (n_images, n_features), optional
            Of the images, as the pipeline computes them, where they are known.
        """
        split, dofs = pipeline.split_, tuple(pipeline.regressors_)
        is_read = mask_of(dofs)
        learned, X = (
            pipeline.compute_features(data.images[part]) if features is None else features[part]
            for part in (split.learned, split.test)
        )
        means, std = pipeline.predict_from(X)
        truth = data.delta_p()[split.test]
        errors = means - truth[:, is_read]
        factor = deviation_factor(errors, std)
        reach = np.where(is_read, data.ranges(), 0.0)
        shown = data.images[evenly_spread(split.test, _N_FOREIGN)]
        F = np.concatenate([pipeline.compute_features(images) for images in _turned(shown)])
        expected = ExpectedFeatures.fit(
            data.delta_p()[np.ix_(split.learned, is_read)] / reach[is_read],
            learned,
            (means / reach[is_read], X),
            (pipeline.predict_from(F)[0] / reach[is_read], F),
        )
        six = np.zeros((len(errors), 6))
        six[:, is_read] = errors
        n_groups = len(np.unique(groups[split.test]))
        accuracy = {
            **describe_errors(six, truth, dofs, reach, n_groups),
            "within_2_std": float(np.mean(np.abs(errors) <= 2 * factor * std)),
            "n_images": len(split.learned),
            "pipeline": pipeline.describe(),
        }
        if "forecast" in pipeline.record_:
            factors = dict(zip(DOFS, DISPLAY_FACTORS, strict=True))
            accuracy["forecast"] = {
                dof: float(rms * factors[dof]) for dof, rms in pipeline.record_["forecast"].items()
            }
        return cls(
            pipeline,
            data.reference_image,
            expected,
            factor,
            reach=reach,
            trained_on=dict(data.source),
            accuracy=accuracy,
            dofs=dofs,
        )

    def estimate(self, image: Image, previous: Estimate | None = None) -> Estimate:
        """Where an image was taken.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        previous : Estimate, optional
            Of the image before; what is predicted does not depend on it.
        """
        X = self.pipeline.compute_features(image[None])
        (mean,), (std,) = self.pipeline.predict_from(X)
        is_read = mask_of(self.dofs)
        away = np.abs(mean - self.at_reference) / self.reach[is_read]
        nearness = np.exp(-0.5 * (away.max() / NEAR) ** 2)
        delta_p, deviation = np.zeros(6), np.full(6, np.nan)
        delta_p[is_read] = mean - nearness * self.at_reference
        deviation[is_read] = self.std_factor * std
        return Estimate(
            displacement=poses_from_displacements(np.eye(4), delta_p, self.pivot),
            std=deviation,
            novelty=self._difference(mean, X) / self.expected.limit,
            stage=self.kind,
        )

    def _difference(self, mean: Array, X: Array) -> float:
        shares = mean[None] / self.reach[mask_of(self.dofs)]
        return float(self.expected.differences(shares, X)[0])

    @cached_property
    def at_reference(self) -> Array:
        """What the pipeline predicts at the reference, (n_dofs,)."""
        return np.asarray(self.pipeline.predict(self.view[None])[0])

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """What reads images, as arrays of numbers."""
        own = {f"pipeline/{name}": array for name, array in self.pipeline.to_arrays().items()}
        expected = vars(self.expected).items()
        own |= {f"expected/{name}": np.asarray(value) for name, value in expected}
        return {**own, "view": self.view, "std_factor": self.std_factor}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], **known: Any) -> Self:
        """The model of its arrays and of its other parameters.

        Raises
        ------
        ValueError, KeyError, TypeError
            If they are not those of a model of this kind.
        """
        parts: dict[str, dict[str, NDArray[Any]]] = {"pipeline": {}, "expected": {}}
        for name, array in arrays.items():
            part, _, own = name.partition("/")
            if own:
                parts[part][own] = array
        pipeline = PosePipeline.from_arrays(parts["pipeline"])
        dofs, view, factor = tuple(pipeline.regressors_), arrays["view"], arrays["std_factor"]
        if dofs != known["dofs"] or ((known["reach"] > 0) != mask_of(dofs)).any():
            raise ValueError("its dofs are not those of its reach and its pipeline")
        if view.dtype != np.uint8 or view.shape != pipeline.image_shape_:
            raise ValueError("its reference image is not of the images that its pipeline takes")
        if factor.shape != (len(dofs),) or not (factor > 0).all():
            raise ValueError("its deviations are not multiplied by a number for each dof")
        if not np.isfinite(float(pipeline.record_["pivot"])):
            raise ValueError("its pivot is not a number")
        names, n_terms = ("coefficients", "deviation"), 1 + len(dofs) * (len(dofs) + 3) // 2
        expected = ExpectedFeatures(
            **{name: parts["expected"][name] for name in names},
            limit=float(parts["expected"]["limit"]),
        )
        n_features = sum(len(one.names) for one in pipeline.fitted_.values())
        shapes = expected.coefficients.shape, expected.deviation.shape
        if shapes != ((n_terms, n_features), (n_features,)):
            raise ValueError("its expected features are not those of its pipeline")
        if not expected.limit > 0 or not (expected.deviation > 0).all():
            raise ValueError("its limit and its deviations are not above 0")
        return cls(pipeline, view, expected, factor, **known)


def _turned(images: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Images that show something else: turned by 180 degrees, and, if square, by 90."""
    height, width = images.shape[1:]
    turns = (1, 2) if height == width else (2,)
    return [np.ascontiguousarray(np.rot90(images, k, axes=(1, 2))) for k in turns]
