"""A positioning model of twenty to sixty images: the reference view as a keyframe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.dataset import PoseImageSet
from servoscope.errors import DataSetError, InvalidInputError
from servoscope.keyframe import Alignment, Keyframe, held_out_looks
from servoscope.keyframe.alignment import CLEARLY_ALIKE
from servoscope.poses import DISPLAY_FACTORS, DOFS, inverse_transform
from servoscope.positioning.calibration import Calibration
from servoscope.positioning.first_guess import FirstGuess
from servoscope.positioning.interfaces import Array, Estimate, Image
from servoscope.positioning.recognition import (
    LEAST_SIMILARITY,
    Recognition,
    chance_similarity,
    least_similarity,
    read_right,
    recogniser,
)
from servoscope.splits import independent_groups
from servoscope.storage.model_folder import Folder, write_model

KIND = "keyframe"
"""What ``model.json`` calls a model of this kind."""

RESIDUAL = "held_out_residual"
"""The array of a model folder that holds the residuals of images held out, by pixel."""

NOT_SEEN = -1.0
"""The residual of a pixel that no image held out shows."""

LEAST_IMAGES = 15
"""Images that a model needs, so that some can be held out."""

_MOST_IMAGES = 90
_FARTHEST = 1.5
"""Shares of the reach beyond which nothing is read."""

_MOST_OPTIMISTIC = 5.0
_N_GROUPS = 3
_NORMAL_QUANTILE_90 = 1.645


@dataclass(frozen=True, eq=False)
class KeyframeModel:
    """Reads displacements by warping the reference image onto what is seen.

    Parameters
    ----------
    keyframe : Keyframe
    reach : ndarray of shape (6,)
        Largest displacements about the pivot that it was fitted to, [m] and [rad].
    trained_on : dict
        Where its images come from, as plain JSON values.
    accuracy : dict
        What was found on images that were held out, as plain JSON values.
    residual : ndarray of shape (rows, columns), float32, optional
        Residuals of images held out, by pixel of the reference image, in multiples of the noise;
        negative where none shows it.
    first_guess : FirstGuess, optional
        Where the search begins.
    """

    keyframe: Keyframe
    reach: Array
    trained_on: dict[str, Any] = field(default_factory=dict)
    accuracy: dict[str, Any] = field(default_factory=dict)
    residual: NDArray[np.float32] | None = None
    first_guess: FirstGuess | None = None

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the images that it takes, [px]."""
        height, width = self.reference_image.shape
        return height, width

    @property
    def reference_image(self) -> Image:
        """The view to bring the camera back to, uint8."""
        return self.keyframe.reference_image

    @property
    def pivot(self) -> float:
        """Distance along z of the point that displacements are taken about, [m]."""
        return self.keyframe.pivot

    @classmethod
    def train(
        cls,
        data: PoseImageSet,
        *,
        calibration: Calibration | None = None,
        n_jobs: int | None = -1,
        on_progress: Callable[[int], object] | None = None,
    ) -> KeyframeModel:
        """A model from images spread over the range that is to be covered.

        Parameters
        ----------
        data : PoseImageSet
        calibration : Calibration, optional
            What need not be found, or is known of the poses.
        n_jobs : int, optional
            Processes, as joblib counts them; every number of them gives the same model.
        on_progress : callable, optional
            Called with the number of stages that are finished: 1 when images held out are read,
            2 when the keyframe is fitted, 3 at the end.

        Raises
        ------
        DataSetError
            If there are too few images, or no keyframe explains them.
        """
        if len(data) < LEAST_IMAGES:
            raise DataSetError(
                f"A model needs at least {LEAST_IMAGES} images, got {len(data)}; take 40, spread "
                "over the range that is to be covered."
            )
        tell = on_progress or (lambda _: None)
        shown = np.unique(np.linspace(0, len(data) - 1, _MOST_IMAGES).astype(int))
        images, poses = data.images[shown], data.T_world_cam[shown]
        reference = data.reference_image, data.T_world_ref
        options = (calibration or Calibration()).options(is_sequence=data.split == "blocks")
        options["pivot"] = data.pivot
        try:
            groups = independent_groups(data.subset(shown), _N_GROUPS).labels
            held = groups >= 0
            looks = held_out_looks(
                images[held], poses[held], *reference, groups[held],
                similarity_by=recogniser, n_jobs=n_jobs, **options,
            )  # fmt: skip
            tell(1)
            keyframe = Keyframe.fit(images, poses, *reference, **options)
            tell(2)
        except InvalidInputError as error:
            raise DataSetError(f"No keyframe can be fitted: {error}") from error
        errors, reach = np.abs(looks.errors), data.ranges()
        right = read_right(errors, reach)
        factor = deviation_factor(errors[right], looks.std[right])
        keyframe = replace(keyframe, model_error=factor * keyframe.model_error)
        chance = chance_similarity(keyframe, images, _FARTHEST * reach)
        accuracy = {
            "error_shares": _by_dof(error_shares(errors, data.delta_p()[shown][held])),
            "median": _by_dof(np.median(errors, axis=0) * DISPLAY_FACTORS),
            "quantile_90": _by_dof(np.quantile(errors, 0.9, axis=0) * DISPLAY_FACTORS),
            "within_2_std": float(np.mean(errors <= 2 * factor * looks.std)),
            "similarity": float(np.median(looks.similarity)),
            "chance_similarity": chance,
            "least_similarity": least_similarity(looks.similarity[right], chance),
            "n_images": len(shown),
            "residual": keyframe.residual,
            "residual_over_noise": looks.residual_over_noise,
            "noise": keyframe.noise,
            "observable": keyframe.observable,
        }
        displacements = inverse_transform(data.T_world_ref) @ poses
        first_guess = FirstGuess.train(keyframe, reach, images, displacements)
        tell(3)
        residual = np.nan_to_num(looks.residual_map / looks.noise, nan=NOT_SEEN)
        return cls(
            keyframe, reach, dict(data.source), accuracy, residual.astype(np.float32), first_guess
        )

    def estimate(self, image: Image, previous: Estimate | None = None) -> Estimate:
        """Where an image was taken.

        After a move the camera should be near the reference, where the search begins. If nothing
        alike is found there, and at the start, it begins at the first guesses; and where these
        lead to nothing that is clearly alike, displacements from all over the reach are tried.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        previous : Estimate, optional
            Of the image before.

        Returns
        -------
        Estimate
        """
        if previous is not None:
            near = self._as_estimate(image, self.keyframe.align(image, np.eye(4)))
            if near.similarity >= near.least_similarity:
                return near
        starts = None if self.first_guess is None else self.first_guess(image)
        found = self.keyframe.align(image, starts)
        if starts is not None and found.similarity < CLEARLY_ALIKE:
            found = max(found, self.keyframe.align(image), key=lambda found: found.similarity)
        return self._as_estimate(image, found)

    def _as_estimate(self, image: Image, found: Alignment) -> Estimate:
        return Estimate(
            displacement=found.displacement,
            std=found.std,
            novelty=float(np.max(np.abs(found.delta_p) / (_FARTHEST * self.reach))),
            stage="keyframe",
            similarity=self._recognition.similarity(image, found.displacement),
            least_similarity=float(self.accuracy.get("least_similarity", LEAST_SIMILARITY)),
        )

    @cached_property
    def _recognition(self) -> Recognition:
        return Recognition(self.keyframe)

    def save(self, folder: Folder, *, force: bool = False) -> None:
        """Write the model to a folder of its own, whole or not at all.

        Raises
        ------
        FolderExistsError
            If the folder holds something, unless it is a model and `force` is set.
        """
        header = {
            "kind": KIND,
            "image_size": list(self.image_shape),
            "pivot": self.pivot,
            "reach": self.reach.tolist(),
            "trained_on": self.trained_on,
            "accuracy": self.accuracy,
        }
        parts = {"keyframe": self.keyframe.to_arrays()}
        if self.first_guess is not None:
            parts["first_guess"] = self.first_guess.to_arrays()
        arrays = {
            f"{part}/{name}": array for part, own in parts.items() for name, array in own.items()
        }
        if self.residual is not None:
            arrays[RESIDUAL] = self.residual
        write_model(folder, header, arrays, force=force)

    @classmethod
    def restore(
        cls, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> KeyframeModel:
        """The model of a header and arrays.

        Raises
        ------
        ValueError, KeyError, TypeError
            If they are not those of a model of this kind.
        """
        parts = parts_of(arrays)
        keyframe = Keyframe.from_arrays(parts["keyframe"])
        reach = np.array(header["reach"], dtype=float)
        if list(keyframe.reference_image.shape) != list(header["image_size"]):
            raise ValueError("its reference image is not of its image size")
        if reach.shape != (6,) or not (np.isfinite(reach) & (reach > 0)).all():
            raise ValueError("its reach is not six positive numbers")
        if not 0 <= float(header["accuracy"].get("least_similarity", 0)) <= 1:
            raise ValueError("its least similarity is not between 0 and 1")
        guess = parts["first_guess"]
        first_guess = None
        if guess:
            shape = keyframe.reference_image.shape
            first_guess = FirstGuess.from_arrays(guess, shape, reach, keyframe.pivot)
        return cls(
            keyframe, reach, dict(header["trained_on"]), dict(header["accuracy"]),
            arrays.get(RESIDUAL), first_guess,
        )  # fmt: skip


def parts_of(arrays: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, NDArray[Any]]]:
    """The arrays of a model's keyframe and of its first guess, by the names that each gave them."""
    parts: dict[str, dict[str, NDArray[Any]]] = {"keyframe": {}, "first_guess": {}}
    for name, array in arrays.items():
        part, _, own = name.partition("/")
        if part in parts:
            parts[part][own] = array
        elif not own:  # as models were written before they held first guesses
            parts["keyframe"][name] = array
    return parts


def error_shares(errors: Array, truth: Array) -> Array:
    """RMS errors, (n, 6), as shares of those of predicting the mean of the truth, (6,)."""
    spread = np.maximum(truth.std(axis=0), 1e-12)
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)) / spread)


def deviation_factor(errors: Array, std: Array) -> Array:
    """By how much believed deviations of images held out were too small, by dof; 1 at least."""
    if not len(errors):
        return np.full(6, _MOST_OPTIMISTIC)
    ratio = np.quantile(errors / std, 0.9, axis=0) / _NORMAL_QUANTILE_90
    return np.asarray(np.clip(ratio, 1.0, _MOST_OPTIMISTIC))


def _by_dof(values: Array) -> dict[str, float]:
    return dict(zip(DOFS, map(float, values), strict=True))
