"""The trained model: where an image was taken, coarse to fine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import ModelError
from servoscope.poses import DOFS, poses_from_displacements
from servoscope.positioning.alignment import Alignment
from servoscope.positioning.interaction import MARGIN, LearnedInteraction
from servoscope.positioning.interfaces import Array, Estimate, Image
from servoscope.positioning.keyframe_model import KIND, KeyframeModel
from servoscope.positioning.pose_networks import PoseNetworks
from servoscope.storage.model_folder import read_model, write_model

Folder = str | PathLike[str]

_HOLD = 0.8
"""A level that answered before is asked first again, and heard if less than this of its radius."""

_TRUST = 3.0
"""The widest level is believed as far from the networks as this many of their RMS errors."""

_CERTAIN = 0.98
"""The widest level is believed however far from the networks, where its similarity is this."""


@dataclass(frozen=True, eq=False)
class LevelEstimate(Estimate):
    """What a level says.

    Parameters
    ----------
    level : int
        Its number, 0 for the widest.
    p : ndarray of shape (6,)
        The displacement about the pivot in shares of the reach.
    """

    level: int = 0
    p: Array = field(default_factory=lambda: np.zeros(6))


@dataclass(frozen=True, eq=False)
class PositioningModel:
    """Turns images into displacements from the reference, as it was trained to.

    Parameters
    ----------
    networks : PoseNetworks
        That make the first guess.
    levels : sequence of LearnedInteraction
        Widest first.
    reference_image : ndarray of shape (height, width), uint8
    pivot : float
        [m].
    reach : ndarray of shape (6,)
        Largest displacements about the pivot that it was trained on, [m] and [rad].
    trained_on : dict
        Where its images come from, as plain JSON values.
    accuracy : dict
        What training found on images that it held out, as plain JSON values.
    """

    networks: PoseNetworks
    levels: Sequence[LearnedInteraction]
    reference_image: Image
    pivot: float
    reach: Array
    trained_on: dict[str, Any] = field(default_factory=dict)
    accuracy: dict[str, Any] = field(default_factory=dict)

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the images that it takes, [px]."""
        height, width = self.reference_image.shape
        return height, width

    def estimate(self, image: Image, previous: Estimate | None = None) -> LevelEstimate:
        """Where an image was taken.

        The level that answered for the image before is asked first. Where it is not content, the
        networks make a first guess and the widest level betters it. Each answer is the first
        guess of the next narrower level, until it surely lies beyond that level's radius.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        previous : Estimate, optional
            Of the image before.

        Returns
        -------
        LevelEstimate
        """
        if isinstance(previous, LevelEstimate) and 0 < previous.level < len(self.levels):
            level = self.levels[previous.level]
            alignment = level.align(image, np.zeros(6))
            if np.abs(alignment.p).max() < _HOLD and level.is_alike(alignment):
                return self._narrowed(image, self._answer(previous.level, alignment))
        return self._narrowed(image, self._first_answer(image))

    def _first_answer(self, image: Image) -> LevelEstimate:
        """The widest level's answer, or the networks' if that is far from theirs."""
        guess = np.clip(self.networks.predict(image[None])[0] / self.reach, -1.0, 1.0)
        doubt = self.networks.doubt / self.reach
        level = self.levels[0]
        alignment = level.align(image, guess)
        answer = self._answer(0, alignment)
        is_near = (np.abs(level.displacement(alignment) - guess) <= _TRUST * doubt).all()
        if is_near or alignment.similarity >= _CERTAIN:
            return answer
        return replace(
            answer,
            displacement=self._displacement(guess),
            std=self.networks.doubt,
            stage="networks",
            is_finest=False,
            p=guess,
        )

    def _narrowed(self, image: Image, answer: LevelEstimate) -> LevelEstimate:
        """The answer of the narrowest level that an answer leads to."""
        for number in range(answer.level + 1, len(self.levels)):
            level = self.levels[number]
            surely = np.abs(answer.p) - 2 * answer.std / self.reach
            if surely.max() > level.radius:
                break
            alignment = level.align(image, answer.p)
            if np.abs(alignment.p).max() > MARGIN or not level.is_alike(alignment):
                break
            answer = self._answer(number, alignment)
        return answer

    def _answer(self, number: int, alignment: Alignment) -> LevelEstimate:
        level = self.levels[number]
        p = level.displacement(alignment)
        return LevelEstimate(
            displacement=self._displacement(p),
            std=level.std(alignment) * self.reach,
            novelty=alignment.unlikeness / level.unlikeness_limit,
            stage=f"level {number + 1} of {len(self.levels)}",
            is_finest=number == len(self.levels) - 1,
            similarity=alignment.similarity,
            level=number,
            p=p,
        )

    def _displacement(self, p: Array) -> Array:
        return poses_from_displacements(np.eye(4), p * self.reach, self.pivot)

    def save(self, folder: Folder, *, force: bool = False) -> None:
        """Write the model to a folder of its own, whole or not at all.

        Raises
        ------
        FolderExistsError
            If the folder holds something, unless it is a model and `force` is set.
        """
        height, width = self.image_shape
        header = {
            "image_size": [height, width],
            "pivot": self.pivot,
            "reach": self.reach.tolist(),
            "dofs": list(DOFS),
            "levels": [level.describe() for level in self.levels],
            "trained_on": self.trained_on,
            "accuracy": self.accuracy,
        }
        texts, arrays = _apart(self.networks.to_arrays())
        header["networks"] = texts
        arrays["reference_image"] = self.reference_image
        for k, level in enumerate(self.levels):
            arrays |= {f"level{k}/{name}": array for name, array in level.to_arrays().items()}
        write_model(folder, header, arrays, force=force)

    @classmethod
    def load(cls, folder: Folder) -> PositioningModel | KeyframeModel:
        """Read a model of whatever kind; nothing in the folder is executed.

        Raises
        ------
        ModelError
            If it is missing, damaged, of a newer version, or not a positioning model.
        """
        header, arrays = read_model(folder)
        try:
            if header.get("kind") == KIND:
                return KeyframeModel.restore(header, arrays)
            levels = [
                LearnedInteraction.restore(description, _within(arrays, f"level{k}/"))
                for k, description in enumerate(header["levels"])
            ]
            texts = {name: np.array(text) for name, text in header["networks"].items()}
            model = cls(
                PoseNetworks.from_arrays(_within(arrays, "networks/") | texts),
                levels,
                arrays["reference_image"],
                float(header["pivot"]),
                np.array(header["reach"], dtype=float),
                dict(header["trained_on"]),
                dict(header["accuracy"]),
            )
            _check(model, header)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            reason = " ".join(str(error).split())[:300]
            raise ModelError(
                f"{folder} is not a model for positioning ({reason}); train it again."
            ) from error
        return model


def _apart(arrays: Mapping[str, NDArray]) -> tuple[dict[str, Any], dict[str, NDArray]]:
    """Arrays of text as plain values, and those of numbers."""
    texts = {name: array.tolist() for name, array in arrays.items() if array.dtype.kind in "UO"}
    return texts, {f"networks/{n}": array for n, array in arrays.items() if n not in texts}


def _within(arrays: Mapping[str, NDArray], prefix: str) -> dict[str, NDArray]:
    return {name[len(prefix) :]: a for name, a in arrays.items() if name.startswith(prefix)}


def _check(model: PositioningModel, header: Mapping[str, Any]) -> None:
    """Raise ValueError if the parts of a model do not belong together."""
    image, reach = model.reference_image, model.reach
    is_grey = image.dtype == np.uint8 and image.ndim == 2
    if not is_grey or list(image.shape) != list(header["image_size"]):
        raise ValueError("its reference image is not of its image size")
    if reach.shape != (6,) or not (np.isfinite(reach) & (reach > 0)).all():
        raise ValueError("its reach is not six positive numbers")
    if not model.levels or not np.isfinite(model.pivot):
        raise ValueError("it has no levels, or no pivot")
    shapes = [level.appearance.shape(model.image_shape) for level in model.levels]
    if shapes != [level.model.shape for level in model.levels]:
        raise ValueError("its levels are not of its image size")
