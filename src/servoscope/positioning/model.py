"""The trained model: where an image was taken, coarse to fine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import ModelError
from servoscope.poses import poses_from_displacements
from servoscope.positioning.alignment import Alignment
from servoscope.positioning.interaction import LearnedInteraction
from servoscope.positioning.interfaces import Array, Estimate, Image
from servoscope.positioning.model_folder import read_model, write_model

Folder = str | PathLike[str]

_HOLD = 0.8
"""A level that answered before is asked first again, and heard if less than this of its radius."""


@dataclass(frozen=True, eq=False)
class LevelEstimate(Estimate):
    """What a level says.

    Parameters
    ----------
    level : int
        Its number, 0 for the widest.
    """

    level: int = 0


@dataclass(frozen=True, eq=False)
class PositioningModel:
    """Turns images into displacements from the reference, as it was trained to.

    Parameters
    ----------
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
        widest begins. Each answer is the first guess of the next narrower level, until it lies
        beyond that level's radius.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        previous : Estimate, optional
            Of the image before.

        Returns
        -------
        LevelEstimate
        """
        last = len(self.levels) - 1
        if isinstance(previous, LevelEstimate) and previous.level > 0:
            level = self.levels[min(previous.level, last)]
            alignment = level.align(image, np.zeros(6))
            if np.abs(alignment.p).max() < _HOLD and _is_alike(level, alignment):
                return self._narrowed(image, previous.level, alignment)
        return self._narrowed(image, 0, self._widest(image))

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
            "levels": [level.describe() for level in self.levels],
            "trained_on": self.trained_on,
            "accuracy": self.accuracy,
        }
        arrays = {"reference_image": self.reference_image}
        for k, level in enumerate(self.levels):
            arrays |= {f"level{k}/{name}": array for name, array in level.to_arrays().items()}
        write_model(folder, header, arrays, force=force)

    @classmethod
    def load(cls, folder: Folder) -> PositioningModel:
        """Read a model; nothing in the folder is executed.

        Raises
        ------
        ModelError
            If it is missing, damaged, of a newer version, or not a positioning model.
        """
        header, arrays = read_model(folder)
        try:
            levels = [
                LearnedInteraction.restore(description, _within(arrays, f"level{k}/"))
                for k, description in enumerate(header["levels"])
            ]
            model = cls(
                levels,
                arrays["reference_image"],
                float(header["pivot"]),
                np.array(header["reach"], dtype=float),
                dict(header["trained_on"]),
                dict(header["accuracy"]),
            )
            _check(model, header)
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(
                f"{folder} is not a model for positioning ({error}); train it again."
            ) from error
        return model

    def _widest(self, image: Image) -> Alignment:
        return self.levels[0].align(image, np.zeros(6))

    def _narrowed(self, image: Image, start: int, alignment: Alignment) -> LevelEstimate:
        """The answer of the narrowest level that it leads to."""
        number, level = start, self.levels[start]
        for narrower in self.levels[start + 1 :]:
            p = level.displacement(alignment)
            if np.abs(p).max() > narrower.radius:
                break
            closer = narrower.align(image, p)
            if np.abs(closer.p).max() > 1.25 or not _is_alike(narrower, closer):
                break
            number, level, alignment = number + 1, narrower, closer
        delta_p = level.displacement(alignment) * self.reach
        return LevelEstimate(
            displacement=poses_from_displacements(np.eye(4), delta_p[None], self.pivot)[0],
            std=level.std(alignment) * self.reach,
            novelty=alignment.unlikeness / level.unlikeness_limit,
            stage=f"level {number + 1} of {len(self.levels)}",
            is_finest=number == len(self.levels) - 1,
            level=number,
        )


def _within(arrays: Mapping[str, NDArray], prefix: str) -> dict[str, NDArray]:
    return {name[len(prefix) :]: a for name, a in arrays.items() if name.startswith(prefix)}


def _check(model: PositioningModel, header: Mapping[str, Any]) -> None:
    """Raise ValueError if the parts of a model do not belong together."""
    image, reach = model.reference_image, model.reach
    if image.dtype != np.uint8 or list(image.shape) != list(header["image_size"]):
        raise ValueError("its reference image is not of its image size")
    if reach.shape != (6,) or not (np.isfinite(reach) & (reach > 0)).all():
        raise ValueError("its reach is not six positive numbers")
    if not model.levels or not np.isfinite(model.pivot):
        raise ValueError("it has no levels, or no pivot")


def _is_alike(level: LearnedInteraction, alignment: Alignment) -> bool:
    return alignment.unlikeness <= level.unlikeness_limit
