"""A trained model of whatever kind: where an image was taken, relative to the reference."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from os import PathLike
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from servoscope.dofs import check_dofs
from servoscope.errors import ModelError
from servoscope.poses import DOFS
from servoscope.positioning.interfaces import Array, Estimate, Image
from servoscope.storage.model_folder import read_model, write_model
from servoscope.wording import one_line

Folder = str | PathLike[str]


@dataclass(frozen=True, eq=False)
class PositioningModel(ABC):
    """Reads displacements of images, and knows how accurately.

    Parameters
    ----------
    reach : ndarray of shape (6,)
        Largest displacements about the pivot that it was made for, [m] and [rad]; 0 for dofs that
        are not read.
    trained_on : dict
        Where its images come from, as plain JSON values.
    accuracy : dict
        What was found on images that were held out, as plain JSON values.
    dofs : tuple of str
        The degrees of freedom that are commanded.
    """

    kind: ClassVar[str]

    _: KW_ONLY
    reach: Array
    trained_on: dict[str, Any] = field(default_factory=dict)
    accuracy: dict[str, Any] = field(default_factory=dict)
    dofs: tuple[str, ...] = DOFS

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the images that it takes, [px]."""
        height, width = self.reference_image.shape
        return height, width

    @property
    @abstractmethod
    def reference_image(self) -> Image:
        """The view to bring the camera back to, uint8."""

    @property
    @abstractmethod
    def pivot(self) -> float:
        """Distance along z of the point that displacements are taken about, [m]."""

    @abstractmethod
    def estimate(self, image: Image, previous: Estimate | None = None) -> Estimate:
        """Where an image was taken.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        previous : Estimate, optional
            Of the image before.
        """

    @abstractmethod
    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """What reads images, as arrays of numbers."""

    @classmethod
    @abstractmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], **known: Any) -> Self:
        """The model of its arrays and of its other parameters.

        Raises
        ------
        ValueError, KeyError, TypeError
            If they are not those of a model of this kind.
        """

    def save(self, folder: Folder, *, force: bool = False) -> None:
        """Write the model to a folder of its own, whole or not at all.

        Raises
        ------
        FolderExistsError
            If the folder holds something, unless it is a model and `force` is set.
        """
        header = {
            "kind": self.kind,
            "image_size": list(self.image_shape),
            "pivot": self.pivot,
            "reach": self.reach.tolist(),
            "dofs": list(self.dofs),
            "trained_on": self.trained_on,
            "accuracy": self.accuracy,
        }
        write_model(folder, header, self.to_arrays(), force=force)

    @staticmethod
    def load(folder: Folder) -> PositioningModel:
        """Read a model of whatever kind; nothing in the folder is executed.

        Raises
        ------
        ModelError
            If it is missing, damaged, of a newer version, or not a positioning model.
        """
        header, arrays = read_model(folder)
        try:
            return _restored(header, arrays)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise ModelError(
                f"{folder} is not a model for positioning ({one_line(error, 300)}); train it again."
            ) from error


def _restored(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> PositioningModel:
    kind: type[PositioningModel]
    match header.get("kind"):  # each brings libraries that the other does without
        case "keyframe":
            from servoscope.positioning.keyframe_model import KeyframeModel as kind
        case "features":
            from servoscope.positioning.feature_model import FeatureModel as kind
        case _:
            raise ValueError("it is not of the kinds keyframe, features")
    reach = np.array(header["reach"], dtype=float)
    if reach.shape != (6,) or not (np.isfinite(reach) & (reach >= 0)).all():
        raise ValueError("its reach is not six numbers, 0 or more")
    model = kind.from_arrays(
        arrays,
        reach=reach,
        trained_on=dict(header["trained_on"]),
        accuracy=dict(header["accuracy"]),
        dofs=check_dofs(header.get("dofs", DOFS)),  # models were of all six before they said so
    )
    if list(model.image_shape) != list(header["image_size"]):
        raise ValueError("its reference image is not of its image size")
    return model
