"""A run folder: what was asked for, which stages are finished, and what they left."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from servoscope import __version__
from servoscope.errors import FolderExistsError, RunFolderError
from servoscope.storage import archives, folders, reading
from servoscope.storage.folders import (
    LOCK,
    NEW,
    complete_interrupted,
    complete_replacement,
    owned,
    replacing,
)

VERSION = 1
PARTS = (
    "config.json",
    "summary.json",
    "sets.json",
    "features.npz",
    "selection.npz",
    "ranking.csv",
    "chance.json",
    "criteria.json",
    "assessment.json",
    "report.html",
    "tables.tex",
    "scoreboard.json",
    "scoreboard.md",
    "sensitivity.json",
    "sensitivity.md",
    "scoreboard.html",
    "rehearsal.json",
    "rehearsal.md",
    "rehearsal.html",
)
FOLDERS = ("stages", "vectors", "models", "figures", "dataset", "trials", "sets", "cells")
_REPLACED = (*PARTS, *FOLDERS)


class RunFolder:
    """The folder of one run, made by `open_run_folder`, and what it was asked for, as plain JSON
    values.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self.path = path
        self.settings = settings

    def run_stage(
        self, name: str, inputs: Any, make: Callable[[], object], outputs: Sequence[str] = ()
    ) -> None:
        """Call ``make()``, unless this stage is finished for the same inputs.

        A stage counts as finished once `make` has returned, for as long as the files it made
        (`outputs`, relative to the folder) are there.
        """
        record = self._record(name)
        fingerprint = digest(inputs)
        there = all((self.path / output).exists() for output in outputs)
        if there and self._fingerprint(name) == fingerprint:
            return
        record.unlink(missing_ok=True)
        start = time.perf_counter()
        make()
        seconds = time.perf_counter() - start
        record.parent.mkdir(exist_ok=True)
        folders.write_json(record, {"fingerprint": fingerprint, "seconds": round(seconds, 3)})

    def timings(self) -> dict[str, float]:
        """How long each finished stage took, in the order of their names, and ``total``, [s]."""
        records = sorted((self.path / "stages").glob("*.json"))
        seconds = {record.stem: _seconds(record) for record in records}
        return {**seconds, "total": round(sum(seconds.values()), 3)}

    def _fingerprint(self, name: str) -> str | None:
        """That of the finished stage; None if it is not finished, or its record is damaged."""
        try:
            return read_json(self._record(name)).get("fingerprint")
        except RunFolderError:
            return None

    def _record(self, name: str) -> Path:
        return self.path / "stages" / f"{name}.json"


@contextmanager
def owned_run_folder(
    path: Path, settings: dict[str, Any], *, resume: bool = False, force: bool = False
) -> Iterator[RunFolder]:
    """Own a run folder while the block runs:

    a new one, or with `resume` one that is gone on with. With `force` the new run is made beside
    the one that is there, and takes its place once the block ends well; if it does not, `resume`
    goes on with the new one.
    """
    with owned(path):
        complete_replacement(path, _REPLACED)
        if force and is_run(path):
            with replacing(path, _REPLACED, keep=True) as place:
                yield open_run_folder(place, settings)
        elif resume and _is_of(path / NEW, settings):
            with replacing(path, _REPLACED, go_on=True, keep=True) as place:
                yield open_run_folder(place, settings, resume=True)
        else:
            yield open_run_folder(path, settings, resume=resume)


def open_run_folder(path: Path, settings: dict[str, Any], *, resume: bool = False) -> RunFolder:
    """Make a run folder, or with `resume` go on in the one that is there.

    A run that is there without `resume`, what is no run folder, and a run of other settings or of
    another version are errors.
    """
    settings = _as_json(settings)
    if is_run(path):
        if not resume:
            raise FolderExistsError(
                f"{path} holds a run already; go on with it with --resume, replace it with "
                "--force, or name another folder with --out."
            )
        _check_same_settings(path, settings)
        return RunFolder(path, settings)
    if path.exists() and (not path.is_dir() or _holds_anything(path)):
        raise FolderExistsError(f"{path} exists and is not a run folder; name another with --out.")
    path.mkdir(parents=True, exist_ok=True)
    folders.remove_parts(path)
    config = {"version": VERSION, "servoscope": __version__, "settings": settings}
    folders.write_json(path / "config.json", config)
    return RunFolder(path, settings)


def is_run(path: Path) -> bool:
    """Whether the folder holds a run, of whatever version, finished or not.

    A replacement that was interrupted is completed first.
    """
    if not (path / "config.json").exists():
        complete_interrupted(path, _REPLACED)
    if not (path / "config.json").exists():
        return False
    try:
        return "servoscope" in read_json(path / "config.json")
    except RunFolderError:
        return (path / "stages").is_dir()


def read_settings(path: Path) -> dict[str, Any]:
    """The settings that a run folder was made with.

    Raises
    ------
    RunFolderError
        If the folder is not a run folder, or is one of another version.
    """
    if not is_run(path):
        raise RunFolderError(
            f"{path} is not a run folder: it has no config.json of a run; name what --out named."
        )
    config = read_json(path / "config.json")
    if config.get("version") != VERSION:
        raise RunFolderError(
            f"{path} is a run of version {config.get('version')!r}, this servoscope reads version "
            f"{VERSION}; make it again with --force."
        )
    if not isinstance(config.get("settings"), dict):
        raise RunFolderError(f"{path / 'config.json'} holds no settings; make the run again.")
    return config["settings"]


def _seconds(record: Path) -> float:
    seconds = read_json(record).get("seconds")
    if not isinstance(seconds, int | float):
        raise RunFolderError(f"{record} lacks its seconds; make the run again with --force.")
    return float(seconds)


def _holds_anything(path: Path) -> bool:
    """Whether a folder holds more than its lock and what interrupted writes have left."""
    return any(
        p.name != LOCK and not (p.name.startswith(".") and p.suffix == ".part")
        for p in path.iterdir()
    )


def _as_json(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings as they are read again."""
    read: dict[str, Any] = json.loads(json.dumps(settings))
    return read


def digest(value: Any) -> str:
    """A short hash of plain JSON values."""
    text = json.dumps(value, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _is_of(path: Path, settings: dict[str, Any]) -> bool:
    """Whether a folder holds a run of these settings."""
    try:
        return read_settings(path) == _as_json(settings)
    except RunFolderError:
        return False


def _check_same_settings(path: Path, settings: dict[str, Any]) -> None:
    made_with = read_settings(path)
    made_by, asked_for = made_with.get("command"), settings.get("command")
    if made_by != asked_for:
        raise RunFolderError(
            f"{path} was made by {made_by!r}, not {asked_for!r}; name another folder, or replace "
            "it with --force."
        )
    if found := _first_difference(made_with, _as_json(settings)):
        key, made, asked = found
        raise RunFolderError(
            f"{path} was made with {key} {made!r}, not {asked!r}; "
            "repeat its settings to resume it, or replace it with --force."
        )


def _first_difference(made: dict[str, Any], asked: dict[str, Any]) -> tuple[str, Any, Any] | None:
    """The name of the first setting that differs, at any depth, and both its values."""
    for key in sorted(made | asked):
        one, other = made.get(key), asked.get(key)
        if isinstance(one, dict) and isinstance(other, dict):
            if found := _first_difference(one, other):
                return found
        elif one != other:
            return key, one, other
    return None


def read_arrays(path: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """The named arrays in a file of a run folder.

    Raises
    ------
    RunFolderError
        If the file is missing or damaged, or has no array of that name.
    """
    try:
        return archives.read_arrays(path, names, ValueError)
    except ValueError as error:
        raise RunFolderError(
            f"{path.name} is damaged: {reading.without_advice(error)}; make the run again with "
            "--force."
        ) from error


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file of a run folder.

    Raises
    ------
    RunFolderError
        If the file is missing or damaged.
    """
    return reading.read_json(path, RunFolderError)
