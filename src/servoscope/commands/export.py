"""``servoscope export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from servoscope.commands.options import Force, Json
from servoscope.errors import InvalidInputError

Exportable = Positional[Annotated[Path, arg(metavar="SRC", help="Model folder.")]]
File = Positional[
    Annotated[Path, arg(metavar="FILE", help="File to write; its ending says of what format.")]
]


_MOST_COMPARED = 100


def export(
    src: Exportable,
    file: File,
    check: int = 20,
    dataset: Path | None = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a model, a trajectory or tables in a form that other programs read.

    A keyframe model becomes an ONNX file (.onnx): image in, displacement and deviation out, with
    a card beside it.

    Example: servoscope export model model.onnx

    Example: servoscope export model model.onnx --dataset cell --check 0

    Args:
        check: Rendered images on which the file is compared with the model, besides the
            reference; 0 for none.
        dataset: Data set on whose images it is compared as well, on 100 of many.
    """
    from servoscope.commands.output import print_facts

    if file.suffix != ".onnx":
        raise InvalidInputError(f"FILE must end in .onnx, got {file.name!r}.")
    print_facts(_export_model(src, file, check, dataset, force), as_json=json)


def _export_model(
    folder: Path, file: Path, check: int, dataset: Path | None, force: bool
) -> dict[str, object]:
    import numpy as np

    from servoscope.data.images import PoseImageSet
    from servoscope.export.onnx_model import describe, export_onnx
    from servoscope.keyframe.fitting import evenly_spread
    from servoscope.positioning.model import PositioningModel

    if check < 0:
        raise InvalidInputError(f"--check must be 0 or more, got {check}.")
    model = PositioningModel.load(folder)
    images = None
    if dataset is not None:
        own = PoseImageSet.load(dataset).images
        images = own[evenly_spread(np.arange(len(own)), _MOST_COMPARED)]
    return describe(export_onnx(model, file, images=images, n_check=check, force=force))
