"""``servoscope export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from servoscope.commands.options import Force, Json
from servoscope.errors import FolderExistsError, InvalidInputError

Exportable = Positional[
    Annotated[Path, arg(metavar="SRC", help="Folder of a model, a data set, a log or a run.")]
]
File = Positional[
    Annotated[Path, arg(metavar="FILE", help="File to write; its ending says of what kind.")]
]

TABLES = (".csv", ".tex", ".md")
"""Endings of files of tables."""

_MOST_COMPARED = 100


def export(
    src: Exportable,
    file: File,
    format: Literal["tum", "kitti"] = "tum",
    check: int = 20,
    dataset: str | None = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a model, a trajectory or tables in a form that other programs read.

    A model becomes an ONNX file (.onnx): image in, displacement and deviation out, with a
    card beside it. The poses of a data set, or those at which a robot looked in a run of position
    (--log), become a trajectory (.txt). The tables of a run become CSV (.csv; further tables in
    files with a number), LaTeX (.tex) or Markdown (.md).

    Example: servoscope export model model.onnx

    Example: servoscope export model model.onnx --dataset cell --check 0

    Example: servoscope export cell trajectory.txt --format kitti

    Example: servoscope export servoscope-study tables.csv

    Args:
        format: Of a trajectory: a stamp, position and quaternion (x y z w) in a row, or the upper
            three rows of the matrix.
        check: Rendered images on which an ONNX file is compared with its model, besides the
            reference; 0 for none.
        dataset: Data set on whose images it is compared as well, on 100 of many.
    """
    from servoscope.commands.output import print_facts

    if check < 0:
        raise InvalidInputError(f"--check must be 0 or more, got {check}.")
    if file.suffix == ".onnx":
        facts = _export_model(src, file, check, dataset, force)
    elif file.suffix == ".txt":
        facts = _export_trajectory(src, file, format, force)
    elif file.suffix in TABLES:
        facts = _export_tables(src, file, force)
    else:
        raise InvalidInputError(
            f"FILE must end in .onnx (a model), .txt (a trajectory) or {', '.join(TABLES)} "
            f"(tables), got {file.name!r}."
        )
    print_facts(facts, as_json=json)


def _export_model(
    folder: Path, file: Path, check: int, dataset: str | None, force: bool
) -> dict[str, Any]:
    import numpy as np

    from servoscope.data.images import PoseImageSet
    from servoscope.export.onnx_model import describe, export_onnx
    from servoscope.keyframe.fitting import evenly_spread
    from servoscope.positioning.model import PositioningModel

    model = PositioningModel.load(folder)
    images = None
    if dataset is not None:
        own = PoseImageSet.load(dataset).images
        images = own[evenly_spread(np.arange(len(own)), _MOST_COMPARED)]
    return describe(export_onnx(model, file, images=images, n_check=check, force=force))


def _export_trajectory(src: Path, file: Path, form: str, force: bool) -> dict[str, Any]:
    from servoscope.data.images import PoseImageSet
    from servoscope.export.trajectory import poses_of_data, poses_of_log, write_trajectory

    _check_free([file], force)
    is_log = (src / "run.json").exists()
    poses = poses_of_log(src) if is_log else poses_of_data(PoseImageSet.load(src))
    write_trajectory(file, poses, form)
    stamps = "as recorded" if poses.is_timed else "numbers from 0, since no times are known"
    facts = {"file": str(file), "format": form, "poses": len(poses.times)}
    return {**facts, "stamps": stamps} if form == "tum" else facts


def _export_tables(run: Path, file: Path, force: bool) -> dict[str, Any]:
    from servoscope.commands.run_tables import tables_of
    from servoscope.report.table import write_tables
    from servoscope.storage.folders import write_text

    tables = tables_of(run)
    if file.suffix != ".csv":
        _check_free([file], force)
        write_tables(file, tables)
        return {"file": str(file), "tables": len(tables)}
    further = [file.with_name(f"{file.stem}-{n}.csv") for n in range(2, len(tables) + 1)]
    files = [file, *further]
    _check_free(files, force)
    for path, table in zip(files, tables, strict=True):
        write_text(path, table.to_csv())
    titles = (table.title or table.caption.split(".")[0] for table in tables)
    return {str(path): title for path, title in zip(files, titles, strict=True)}


def _check_free(files: list[Path], force: bool) -> None:
    taken = [path for path in files if path.exists()]
    if taken and not force:
        raise FolderExistsError(
            f"{taken[0]} is there already; name another file, or replace it with --force."
        )
