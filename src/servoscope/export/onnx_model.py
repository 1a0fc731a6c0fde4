"""Models as ONNX files: image in, displacement and deviation out."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope import __version__
from servoscope.errors import FolderExistsError, InvalidInputError, ModelError
from servoscope.export.agreement import LEAST_TOLERANCE, Agreement
from servoscope.export.card import model_card
from servoscope.export.feature_model import estimate_of_features
from servoscope.export.graph import Graph
from servoscope.export.keyframe import KeyframeGraph
from servoscope.export.onnx_estimator import (
    REFERENCE,
    OnnxEstimator,
    image_fact,
    workspace_fact,
)
from servoscope.positioning.feature_model import FeatureModel
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.settings import LoopSettings
from servoscope.storage.folders import write_atomically, write_text

OUTPUTS: dict[str, tuple[int, ...]] = {
    "displacement": (4, 4),
    "correction": (4, 4),
    "delta_p": (6,),
    "deviation": (6,),
    "similarity": (),
    "novelty": (),
    "is_recognised": (),
}
"""The outputs of an exported model, and their shapes."""

DIFFERENT = 0.1
"""Shares of the tolerance beyond which an export is no copy of the model."""


@dataclass(frozen=True)
class Exported:
    """What an export wrote.

    Parameters
    ----------
    path, card : Path
    fingerprint : str
        SHA-256 of the file.
    size_mb : float
    agreement : Agreement or None
        With the model that it was made of; None if that was not checked.
    """

    path: Path
    card: Path
    fingerprint: str
    size_mb: float
    agreement: Agreement | None


def to_onnx(model: PositioningModel) -> bytes:
    """The content of an ONNX file that estimates as a model does without an image before.

    Parameters
    ----------
    model : KeyframeModel or FeatureModel

    Raises
    ------
    InvalidInputError
        If onnx is not installed.
    ModelError
        If the model has no ONNX form: one line says what of it has none.
    """
    try:
        import onnx  # noqa: F401
    except ImportError as error:
        raise InvalidInputError(
            "Exporting needs onnx and onnxruntime; install servoscope[export]."
        ) from error
    graph = Graph()
    image = graph.input("image", np.uint8)
    if isinstance(model, KeyframeModel):
        found, reads = KeyframeGraph(graph, model, image).estimate(), model.keyframe.dofs
    elif isinstance(model, FeatureModel):
        found, reads = estimate_of_features(graph, model, image), model.dofs
    else:
        raise ModelError(
            f"Models of {model.kind} have no ONNX form; train a keyframe, or use servoscope serve."
        )
    outputs = [(name, found[name], shape) for name, shape in OUTPUTS.items()]
    facts = {
        "servoscope": __version__,
        "reads": json.dumps(list(reads)),
        "dofs": json.dumps(list(model.dofs)),
        "pivot": json.dumps(model.pivot),
        "reach": json.dumps(model.reach.tolist()),
        "least_similarity": json.dumps(getattr(model, "least_similarity", 0.0)),
        "tolerance": json.dumps(LEAST_TOLERANCE.tolist()),
        "workspace": workspace_fact(LoopSettings().robot_box(model)),
        "units": json.dumps("m, rad"),
        REFERENCE: image_fact(model.reference_image),
    }
    proto = graph.to_model("servoscope", [(image, model.image_shape)], outputs, facts)
    return bytes(proto.SerializeToString(deterministic=True))


def export_onnx(
    model: PositioningModel,
    path: Path | str,
    *,
    images: NDArray[np.uint8] | None = None,
    n_check: int = 20,
    force: bool = False,
) -> Exported:
    """Write a model as an ONNX file with a card beside it, once both are seen to agree.

    Parameters
    ----------
    model : KeyframeModel or FeatureModel
    path : path
        Of the file; the card is beside it, named as it with ``.md`` added.
    images : ndarray of shape (n, height, width), uint8, optional
        Real ones, on which both are compared as well.
    n_check : int
        On how many images made of the reference both are compared, besides it; 0 compares on
        `images` alone, and not at all if there are none.
    force : bool
        Replace a file that is there.

    Raises
    ------
    ModelError
        If the model has no ONNX form, or the graph does not estimate as it does.
    FolderExistsError
        If the file is there and `force` is not set.
    InvalidInputError
        If onnx or onnxruntime is not installed, or the images are not as large as the reference.
    """
    path = Path(path)
    if n_check < 0:
        raise InvalidInputError(f"n_check must be 0 or more, got {n_check}.")
    if path.exists() and not force:
        raise FolderExistsError(f"{path} is there already; name another file, or use --force.")
    content, agreement = to_onnx(model), None
    if n_check or images is not None:
        estimator = OnnxEstimator(content)
        agreement = Agreement.between(model, estimator, images, n_check)
        if agreement.worst_share > DIFFERENT:
            raise ModelError(
                f"The graph differs from the model by up to {agreement.worst_share:.3g} of the "
                f"tolerance, on {agreement.n_images} images; nothing is written. Please report it, "
                "with the model."
            )
    fingerprint = hashlib.sha256(content).hexdigest()
    card = path.with_name(f"{path.name}.md")
    size = 1e-6 * len(content)
    write_atomically(path, lambda file: file.write(content))
    write_text(card, model_card(model, path.name, OUTPUTS, fingerprint, size, agreement))
    return Exported(path, card, fingerprint, round(size, 3), agreement)


def describe(exported: Exported) -> dict[str, Any]:
    """What was written, as plain JSON values."""
    facts: dict[str, Any] = {
        "file": str(exported.path),
        "card": str(exported.card),
        "size_mb": exported.size_mb,
        "sha256": exported.fingerprint,
    }
    if exported.agreement is not None:
        facts["agreement"] = exported.agreement.to_dict()
    return facts
