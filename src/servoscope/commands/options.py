"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from servoscope.errors import InvalidInputError

if TYPE_CHECKING:
    from servoscope.data.images import PoseImageSet

Source = Positional[Annotated[Path, arg(metavar="SRC", help="Folder or file to read.")]]
DataSetOut = Positional[Annotated[Path, arg(metavar="OUT", help="Data set folder to write.")]]
DataSet = Positional[
    Annotated[str, arg(metavar="DATASET", help="Data set folder, or its address.")]
]
MoreDataSets = Positional[
    Annotated[tuple[str, ...], arg(metavar="DATASET ...", help="Further ones.")]
]
AnyFolder = Positional[
    Annotated[str | None, arg(metavar="PATH", help="Folder, or the address of a data set.")]
]
Model = Positional[Annotated[Path, arg(metavar="MODEL", help="Model folder.")]]
ModelOut = Annotated[Path, arg(help="Model folder to write.")]
Run = Positional[Annotated[Path, arg(metavar="RUN", help="Run folder.")]]
RunOut = Annotated[Path, arg(help="Run folder to write.")]
Jobs = Annotated[int | None, arg(metavar="N", help="Processes; by default as many as cores.")]
Force = Annotated[bool, arg(help="Replace what is there, once the new is whole.")]
Resume = Annotated[bool, arg(help="Go on from the finished stages of an interrupted run.")]
Memory = Annotated[
    str,
    arg(
        metavar="SIZE",
        help="Images that take more than a quarter of it are read from disk as they are needed; "
        "of large ones no more are assessed, or trained on, than it holds.",
    ),
]
Json = Annotated[bool, arg(help="Print JSON.")]
Protocol = Annotated[
    Literal["both", "honest", "paper"],
    arg(help="Decide on images kept for that (honest), or on the test images (paper)."),
]

Dofs = Annotated[
    str | None,
    arg(
        metavar="DOF,...",
        help="Degrees of freedom that the robot has, such as tx,ty,rz.",
    ),
]

Part = Annotated[
    Literal["cylinder_head", "textured_plane"], arg(help="What lies under the camera.")
]
RobotName = Annotated[
    str,
    arg(
        metavar="{free,arm}",
        help="What carries the camera: nothing, an arm in physics, which reports its flange, or a "
        "robot of an installed package.",
    ),
]


def owning_model(command: Callable[..., None]) -> Callable[..., None]:
    """The command, which owns the model folder ``--out`` while it runs."""

    @wraps(command)
    def owner(*args: Any, **options: Any) -> None:
        from servoscope.storage.folders import owned

        asked = signature(command).bind(*args, **options)
        asked.apply_defaults()
        with owned(asked.arguments["out"], beside=True):
            command(*args, **options)

    return owner


def with_dofs(data: PoseImageSet, dofs: str | None) -> PoseImageSet:
    """A data set with the degrees of freedom of ``--dofs``, or else as it is."""
    from servoscope.dofs import parse_dofs

    return data if dofs is None else replace(data, asked_dofs=parse_dofs(dofs))


def n_jobs(jobs: int | None) -> int:
    """Number of processes in joblib's terms for ``--jobs``, -1 being all cores."""
    if jobs is None:
        return -1
    if jobs < 1:
        raise InvalidInputError(f"--jobs must be at least 1, got {jobs}; leave it out for all.")
    return jobs


def protocols(protocol: str) -> tuple[str, ...]:
    """The protocols that ``--protocol`` names."""
    from servoscope.data.splits import PROTOCOLS

    return PROTOCOLS if protocol == "both" else (protocol,)
