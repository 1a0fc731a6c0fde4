"""What the service says: of images, of itself, and of what is wrong with a request."""

from __future__ import annotations

from threading import Lock
from time import perf_counter
from typing import Any

from servoscope import __version__
from servoscope.errors import DataSetError, InvalidInputError
from servoscope.formats.images import decode_bytes, to_eight_bits
from servoscope.poses import DOFS, displacements_from_poses
from servoscope.positioning.guard import image_format_fault
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.result import plain

LARGEST_BODY = 2**25
"""Most bytes of an image that is sent."""


class Answers:
    """A model that is asked by several at once; it looks at one image at a time.

    Parameters
    ----------
    model : PositioningModel
    bit_depth : int, optional
        Bits that the values of 16-bit images fill; without it these are refused, since what one
        image fills says nothing of the next.
    """

    def __init__(self, model: PositioningModel, bit_depth: int | None = None) -> None:
        self.model, self._bit_depth, self._looking = model, bit_depth, Lock()
        model.estimate(model.reference_image)  # what is computed once is ready for the first

    def estimate(self, content: bytes) -> dict[str, Any]:
        """What the model says of the bytes of an image file, as plain JSON values.

        Raises
        ------
        DataSetError
            If they are no image.
        InvalidInputError
            If the image is not of the size that the model takes.
        """
        import numpy as np

        try:
            levels = decode_bytes(content, "the body")
        except DataSetError as error:
            raise DataSetError(str(error).split("; ")[0].rstrip(".") + ".") from error
        if levels.dtype != np.uint8:
            if self._bit_depth is None:
                raise InvalidInputError(
                    "The image has 16 bits; serve with --bit-depth, or send 8 bits."
                )
            if int(levels.max()) >= 2**self._bit_depth:
                raise InvalidInputError(
                    f"The image has grey levels up to {levels.max()}, which {self._bit_depth} bits "
                    "do not hold; serve with another --bit-depth."
                )
            levels = to_eight_bits(levels, self._bit_depth)
        fault = image_format_fault(levels, self.model.image_shape)
        if fault is not None:
            raise InvalidInputError(fault)
        with self._looking:
            start = perf_counter()
            found = self.model.estimate(np.asarray(levels, np.uint8))
            seconds = perf_counter() - start
        six = displacements_from_poses(np.eye(4), found.displacement[None], self.model.pivot)[0]
        return {
            "is_recognised": found.is_recognised,
            "displacement": plain(found.displacement),
            "delta_p": plain(six),
            "std": plain(found.std),
            "similarity": plain(found.similarity),
            "least_similarity": plain(found.least_similarity),
            "novelty": plain(found.novelty),
            "seconds": seconds,
        }

    def health(self) -> dict[str, Any]:
        """What is served, as plain JSON values."""
        height, width = self.model.image_shape
        return {
            "status": "ok",
            "servoscope": __version__,
            "kind": self.model.kind,
            "image_size": [width, height],
            "dofs": list(self.model.dofs),
            "pivot": self.model.pivot,
            "reach": dict(zip(DOFS, self.model.reach.tolist(), strict=True)),
        }
