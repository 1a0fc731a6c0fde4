"""A LeRobotDataset v3: tables in Parquet, images in videos."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.data.trajectory import Trajectory
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats.conventions import (
    ConventionOptions,
    PoseConvention,
    poses_from_numbers,
    problem_of_pose,
)
from servoscope.formats.frames import BAD_POSE, Drops, Frames
from servoscope.formats.images import Decoded, GreyLevels, decode_bytes, resized
from servoscope.formats.pose_text import as_T_world_cam, check_folder, relative_name
from servoscope.formats.recordings import RecordingOptions, assemble_recording
from servoscope.storage.reading import LARGEST_IMAGE, check_regular, read_json, words

Array = NDArray[np.float64]

_MOST_BYTES = 2**30
_ANY_SIZE = 2**63
_FIELD = re.compile(r"\{(chunk_index|file_index|video_key)(?::0?(\d)d)?\}")
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
_APART_S = 10.0
_IMAGES_AT_ONCE = 16


@dataclass(frozen=True, kw_only=True)
class LeRobotOptions(ConventionOptions, RecordingOptions):
    """Options of a LeRobotDataset, besides those of every recording.

    Parameters
    ----------
    camera : str, optional
        Feature that holds the images, such as observation.images.wrist; the only one by default.
    columns : str, optional
        What holds the pose, in the order of the convention, with commas: names such as
        observation.state.x, places such as observation.state[0], or a feature of as many numbers.
    rotation : str, optional
        How the rotations are written; must be said.
    episodes : str, optional
        Numbers of the episodes to read, such as 0,2,5-8; all by default.

    Examples
    --------
    >>> options = LeRobotOptions(rotation="ur", columns="observation.tcp_pose", episodes="0-3")
    >>> options.camera is None
    True
    """

    camera: str | None = None
    episodes: str | None = None


def read_lerobot(
    src: str | PathLike[str],
    options: LeRobotOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a LeRobotDataset of version 3, some columns of which hold poses.

    Tables are read by pyarrow, videos by PyAV, image after image. Each image has the pose of its
    row; with a clock offset, that of another time of its episode.

    Parameters
    ----------
    src : path-like
        Folder that holds ``meta/info.json``.
    options : LeRobotOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order of the frames; episodes follow each other in time.

    Raises
    ------
    DataSetError
        If pyarrow or av is not installed, columns must be named, or a file is missing or damaged.

    Warns
    -----
    ServoscopeWarning
        If the video is lossy, or anything was left out.

    Examples
    --------
    >>> options = LeRobotOptions(rotation="ur", columns="observation.tcp_pose")
    >>> data = read_lerobot("my_dataset", options)  # doctest: +SKIP
    """
    options = LeRobotOptions() if options is None else options
    _check_installed()
    folder, drops = Path(src), Drops()
    check_folder(folder, "meta")
    info = read_json(folder / "meta" / "info.json", DataSetError)
    features = _features(info, folder)
    camera = _camera(features, options, folder)
    convention, places = _pose_places(features, options, folder)
    table = _Table(folder, info, sorted({name for name, _ in places}), camera, options)
    numbers = np.column_stack([table.columns[name][:, place] for name, place in places])
    if convention.is_matrix and numbers.shape[1] == 16:
        matrices = numbers.reshape(-1, 4, 4)
        matrices = matrices.swapaxes(1, 2) if convention.by_column else matrices
        numbers = matrices[:, :3].reshape(-1, 12)
    usable = _usable(numbers, convention, options, drops)
    T = poses_from_numbers(
        numbers[usable],
        convention,
        length_unit=options.length_unit,
        angle_unit=options.angle_unit,
    )
    T = as_T_world_cam(T, direction=options.direction, axes=options.axes)
    n = len(numbers)
    images = Frames(
        folder,
        [f"{e:04d}_{f:06d}" for e, f in zip(table.episode, table.frame, strict=True)],
        np.arange(n),
        np.empty((n, 4, 4)),
        table.times,
        table.read_video if features[camera]["dtype"] == "video" else table.read_images,
    )
    if features[camera]["dtype"] == "video":
        described = features[camera].get("info")
        codec = described.get("video.codec") if isinstance(described, dict) else None
        warnings.warn(
            f"{folder}: the images are frames of lossy video ({str(codec)[:20]}); what they show "
            "of small displacements may be lost.",
            ServoscopeWarning,
            stacklevel=2,
        )
    trajectory = Trajectory(table.times[usable], T)
    called = (f"images of {camera}", f"the columns {options.columns}")
    facts = {"camera": camera, "robot": str(info.get("robot_type"))[:80]}
    return assemble_recording(
        images, trajectory, options, drops, "lerobot", on_progress, called=called, facts=facts
    )


def _check_installed() -> None:
    try:
        import av  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise DataSetError(
            f"LeRobot data sets are read by the packages pyarrow and av, but {error.name} is not "
            "installed; install servoscope[lerobot]."
        ) from error


def _features(info: dict[str, Any], folder: Path) -> dict[str, dict[str, Any]]:
    """The features by name, each with its type, shape and names of its numbers."""
    version = str(info.get("codebase_version"))
    if not version.startswith("v3"):
        raise DataSetError(
            f"{folder} is a LeRobotDataset of version {version[:20]}, but v3 is read; convert it "
            "with lerobot."
        )
    features = info.get("features")
    if not isinstance(features, dict) or not all(
        isinstance(f, dict) and isinstance(f.get("dtype"), str) for f in features.values()
    ):
        raise DataSetError(f"{folder / 'meta' / 'info.json'} must describe its features.")
    return features


def _camera(features: dict[str, dict[str, Any]], options: LeRobotOptions, folder: Path) -> str:
    found = [name for name, f in features.items() if f["dtype"] in ("video", "image")]
    if options.camera in found:
        return str(options.camera)
    if options.camera is not None or len(found) != 1:
        raise DataSetError(
            f"{folder} has images in {', '.join(found) or 'none of its features'}; choose one with "
            "--camera."
        )
    return found[0]


def _names(feature: dict[str, Any]) -> list[str]:
    """Names of the numbers of a feature, however they are nested."""
    names = feature.get("names")
    if isinstance(names, dict):
        names = [
            name for part in names.values() for name in (part if isinstance(part, list) else [])
        ]
    return [str(name) for name in names] if isinstance(names, list) else []


def _size(feature: dict[str, Any]) -> int:
    shape = feature.get("shape")
    is_vector = isinstance(shape, list) and len(shape) == 1 and isinstance(shape[0], int)
    return shape[0] if is_vector and shape is not None else 0


def _pose_places(
    features: dict[str, dict[str, Any]], options: LeRobotOptions, folder: Path
) -> tuple[PoseConvention, list[tuple[str, int]]]:
    """Feature and place of each number of the pose."""
    vectors = {name: f for name, f in features.items() if f["dtype"].startswith("float")}
    said = ", ".join(f"{name} ({' '.join(_names(f)) or _size(f)})" for name, f in vectors.items())
    convention = options.convention
    if convention is None or options.columns is None:
        raise DataSetError(
            f"{folder}: say which columns hold the pose of camera or flange, with --columns and "
            f"--rotation; there are {said[:500]}."
        )
    places: list[tuple[str, int]] = []
    for column in options.columns.split(","):
        places += _place(column.strip(), vectors, folder, said)
    if len(places) not in {len(convention.columns), 16 if convention.is_matrix else 0}:
        raise DataSetError(
            f"{folder}: {options.rotation} has {len(convention.columns)} numbers "
            f"({' '.join(convention.columns)}), but --columns names {len(places)}; there are "
            f"{said[:500]}."
        )
    return convention, places


def _place(
    column: str, vectors: dict[str, dict[str, Any]], folder: Path, said: str
) -> list[tuple[str, int]]:
    if column in vectors:
        return [(column, i) for i in range(_size(vectors[column]))]
    if found := re.fullmatch(r"(.+)\[(\d{1,4})\]", column):
        name, place = found[1], int(found[2])
        if name in vectors and place < _size(vectors[name]):
            return [(name, place)]
    matches = [
        (name, i)
        for name, feature in vectors.items()
        for i, part in enumerate(_names(feature))
        if column in (part, f"{name}.{part}")
    ]
    if len(matches) == 1:
        return matches
    how = "is in several features; write feature.name" if matches else "is none"
    raise DataSetError(f"{folder}: the column {column[:60]!r} {how}; there are {said[:500]}.")


def _usable(
    numbers: Array, convention: PoseConvention, options: LeRobotOptions, drops: Drops
) -> NDArray[np.bool_]:
    usable = np.ones(len(numbers), dtype=bool)
    for i, row in enumerate(numbers.tolist()):
        problem = "the numbers must be finite"
        if np.isfinite(row).all():
            problem = problem_of_pose(
                row,
                convention,
                length_unit=options.length_unit,
                angle_unit=options.angle_unit,
            )
        if problem and not options.skip_bad:
            raise DataSetError(f"Frame {i}: {problem}, or leave it out with --skip-bad.")
        usable[i] = not problem
    drops.add(BAD_POSE, [str(i) for i in np.flatnonzero(~usable)])
    return usable


class _Table:
    """The rows of the chosen episodes, and where their images are."""

    def __init__(
        self,
        folder: Path,
        info: dict[str, Any],
        names: list[str],
        camera: str,
        options: LeRobotOptions,
    ) -> None:
        self._folder, self._camera = folder, camera
        self._video_path = str(info.get("video_path") or _VIDEO)
        data_path = str(info.get("data_path") or _DATA)
        is_video = info["features"][camera]["dtype"] == "video"
        episodes = _read_episodes(folder, camera if is_video else None)
        chosen = _chosen_episodes(options.episodes, sorted(episodes))
        parts = []
        wanted = ["episode_index", "frame_index", "timestamp", *names]
        files = sorted({episodes[e]["data"] for e in chosen})
        for file in files:
            path = _path(folder, data_path, *file)
            part = _read_table(path, wanted)
            row: NDArray[Any] = np.arange(len(part["episode_index"]))
            part |= {"file": np.full_like(row, files.index(file)), "row": row}
            kept = np.isin(part["episode_index"], chosen)
            parts.append({name: values[kept] for name, values in part.items()})
        joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        if not len(joined["episode_index"]):
            raise DataSetError(f"{folder} holds no frame of the episodes {chosen[:10]}.")
        self.episode, self.frame = joined["episode_index"], joined["frame_index"]
        self._paths = [_path(folder, data_path, *file) for file in files]
        self._file, self._row = joined["file"], joined["row"]
        self.columns = {name: joined[name].reshape(len(self.episode), -1) for name in names}
        self._videos = [episodes[int(e)].get("video") for e in self.episode] if is_video else []
        self._in_video = joined["timestamp"].astype(float)
        self.times = self._in_video.copy()
        starts = {e: (episodes[e].get("video") or (0, 0, 0.0))[2] for e in chosen}
        self._in_video += [starts[int(e)] for e in self.episode]
        end = 0.0
        for episode in chosen:
            own = self.episode == episode
            if own.any():
                self.times[own] += end - self.times[own].min()
                end = float(self.times[own].max()) + _APART_S

    def read_images(self, frames: Frames, width: int | None) -> Generator[Decoded, None, None]:
        """Images that stand in the table itself, as files in bytes."""
        for numbers in _runs(frames.numbers, self._file[frames.numbers].tolist()):
            path = self._paths[int(self._file[numbers[0]])]
            for row, content in _image_bytes(path, self._camera, self._row[numbers]):
                where = f"{path}, row {row}"
                try:
                    if not isinstance(content, bytes):
                        raise DataSetError(f"{where} holds no image.")
                    yield resized(decode_bytes(content, where), width, where)
                except DataSetError as error:
                    yield error

    def read_video(self, frames: Frames, width: int | None) -> Generator[Decoded, None, None]:
        """Images of videos, each of which is decoded once, in the order of the frames."""
        files = [self._videos[i][:2] for i in frames.numbers]
        for numbers in _runs(frames.numbers, files):
            chunk, file = self._videos[numbers[0]][:2]
            path = _path(self._folder, self._video_path, chunk, file, self._camera)
            for number, found in zip(
                numbers, _video_images(path, self._in_video[numbers]), strict=True
            ):
                if isinstance(found, DataSetError):
                    yield found
                    continue
                try:
                    yield resized(found, width, f"{path}, frame {self.frame[number]}")
                except DataSetError as error:
                    yield error


def _runs(numbers: NDArray[np.intp], files: list[Any]) -> Iterator[NDArray[np.intp]]:
    """The numbers in runs that are of one file each."""
    start = 0
    for stop in range(1, len(files) + 1):
        if stop == len(files) or files[stop] != files[start]:
            yield numbers[start:stop]
            start = stop


def _path(folder: Path, template: str, chunk: int, file: int, camera: str = "") -> Path:
    """The file that a template of ``info.json`` names."""
    values = {"chunk_index": chunk, "file_index": file, "video_key": camera}

    def fill(field: re.Match[str]) -> str:
        value = values[field[1]]
        return str(value).zfill(int(field[2])) if field[2] else str(value)

    name = _FIELD.sub(fill, template)
    return folder / relative_name(name, f"{folder / 'meta' / 'info.json'}")


def _read_episodes(folder: Path, camera: str | None) -> dict[int, dict[str, Any]]:
    """Where the rows and the video of each episode are."""
    files = sorted((folder / "meta" / "episodes").glob("chunk-*/file-*.parquet"))
    if not files:
        raise DataSetError(f"{folder / 'meta' / 'episodes'} holds no table of the episodes.")
    names = ["episode_index", "data/chunk_index", "data/file_index"]
    video = [f"videos/{camera}/{part}" for part in ("chunk_index", "file_index", "from_timestamp")]
    episodes: dict[int, dict[str, Any]] = {}
    for path in files:
        table = _read_table(path, names + (video if camera else []))
        for i, episode in enumerate(table["episode_index"].tolist()):
            entry: dict[str, Any] = {"data": tuple(int(table[name][i]) for name in names[1:])}
            if camera:
                chunk, file, start = (table[name][i] for name in video)
                entry["video"] = int(chunk), int(file), float(start)
            episodes[int(episode)] = entry
    return episodes


def _chosen_episodes(asked: str | None, there: list[int]) -> list[int]:
    if asked is None:
        return there
    chosen: list[int] = []
    for part in asked.split(","):
        found = re.fullmatch(r"\s*(\d{1,7})(?:-(\d{1,7}))?\s*", part)
        if found is None:
            raise DataSetError(f"episodes must be numbers such as 0,2,5-8, got {asked[:60]!r}.")
        chosen += range(int(found[1]), int(found[2] or found[1]) + 1)
    if missing := sorted(set(chosen) - set(there)):
        raise DataSetError(
            f"There is no episode {missing[0]}; they are numbered {there[0]} to {there[-1]}."
        )
    return sorted(set(chosen))


def _read_table(path: Path, names: list[str]) -> dict[str, NDArray[Any]]:
    """Columns of numbers of a Parquet file, those of vectors with one row a frame."""
    import pyarrow.parquet as parquet

    check_regular(path, DataSetError, _ANY_SIZE)
    try:
        file = parquet.ParquetFile(path)
        there = set(file.schema_arrow.names)
        if missing := [name for name in names if name not in there]:
            raise DataSetError(f"{path} lacks the column {missing[0]}.")
        declared = sum(
            chunk.total_uncompressed_size
            for g in range(file.metadata.num_row_groups)
            for c in range(file.metadata.row_group(g).num_columns)
            if (chunk := file.metadata.row_group(g).column(c)).path_in_schema.split(".list.")[0]
            in names
        )
        if declared > _MOST_BYTES:
            raise DataSetError(f"{path} unpacks to {declared} bytes, more than {_MOST_BYTES}.")
        table = file.read(columns=names)
        return {name: _numbers(table.column(name), len(table)) for name in names}
    except DataSetError:
        raise
    except Exception as error:  # pyarrow raises of every kind on damaged files
        raise DataSetError(f"{path} cannot be read ({words(error)}).") from error


def _numbers(column: Any, n: int) -> NDArray[Any]:
    import pyarrow

    values = column.combine_chunks()
    if pyarrow.types.is_list(values.type) or pyarrow.types.is_fixed_size_list(values.type):
        values = values.flatten()
        return np.asarray(values.to_numpy(zero_copy_only=False), dtype=float).reshape(n, -1)
    numbers = values.to_numpy(zero_copy_only=False)
    return np.asarray(numbers) if numbers.dtype.kind == "i" else np.asarray(numbers, dtype=float)


def _image_bytes(
    path: Path, camera: str, wanted: NDArray[np.intp]
) -> Iterator[tuple[int, bytes | None]]:
    """The image files that some rows hold, in ascending order."""
    import pyarrow.parquet as parquet

    rows = set(wanted.tolist())
    try:
        file, first = parquet.ParquetFile(path), 0
        for group in range(file.metadata.num_row_groups):
            described = file.metadata.row_group(group)
            if rows.isdisjoint(range(first, first + described.num_rows)):
                first += described.num_rows
                continue
            if described.total_byte_size > _MOST_BYTES:
                raise DataSetError(
                    f"{path} unpacks to {described.total_byte_size} bytes a group of rows, more "
                    f"than {_MOST_BYTES}."
                )
            for batch in file.iter_batches(_IMAGES_AT_ONCE, [group], [camera]):
                for row, value in enumerate(batch.column(0), first):
                    if row in rows:
                        yield row, (value.as_py() or {}).get("bytes")
                first += len(batch)
    except DataSetError:
        raise
    except Exception as error:  # pyarrow raises of every kind on damaged files
        raise DataSetError(f"{path} cannot be read ({words(error)}).") from error


def _video_images(path: Path, wanted: Array) -> Iterator[GreyLevels | DataSetError]:
    """The images of a video at some times [s] in ascending order, or why one is not there."""
    import av

    check_regular(path, DataSetError, _ANY_SIZE)
    missing = DataSetError(f"{path} ends before all images; restore it.")
    given = 0
    try:
        with av.open(str(path), options={"protocol_whitelist": "file"}) as container:
            stream = container.streams.video[0]
            if stream.width * stream.height > LARGEST_IMAGE:
                raise DataSetError(f"{path} is of more than {LARGEST_IMAGE} pixels.")
            near = 0.5 / float(stream.average_rate or 30)
            stream.thread_type = "AUTO"
            container.seek(int(max(wanted[0] - near, 0) / stream.time_base), stream=stream)
            for frame in container.decode(stream):
                if frame.time is None or frame.time < wanted[given] - near:
                    continue
                while given < len(wanted) and wanted[given] < frame.time - near:
                    yield DataSetError(f"{path} has no image at {wanted[given]:.4f} s.")
                    given += 1
                if given < len(wanted) and frame.time <= wanted[given] + near:
                    grey: Any = frame.to_ndarray(format="gray")
                    yield grey
                    given += 1
                if given == len(wanted):
                    return
    except DataSetError:
        raise
    except Exception as error:  # FFmpeg raises of every kind on damaged files
        missing = DataSetError(f"{path} cannot be decoded ({words(error)}); restore it.")
    for _ in range(given, len(wanted)):
        yield missing
