"""How closely an exported model agrees with the one that it was made of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.export.onnx_estimator import OnnxEstimator
from servoscope.keyframe.rendering import continued
from servoscope.poses import (
    DISPLAY_FACTORS,
    DISPLAY_UNITS,
    DOFS,
    displacements_from_poses,
    poses_from_displacements,
)
from servoscope.positioning.interfaces import Image
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.settings import NEAR_ENOUGH

Array = NDArray[np.float64]

EQUAL = 1e-3
"""Differences up to this share of the tolerance count as none."""

LEAST_TOLERANCE = np.repeat([1e-3 * NEAR_ENOUGH["mm"], np.radians(NEAR_ENOUGH["deg"])], 3)
"""What is always near enough, by dof, [m] and [rad]."""

_DRAWN = 0.8
_WARP = 0.03


@dataclass(frozen=True, eq=False)
class Agreement:
    """Differences between a model and its export on images that show the part.

    Parameters
    ----------
    median, worst : ndarray of shape (6,)
        Of each dof about the pivot, [m] and [rad].
    shares : ndarray of shape (n_images,)
        The greatest difference of each image as a share of the tolerance: of the deviation that
        is believed of the dof there, or of what is always near enough if that is more.
    deviation : float
        Greatest relative difference of the deviations.
    similarity : float
        Greatest difference of the similarities.
    n_images : int
    ms : tuple of 2 floats
        Median time for an image, by the model and by its export on one core.
    """

    median: Array
    worst: Array
    shares: Array
    deviation: float
    similarity: float
    n_images: int
    ms: tuple[float, float]

    @property
    def worst_share(self) -> float:
        """The greatest difference of all, as a share of the tolerance."""
        return float(self.shares.max())

    @property
    def equal(self) -> float:
        """Share of the images on which both agree to `EQUAL` of the tolerance."""
        return float(np.mean(self.shares <= EQUAL))

    @classmethod
    def between(
        cls,
        model: PositioningModel,
        exported: OnnxEstimator,
        images: NDArray[np.uint8] | None = None,
        n_rendered: int = 20,
    ) -> Agreement:
        """Compare on the reference image, rendered ones, and others.

        Parameters
        ----------
        model : KeyframeModel or FeatureModel
        exported : OnnxEstimator
        images : ndarray of shape (n, height, width), uint8, optional
        n_rendered : int
            If it is 0, only `images` count.
        """
        if images is not None and images.shape[1:] != model.image_shape:
            height, width = model.image_shape
            raise InvalidInputError(
                f"The images must be as large as the reference image, {width} x {height} px, got "
                f"{images.shape[2]} x {images.shape[1]} px."
            )
        differences, shares, deviations, similarities, times = [], [], [], [], []
        shown = _shown(model, n_rendered) if n_rendered else iter(())
        for image in (*shown, *(() if images is None else images)):
            started = perf_counter()
            ours, between = model.estimate(image), perf_counter()
            theirs, ended = exported.estimate(image), perf_counter()
            times.append((between - started, ended - between))
            if not (theirs.is_recognised or ours.is_recognised):
                continue  # what neither takes for the part is read of nothing
            found = np.stack([ours.displacement, theirs.displacement])
            six = displacements_from_poses(np.eye(4), found, model.pivot)
            difference = np.abs(six[0] - six[1])
            known = np.isfinite(ours.std)
            tolerance = np.maximum(np.where(known, ours.std, 0.0), LEAST_TOLERANCE)
            ratio = theirs.std[known] / ours.std[known]
            differences.append(difference)
            shares.append((difference / tolerance).max())
            deviations.append(np.abs(ratio - 1).max())
            if np.isfinite(ours.similarity):
                similarities.append(abs(theirs.similarity - ours.similarity))
        if not shares:
            raise InvalidInputError(
                "None of the images shows the part of the model; compare on some that do."
            )
        return cls(
            np.median(differences, axis=0),
            np.max(differences, axis=0),
            np.array(shares),
            float(np.max(deviations)),
            float(np.max(similarities, initial=0.0)),
            len(shares),
            tuple((1e3 * np.median(times, axis=0)).tolist()),
        )

    def to_dict(self) -> dict[str, Any]:
        """The same as plain JSON values, in mm and degrees."""
        by_dof = [
            {
                "dof": dof,
                "unit": unit,
                "median": float(median),
                "worst": float(worst),
            }
            for dof, unit, median, worst in zip(
                DOFS,
                DISPLAY_UNITS,
                self.median * DISPLAY_FACTORS,
                self.worst * DISPLAY_FACTORS,
                strict=True,
            )
        ]
        return {
            "images": self.n_images,
            "equal_share": self.equal,
            "median_share_of_tolerance": float(np.median(self.shares)),
            "worst_share_of_tolerance": self.worst_share,
            "worst_deviation": self.deviation,
            "worst_similarity": self.similarity,
            "ms_by_model": round(self.ms[0], 1),
            "ms_by_file": round(self.ms[1], 1),
            "dofs": by_dof,
        }


def _shown(model: PositioningModel, n: int) -> Iterator[Image]:
    """The reference image, and what is seen from displacements all over the reach, with noise."""
    rng = np.random.default_rng(0)
    yield model.reference_image
    if not isinstance(model, KeyframeModel):
        yield from _warped(model.reference_image, n, rng)
        return
    drawn = _DRAWN * model.reach * rng.uniform(-1, 1, (n, 6))
    for D in poses_from_displacements(np.eye(4), drawn, model.pivot):
        image = continued(*model.keyframe.render(D)).astype(float)
        noisy = image + rng.normal(scale=model.keyframe.noise, size=image.shape)
        yield noisy.round().clip(0, 255).astype(np.uint8)


def _warped(image: Image, n: int, rng: np.random.Generator) -> Iterator[Image]:
    """An image shifted, turned and enlarged by a few hundredths, with noise."""
    height, width = image.shape
    for right, down, turn, size in _WARP * rng.uniform(-1, 1, (n, 4)):
        M = cv2.getRotationMatrix2D((width / 2, height / 2), np.degrees(turn), 1 + size)
        M[:, 2] += right * width, down * height
        moved = cv2.warpAffine(image, M, (width, height), borderMode=cv2.BORDER_REFLECT)
        noisy = moved + rng.normal(size=image.shape)
        yield noisy.round().clip(0, 255).astype(np.uint8)
