"""The binary files of a COLMAP reconstruction: ``images.bin`` and ``cameras.bin``.

Little-endian, one record after the other, as COLMAP documents it under "Output Format".
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from struct import Struct
from typing import Any, BinaryIO

from servoscope.errors import DataSetError
from servoscope.storage.reading import check_regular, words

_COUNT = Struct("<Q")
_IMAGE = Struct("<I7dI")
_CAMERA = Struct("<IiQQ")
_POINT_BYTES = 24
_LONGEST_NAME = 4096

_MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
}
"""Names of the camera models by number, and how many parameters each has."""


def image_fields(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Where each image stands, and its fields, as the lines of ``images.txt`` have them.

    Parameters
    ----------
    path : Path
        ``images.bin``.

    Raises
    ------
    DataSetError
        If the file is damaged.
    """
    size = check_regular(path, DataSetError)
    with _opened(path) as file:
        (n_images,) = _unpack(file, _COUNT, path)
        for i in range(n_images):
            where = f"{path}, image {i + 1}"
            number, *pose, camera = _unpack(file, _IMAGE, where)
            name = _name(file, where)
            (n_points,) = _unpack(file, _COUNT, where)
            end = file.tell() + n_points * _POINT_BYTES
            if end > size:
                raise DataSetError(f"{where}: the file ends before its points do; write it again.")
            file.seek(end)
            yield where, [str(number), *map(repr, pose), str(camera), name]


def camera_lines(path: Path, used: set[str]) -> list[str]:
    """What ``cameras.bin`` says of the cameras that are used, as the lines of ``cameras.txt``.

    Those behind a model that is not known are left out: its length is not known either.

    Raises
    ------
    DataSetError
        If the file is damaged.
    """
    lines = []
    check_regular(path, DataSetError)
    with _opened(path) as file:
        (n_cameras,) = _unpack(file, _COUNT, path)
        for _ in range(n_cameras):
            number, model, width, height = _unpack(file, _CAMERA, path)
            if model not in _MODELS:
                break
            name, n_parameters = _MODELS[model]
            parameters = _unpack(file, Struct(f"<{n_parameters}d"), path)
            if str(number) in used:
                shown = " ".join(f"{x:.12g}" for x in parameters)
                lines.append(f"{number} {name} {width} {height} {shown}")
    return lines


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with open(path, "rb") as file:
            yield file
    except OSError as error:
        raise DataSetError(f"{path} cannot be read ({words(error)}).") from error


def _unpack(file: BinaryIO, form: Struct, where: Path | str) -> tuple[Any, ...]:
    content = file.read(form.size)
    if len(content) < form.size:
        raise DataSetError(f"{where}: the file ends too early; write it again.")
    return form.unpack(content)


def _name(file: BinaryIO, where: str) -> str:
    """Text up to a byte of zero."""
    name = bytearray()
    while (byte := file.read(1)) != b"\0":
        name += byte
        if not byte or len(name) > _LONGEST_NAME:
            raise DataSetError(f"{where}: the name of the image does not end; write it again.")
    try:
        return name.decode()
    except UnicodeDecodeError as error:
        raise DataSetError(f"{where}: the name of the image is not UTF-8.") from error
