"""An exported model under onnxruntime, which drives a robot as the model itself does."""

from __future__ import annotations

import io
import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from servoscope.dofs import check_dofs
from servoscope.errors import InvalidInputError, ModelError
from servoscope.positioning.interfaces import Array, Estimate, Image
from servoscope.positioning.workspace import Workspace
from servoscope.storage.reading import open_image_bytes, parse_json, read_bytes
from servoscope.wording import one_line

FACTS = ("dofs", "pivot", "reach", "least_similarity", "workspace")
"""What the file holds beside the graph, as JSON; the reference image is a PNG in hexadecimal."""

_ANYWHERE = 1e6
"""Sides of a workspace that are this far away, [m], are no limits; JSON has no infinity."""

REFERENCE = "reference_image"


def image_fact(image: Image) -> str:
    """An image as text: a PNG in hexadecimal."""
    png = io.BytesIO()
    PillowImage.fromarray(image).save(png, "PNG")
    return png.getvalue().hex()


def workspace_fact(workspace: Workspace) -> str:
    """A workspace as six numbers: the least x, y and z, and the greatest, [m].

    Examples
    --------
    >>> workspace_fact(Workspace.parse("x=300:700"))
    '[0.3, -1000000.0, -1000000.0, 0.7, 1000000.0, 1000000.0]'
    """
    sides = np.array([workspace.low, workspace.high]).clip(-_ANYWHERE, _ANYWHERE)
    return json.dumps(sides.ravel().tolist())


class OnnxEstimator:
    """An estimator for `servoscope.positioning.Positioner`, of one core.

    Parameters
    ----------
    file : path or bytes
        What `servoscope export` wrote, or its content.

    Raises
    ------
    ModelError
        If it is no such file.
    InvalidInputError
        If onnxruntime is not installed.

    Examples
    --------
    >>> from servoscope.positioning import Positioner
    >>> estimator = OnnxEstimator("model.onnx")  # doctest: +SKIP
    >>> result = Positioner(estimator).run(robot, camera)  # doctest: +SKIP
    """

    def __init__(self, file: str | PathLike[str] | bytes) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise InvalidInputError(
                "Running an exported model needs onnxruntime; install servoscope[export]."
            ) from error
        name = "The content" if isinstance(file, bytes) else str(file)
        content = file if isinstance(file, bytes) else read_bytes(Path(file), ModelError)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
            self.names = [output.name for output in self._session.get_outputs()]
            facts = self._session.get_modelmeta().custom_metadata_map
            known = {fact: parse_json(facts[fact].encode()) for fact in FACTS}
            self.dofs = check_dofs(known["dofs"])
            self.pivot, self._least = float(known["pivot"]), float(known["least_similarity"])
            self.reach: Array = np.array(known["reach"], dtype=float).reshape(6)
            sides = np.array(known["workspace"], dtype=float).reshape(2, 3)
            sides[np.abs(sides) >= _ANYWHERE] *= np.inf
            self.trained_on = {"workspace": Workspace(*map(tuple, sides.tolist())).corners()}
            with open_image_bytes(bytes.fromhex(facts[REFERENCE]), name, ModelError) as image:
                self.reference_image: Image = np.array(image.convert("L"))
        except Exception as error:  # onnxruntime raises of every kind on damaged files
            raise ModelError(
                f"{name} is not a model that servoscope exported ({one_line(error)}); export it "
                "again."
            ) from error

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the images that it takes, [px]."""
        height, width = self.reference_image.shape
        return height, width

    def outputs(self, image: Image) -> dict[str, NDArray[Any]]:
        """What the graph says of an image, by the name of the output."""
        return dict(zip(self.names, self._session.run(None, {"image": image}), strict=True))

    def estimate(self, image: Image, previous: Estimate | None = None) -> Estimate:
        """Where an image was taken; what came before makes no difference."""
        found = self.outputs(image)
        return Estimate(
            displacement=found["displacement"],
            std=found["deviation"],
            novelty=float(found["novelty"]),
            stage="keyframe",
            similarity=float(found["similarity"]),
            least_similarity=self._least,
        )
