"""A positioning model of twenty to sixty images: the reference view as a keyframe."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.data.independence import independent_groups
from servoscope.data.splits import Split
from servoscope.dofs import check_dofs, mask_of, moving_dofs
from servoscope.errors import DataSetError, InvalidInputError
from servoscope.keyframe import Alignment, Keyframe, Readings, read_held_out
from servoscope.keyframe.alignment import CLEARLY_ALIKE
from servoscope.keyframe.fitting import evenly_spread
from servoscope.poses import (
    DOFS,
    inverse_transform,
    poses_from_displacements,
)
from servoscope.positioning.accuracy import check_use, describe_errors, deviation_factor, read_right
from servoscope.positioning.calibration import Calibration
from servoscope.positioning.first_guess import FirstGuess
from servoscope.positioning.interfaces import Array, Estimate, Image
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.recognition import (
    LEAST_SIMILARITY,
    Recognition,
    chance_similarity,
    least_similarity,
    recogniser,
)

RESIDUAL = "held_out_residual"
"""The array of a model folder that holds the residuals of images held out, by pixel."""

NOT_SEEN = -1.0
"""The residual of a pixel that no image held out shows."""

LEAST_IMAGES = 15
"""Images that a model needs, so that some can be held out."""

MOST_FITTED, MOST_READ = 40, 40
"""Images of a split that a keyframe is fitted to, and that it reads, at most."""

_MOST_IMAGES = 90
FARTHEST = np.repeat([2.0, 1.5], 3)
"""Shares of the reach beyond which nothing is read, by dof; a part that is turned is another."""

_N_GROUPS = 3


class HeldOutReadings(NamedTuple):
    """What keyframes read of images held out.

    Parameters
    ----------
    readings : Readings
        With `recogniser` for the similarity.
    truth : ndarray of shape (n, 6)
        The displacements of the images about the pivot, [m] and [rad].
    n_groups : int, optional
        Of how many groups that are independent of each other the images are.
    """

    readings: Readings
    truth: Array
    n_groups: int | None = None


@dataclass(frozen=True, eq=False)
class KeyframeModel(PositioningModel):
    """Reads displacements by warping the reference image onto what is seen.

    The parameters below, and those of `PositioningModel`.

    Parameters
    ----------
    keyframe : Keyframe
    residual : ndarray of shape (rows, columns), float32, optional
        Residuals of images held out, by pixel of the reference image, in multiples of the noise;
        negative where none shows it.
    first_guess : FirstGuess, optional
        Where the search begins.
    """

    kind: ClassVar[str] = "keyframe"

    keyframe: Keyframe
    residual: NDArray[np.float32] | None = None
    first_guess: FirstGuess | None = None

    @property
    def reference_image(self) -> Image:
        """The view to bring the camera back to, uint8."""
        return self.keyframe.reference_image

    @property
    def pivot(self) -> float:
        """Distance along z of the point that displacements are taken about, [m]."""
        return self.keyframe.pivot

    @property
    def least_similarity(self) -> float:
        """The similarity below which an image is of something else."""
        return float(self.accuracy.get("least_similarity", LEAST_SIMILARITY))

    @classmethod
    def train(
        cls,
        data: PoseImageSet,
        *,
        held_out: HeldOutReadings | None = None,
        calibration: Calibration | None = None,
        n_jobs: int | None = -1,
        on_progress: Callable[[int], object] | None = None,
    ) -> KeyframeModel:
        """A model from images spread over the range that is to be covered.

        Parameters
        ----------
        data : PoseImageSet
        held_out : HeldOutReadings, optional
            What its accuracy is taken from; by default each third of the images is read by a
            keyframe that is fitted without it.
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
            If there are too few images, no keyframe explains them, or those held out are read no
            better than by their mean in most dofs.
        """
        if len(data) < LEAST_IMAGES:
            raise DataSetError(
                f"A model needs at least {LEAST_IMAGES} images, got {len(data)}; take 40, spread "
                "over the range that is to be covered."
            )
        tell = on_progress or (lambda _: None)
        shown = data.subset(np.unique(np.linspace(0, len(data) - 1, _MOST_IMAGES).astype(int)))
        taken = shown.images, shown.T_world_cam
        reference = shown.reference_image, shown.T_world_ref
        options = keyframe_options(data, calibration)
        try:
            if held_out is None:
                groups = independent_groups(shown, _N_GROUPS).labels
                held = groups >= 0
                readings = read_held_out(
                    taken[0][held], taken[1][held], *reference, groups[held],
                    similarity_by=recogniser, n_jobs=n_jobs, **options,
                )  # fmt: skip
                held_out = HeldOutReadings(readings, shown.delta_p()[held])
            errors, truth = held_out.readings.errors, held_out.truth
            check_use(describe_errors(errors, truth, data.dofs, data.ranges())["error_shares"])
            tell(1)
            keyframe = Keyframe.fit(*taken, *reference, **options)
            tell(2)
        except InvalidInputError as error:
            raise DataSetError(f"No keyframe can be fitted: {error}") from error
        model = cls.of_readings(keyframe, data, shown, *held_out)
        displacements = inverse_transform(data.T_world_ref) @ shown.T_world_cam
        first_guess = FirstGuess.train(model.keyframe, model.reach, shown.images, displacements)
        tell(3)
        return replace(model, first_guess=first_guess)

    @classmethod
    def of_readings(
        cls,
        keyframe: Keyframe,
        data: PoseImageSet,
        fitted: PoseImageSet,
        readings: Readings,
        truth: Array,
        n_groups: int | None = None,
    ) -> KeyframeModel:
        """A model of a keyframe and what it reads of other images, without first guesses.

        Parameters
        ----------
        keyframe : Keyframe
        data : PoseImageSet
            Whose range is covered.
        fitted : PoseImageSet
            Those of its images that the keyframe was fitted to.
        readings, truth, n_groups
            As of `HeldOutReadings`, by this keyframe or others.
        """
        is_read, is_commanded = mask_of(keyframe.dofs), mask_of(data.dofs)
        errors, reach = np.abs(readings.errors) * is_read, np.where(is_read, data.ranges(), 0.0)
        right = read_right(errors * is_commanded, reach)
        factor = np.ones(6)
        factor[is_read] = deviation_factor(
            errors[right][:, is_read], readings.std[right][:, is_read]
        )
        noise = data.image_noise or keyframe.noise * least_noise_share(readings)
        keyframe = replace(keyframe, model_error=factor * keyframe.model_error, noise=noise)
        chance = chance_similarity(keyframe, fitted.images, FARTHEST * reach)
        within = (errors <= 2 * factor * readings.std)[:, is_commanded]
        accuracy = {
            **describe_errors(readings.errors, truth, data.dofs, reach, n_groups),
            "within_2_std": float(np.mean(within)),
            "similarity": float(np.median(readings.similarity)),
            "chance_similarity": chance,
            "least_similarity": least_similarity(readings.similarity[right], chance),
            "n_images": len(fitted),
            "residual": keyframe.residual,
            "residual_over_noise": readings.residual_over_noise,
            "noise": keyframe.noise,
            **({"observable": keyframe.observable} if keyframe.dofs == DOFS else {}),
        }
        residual = np.nan_to_num(readings.residual_map / readings.noise, nan=NOT_SEEN)
        return cls(
            keyframe,
            residual.astype(np.float32),
            reach=reach,
            trained_on=dict(data.source),
            accuracy=accuracy,
            dofs=data.dofs,
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
        """What of an alignment the robot can undo; nothing is believed of other dofs."""
        displacement, std, is_commanded = found.displacement, found.std, mask_of(self.dofs)
        if self.dofs != DOFS:
            delta_p = np.where(is_commanded, found.delta_p, 0.0)
            displacement = poses_from_displacements(np.eye(4), delta_p, self.pivot)
            std = np.where(is_commanded, std, np.nan)
        shares = found.delta_p / np.where(self.reach > 0, FARTHEST * self.reach, 1.0)
        return Estimate(
            displacement=displacement,
            std=std,
            novelty=float(np.max(np.abs(shares))),
            stage="keyframe",
            similarity=self.recognition.similarity(image, found.displacement),
            least_similarity=self.least_similarity,
        )

    @cached_property
    def recognition(self) -> Recognition:
        """What compares images with what is expected."""
        return Recognition(self.keyframe)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """What reads images, as arrays of numbers."""
        parts = {"keyframe": self.keyframe.to_arrays()}
        if self.first_guess is not None:
            parts["first_guess"] = self.first_guess.to_arrays()
        arrays = {
            f"{part}/{name}": array for part, own in parts.items() for name, array in own.items()
        }
        return arrays if self.residual is None else {**arrays, RESIDUAL: self.residual}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], **known: Any) -> Self:
        """The model of its arrays and of its other parameters.

        Raises
        ------
        ValueError, KeyError, TypeError
            If they are not those of a model of this kind.
        """
        parts, reach, dofs = parts_of(arrays), known["reach"], known["dofs"]
        keyframe = Keyframe.from_arrays(parts["keyframe"])
        if ((reach > 0) != mask_of(keyframe.dofs)).any() or not set(dofs) <= set(keyframe.dofs):
            raise ValueError("its dofs are not those of its reach and its keyframe")
        if not 0 <= float(known["accuracy"].get("least_similarity", 0)) <= 1:
            raise ValueError("its least similarity is not between 0 and 1")
        first_guess = None
        if parts["first_guess"]:
            shape = keyframe.reference_image.shape
            first_guess = FirstGuess.from_arrays(parts["first_guess"], shape, reach, keyframe.pivot)
        return cls(keyframe, arrays.get(RESIDUAL), first_guess, **known)


def keyframe_options(data: PoseImageSet, calibration: Calibration | None = None) -> dict[str, Any]:
    """The options of `Keyframe.fit` for a data set."""
    options = (calibration or Calibration()).options(is_sequence=data.split == "blocks")
    options["pivot"], options["noise"] = data.pivot, data.image_noise
    options["dofs"] = check_dofs({*data.dofs, *moving_dofs(data.delta_p(), data.pivot)})
    return options


def fit_and_read(
    data: PoseImageSet,
    fitted: NDArray[np.intp],
    read: NDArray[np.intp],
    calibration: Calibration | None = None,
) -> tuple[Keyframe, Readings]:
    """A keyframe of some images, and what it reads of others, with `recogniser`."""
    keyframe = Keyframe.fit(
        data.images[fitted],
        data.T_world_cam[fitted],
        data.reference_image,
        data.T_world_ref,
        **keyframe_options(data, calibration),
    )
    readings = Readings.of(
        keyframe, data.images[read], data.T_world_cam[read], data.T_world_ref, recogniser
    )
    return keyframe, readings


def read_test_images(
    data: PoseImageSet,
    split: Split,
    groups: NDArray[np.intp],
    calibration: Calibration | None = None,
) -> HeldOutReadings:
    """What a keyframe of the images of a split that are learned from reads of its test images.

    Parameters
    ----------
    data : PoseImageSet
    split : Split
    groups : ndarray of shape (n_images,)
        Images of a group are not independent of each other.
    calibration : Calibration, optional

    Raises
    ------
    DataSetError
        If no keyframe explains the images.
    """
    fitted, read = evenly_spread(split.learned, MOST_FITTED), evenly_spread(split.test, MOST_READ)
    try:
        _, readings = fit_and_read(data, fitted, read, calibration)
    except InvalidInputError as error:
        raise DataSetError(f"No keyframe can be fitted: {error}") from error
    return HeldOutReadings(readings, data.delta_p()[read], len(np.unique(groups[read])))


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


def least_noise_share(readings: Readings) -> float:
    """Share of the noise that is left where images are explained better than it allows.

    Noise is found in the smoothest blocks of the images. Where texture is everywhere it is taken
    for noise, but an image of more noise than its residual there cannot be.
    """
    seen = readings.residual[np.isfinite(readings.residual)]
    if not len(seen) or not readings.noise > 0:
        return 1.0
    return float(np.clip(np.quantile(seen, 0.1) / readings.noise, 0.1, 1.0))
