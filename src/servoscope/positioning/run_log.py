"""The folder that a run is written to while it goes, and looking at it again.

``run.json`` says what ran, ``reference.png`` what it looked for. ``steps.jsonl`` gains a line a
look, before the robot moves, once its image is in ``images/``; ``result.json`` comes last.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from servoscope import __version__
from servoscope.errors import FolderExistsError, InvalidInputError, RunFolderError
from servoscope.poses import pose_error
from servoscope.positioning.guard import is_finite_rigid
from servoscope.positioning.interfaces import Array, Estimate, Estimator, Image
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.reference_view import Comparison
from servoscope.positioning.result import PositioningResult, Step, plain
from servoscope.storage.folders import write_atomically, write_json
from servoscope.storage.reading import open_image, parse_json, read_bytes, read_json, words

VERSION = 1

Folder = str | PathLike[str]

_SAME_M, _SAME_RAD = 1e-6, 1e-6


class RunLog:
    """A new folder for the log of one run.

    Parameters
    ----------
    folder : path
    positioner : Positioner
        What is going to run.

    Raises
    ------
    FolderExistsError
        If there is anything in the folder already.

    Examples
    --------
    ``positioner.run(robot, camera, on_step=log.write)``, then ``log.finish(result)``.
    """

    def __init__(self, folder: Folder, positioner: Positioner) -> None:
        self.path = Path(folder)
        if self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise FolderExistsError(f"{self.path} is there already; name a new folder for the log.")
        (self.path / "images").mkdir(parents=True)
        self._n_steps = 0
        estimator = positioner.estimator
        _write_image(self.path / "reference.png", estimator.reference_image)
        facts = {
            "version": VERSION,
            "servoscope": __version__,
            "image_shape": list(estimator.image_shape),
            "pivot": float(estimator.pivot),
            "reach": plain(estimator.reach),
            "settings": {
                **asdict(positioner.settings),
                "robot_workspace": positioner.settings.robot_box(positioner.estimator).corners(),
            },
        }
        write_json(self.path / "run.json", facts)

    def write(self, step: Step, image: Image) -> None:
        """Write a look; it is on the disk when this returns."""
        name = f"images/{self._n_steps:03d}.png"
        _write_image(self.path / name, image)
        line = json.dumps({"image": name, **step.to_dict()}, allow_nan=False)
        with open(self.path / "steps.jsonl", "ab") as file:
            file.write(line.encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._n_steps += 1

    def finish(self, result: PositioningResult) -> None:
        """Write how the run ended."""
        write_json(self.path / "result.json", result.to_dict())


@dataclass(frozen=True, eq=False)
class Replayed:
    """What an estimator makes of an image of the log.

    Parameters
    ----------
    logged : Estimate
        As it was in the run.
    now : Estimate
    distance, angle : float
        Between the two displacements, [m] and [rad].
    """

    logged: Estimate
    now: Estimate
    distance: float
    angle: float

    @property
    def differs(self) -> bool:
        """Whether it is another stage, or more than a micrometre or a microradian."""
        same = self.distance <= _SAME_M and self.angle <= _SAME_RAD
        return self.logged.stage != self.now.stage or not same


def replay(folder: Folder, estimator: Estimator) -> tuple[Replayed, ...]:
    """Show the images of a log to an estimator again, each with its own estimate before.

    Parameters
    ----------
    folder : path
        That a `RunLog` has written, of a run that may have been cut short.
    estimator : Estimator
        That of the run, or another that takes images of the same size.

    Returns
    -------
    tuple of Replayed
        One a look.

    Raises
    ------
    RunFolderError
        If the log is missing, damaged, or of another version.
    InvalidInputError
        If the estimator takes images of another size.
    """
    replayed: list[Replayed] = []
    for step, image in read_steps(folder):
        if image.shape != tuple(estimator.image_shape):
            raise InvalidInputError(
                f"The estimator must take the images of the log, {image.shape[1]} x "
                f"{image.shape[0]}, but it takes {estimator.image_shape[1]} x "
                f"{estimator.image_shape[0]}; replay with the model of that run."
            )
        now = estimator.estimate(image, replayed[-1].now if replayed else None)
        distance, angle = np.nan, np.nan
        logged = step.first_displacement
        logged = step.estimate.displacement if logged is None else logged
        if is_finite_rigid(logged) and is_finite_rigid(now.displacement):
            distance, angle = map(float, pose_error(logged, now.displacement))
        replayed.append(Replayed(step.estimate, now, distance, angle))
    return tuple(replayed)


def read_steps(folder: Folder) -> Iterator[tuple[Step, Image]]:
    """The looks of a log, each with its image; a last one that was cut short is left out.

    Raises
    ------
    RunFolderError
        If the log is missing, damaged, or of another version.
    """
    path = Path(folder)
    _read_run(path)
    steps = path / "steps.jsonl"
    lines = read_bytes(steps, RunFolderError).split(b"\n")[:-1] if steps.exists() else []
    for number, line in enumerate(lines):
        try:
            yield _read_step(parse_json(line)), _read_image(path / f"images/{number:03d}.png")
        except (ValueError, TypeError, KeyError) as error:
            raise RunFolderError(
                f"Line {number + 1} of {steps} is damaged ({' '.join(str(error).split())}); "
                "the lines before it are whole, so shorten the file to them."
            ) from error


def read_reference(folder: Folder) -> tuple[Image, float]:
    """The reference image of a log, and the distance of its pivot, [m].

    Raises
    ------
    RunFolderError
        If the log is missing, damaged, or of another version.
    """
    path = Path(folder)
    run = _read_run(path)
    try:
        pivot = float(_array(run, "pivot", ()))
        if not np.isfinite(pivot):
            raise ValueError("the pivot must be finite")
        return _read_image(path / "reference.png"), pivot
    except (ValueError, TypeError, KeyError) as error:
        raise RunFolderError(f"The log {path} is damaged ({words(error)}).") from error


def read_end(folder: Folder) -> str | None:
    """How the run of a log ended, in one line; None if it was cut short."""
    path = Path(folder) / "result.json"
    if not path.exists():
        return None
    result = read_json(path, RunFolderError)
    return f"{result.get('status')}: {result.get('message')}"


def _read_run(path: Path) -> dict[str, Any]:
    run = read_json(path / "run.json", RunFolderError)
    if run.get("version") != VERSION:
        raise RunFolderError(
            f"{path} is a log of version {run.get('version')!r}, this servoscope reads version "
            f"{VERSION}."
        )
    return run


def _read_step(record: dict[str, Any]) -> Step:
    estimate = Estimate(
        _array(record, "displacement", (4, 4)),
        _array(record, "std", (6,)),
        float(_array(record, "novelty", ())),
        str(record["stage"]),
        is_finest=bool(record.get("is_finest", True)),
        similarity=float(np.array(record.get("similarity"), dtype=float)),
    )
    return Step(
        pose=_array(record, "pose", (4, 4)),
        image_error=float(_array(record, "image_error", ())),
        estimate=estimate,
        commanded=_motion(record, "commanded"),
        executed=_motion(record, "executed"),
        seconds=float(_array(record, "seconds", ())),
        comparison=_comparison(record.get("comparison")),
        first_displacement=_motion(record, "first_displacement"),
    )


def _comparison(values: dict[str, float | None] | None) -> Comparison | None:
    if values is None:
        return None
    return Comparison(**{k: np.inf if v is None else float(v) for k, v in values.items()})


def _motion(record: dict[str, Any], name: str) -> Array | None:
    return None if record.get(name) is None else _array(record, name, (4, 4))


def _array(record: dict[str, Any], name: str, shape: tuple[int, ...]) -> Array:
    array = np.array(record[name], dtype=float)
    if array.shape != shape:
        raise ValueError(f"{name} must have the shape {shape}, got {array.shape}")
    return array


def _write_image(path: Path, image: Image) -> None:
    _, png = cv2.imencode(".png", image)
    write_atomically(path, lambda file: file.write(png.tobytes()))


def _read_image(path: Path) -> Image:
    try:
        with open_image(path, ValueError) as image:
            return np.array(image.convert("L"))
    except Exception as error:  # Pillow raises of every kind on damaged files
        raise ValueError(f"{path.name} is no image ({words(error)})") from error
