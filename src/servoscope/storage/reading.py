"""Reading files that come from anybody: what they are and declare is checked before they are read.

Every function takes the class of the error that it raises, a message of one line that names the
file. Pipes, devices and folders are refused without being waited for; nothing larger than a stated
limit is read, decoded or unpacked.
"""

from __future__ import annotations

import io
import json
import math
import os
import stat
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from servoscope.wording import one_line

LARGEST_FILE = 2 * 2**30
"""Most bytes of a file whose format has no limit of its own."""

LARGEST_JSON = 8 * 2**20
"""Most bytes of a JSON file."""

LARGEST_TEXT = 64 * 2**20
"""Most bytes of a text file."""

MOST_LINES = 1_000_000
"""Most lines of a text file."""

LONGEST_LINE = 2**16
"""Most characters of a line of text."""

LARGEST_IMAGE = 2**26
"""Most pixels of an image."""

IMAGE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "PPM", "WEBP", "GIF", "JPEG2000", "TGA")
"""Formats of images that are decoded: those that run no other program."""

MOST_DIGITS = 40
"""Most digits of an integer in JSON."""

MOST_NESTED = 64
"""Most objects and arrays that JSON may hold inside one another."""

_FILTERS = Lock()


def check_regular(path: Path, error: type[Exception], most: int = LARGEST_FILE) -> int:
    """The bytes of a file, which must be one, and no larger than `most`.

    Raises
    ------
    error
        If the path leads to nothing, to a folder, a pipe or a device, or to a larger file.
    """
    try:
        status = path.stat()
    except FileNotFoundError as reason:
        raise error(f"{path} is missing; restore it.") from reason
    except (OSError, ValueError) as reason:
        raise error(f"{path} cannot be read ({words(reason)}).") from reason
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{path} must be a file, but is {_kind(status.st_mode)}.")
    if status.st_size > most:
        raise error(f"{path} has more than {most} bytes ({status.st_size}); make it smaller.")
    return status.st_size


def read_bytes(path: Path, error: type[Exception], most: int = LARGEST_FILE) -> bytes:
    """The content of a file.

    Raises
    ------
    error
        If it is missing, no regular file, larger than `most` bytes, or cannot be read.
    """
    check_regular(path, error, most)
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            content = file.read(most + 1)
    except OSError as reason:
        raise error(f"{path} cannot be read ({words(reason)}).") from reason
    if len(content) > most:
        raise error(f"{path} has more than {most} bytes; make it smaller.")
    return content


def read_lines(path: Path, error: type[Exception], newline: str | None = None) -> Iterator[str]:
    r"""The lines of a UTF-8 text file, with or without a byte order mark; line ends become ``\n``
    unless `newline`, as of `open`, says otherwise. `error` is raised as by `read_bytes`, or if it
    is not text, or has more than `MOST_LINES` lines, or one of more than `LONGEST_LINE` characters.
    """
    content = read_bytes(path, error, LARGEST_TEXT)
    if max(content.count(b"\n"), content.count(b"\r")) > MOST_LINES:
        raise error(f"{path} has more than {MOST_LINES} lines; divide it.")
    try:
        text = io.StringIO(content.decode("utf-8-sig"), newline=newline)
    except UnicodeDecodeError as reason:
        raise error(f"{path} is not UTF-8 ({reason.reason}); save it as such.") from reason
    if b"\0" in content:
        raise error(f"{path} is not text (it holds NUL bytes); save it as UTF-8.")
    number = 0
    while line := text.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise error(f"{path}, line {number} has more than {LONGEST_LINE} characters.")
        yield line


def read_json(path: Path, error: type[Exception], most: int = LARGEST_JSON) -> dict[str, Any]:
    """The JSON object in a file.

    Raises
    ------
    error
        As `read_bytes`, or if `parse_json` refuses its content.
    """
    content = read_bytes(path, error, most)
    try:
        value = parse_json(content)
    except ValueError as reason:
        raise error(f"{path} cannot be read as JSON ({words(reason)}).") from reason
    if not isinstance(value, dict):
        raise error(f"{path} must hold a JSON object, got a {type(value).__name__}.")
    return value


def parse_json(content: bytes) -> Any:
    """The value of strict JSON.

    What is not UTF-8, nested deeper than `MOST_NESTED`, or holds NaN, infinity or an integer of
    more than `MOST_DIGITS` digits is a ValueError.

    Examples
    --------
    >>> parse_json(b'{"n": 3}')
    {'n': 3}
    """
    try:
        value = json.loads(
            content.decode("utf-8"),
            parse_int=_parse_integer,
            parse_float=_parse_float,
            parse_constant=_refuse_constant,
        )
    except RecursionError as reason:
        raise ValueError("it is nested too deeply") from reason
    inside = [value]
    for _ in range(MOST_NESTED):
        inside = [part for whole in inside for part in _parts(whole)]
        if not inside:
            return value
    raise ValueError(f"it is nested deeper than {MOST_NESTED}")


@contextmanager
def open_image(
    path: Path, error: type[Exception], most: int = LARGEST_IMAGE
) -> Iterator[Image.Image]:
    """An image that is not decoded yet, whose header declares at most `most` pixels.

    Raises
    ------
    error
        As `read_bytes`, or if the file is no image of `IMAGE_FORMATS` or declares more pixels.
    """
    check_regular(path, error)
    try:
        file = open(path, "rb", opener=open_without_waiting)  # noqa: SIM115
    except OSError as reason:
        raise error(f"{path} cannot be read ({words(reason)}).") from reason
    with file:
        yield _checked_image(file, path, error, most)


@contextmanager
def open_image_bytes(
    content: bytes, where: str, error: type[Exception], most: int = LARGEST_IMAGE
) -> Iterator[Image.Image]:
    """An image as `open_image`, of the bytes of a file that is at hand; `where` names it.

    Raises
    ------
    error
        If they are no image of `IMAGE_FORMATS` or declare more pixels.
    """
    with io.BytesIO(content) as file:
        yield _checked_image(file, where, error, most)


def _checked_image(
    file: BinaryIO, where: Path | str, error: type[Exception], most: int
) -> Image.Image:
    try:
        # Pillow warns of large images by itself, and its filters belong to all threads.
        with _FILTERS, warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(file, formats=IMAGE_FORMATS)
    except Image.DecompressionBombError as reason:
        raise error(f"{where} declares more than {most} pixels; shrink it.") from reason
    except UnidentifiedImageError as reason:
        kinds = ", ".join(IMAGE_FORMATS)
        raise error(f"{where} is not a whole image (it is none of {kinds}).") from reason
    except Exception as reason:  # Pillow raises of every kind on damaged files
        raise error(f"{where} is not a whole image ({words(reason)}).") from reason
    if math.prod(image.size) > most:
        raise error(
            f"{where} is {image.width} x {image.height} px, more than {most} pixels; shrink it."
        )
    return image


def read_grey_png(path: Path, shape: tuple[int, int], error: type[Exception]) -> NDArray[np.uint8]:
    """The image in a file, which must be grey, of 8 bits and of the given height and width.

    Raises
    ------
    error
        As `open_image`, or if it is of another size or kind, or damaged.
    """
    with open_image(path, error) as image:
        if (image.height, image.width) != shape or image.mode != "L":
            raise error(
                f"{path} must be a grey 8-bit image of {shape[1]} x {shape[0]} px, got "
                f"{image.width} x {image.height} px of mode {image.mode}."
            )
        try:
            return np.array(image)
        except Exception as reason:  # Pillow raises of every kind on damaged files
            raise error(f"{path} is not a whole image ({words(reason)}).") from reason


def open_without_waiting(path: str, flags: int) -> int:
    """An opener for `open`: opening a pipe would wait for its other end."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _parse_integer(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"an integer has {len(text)} digits")
    return int(text)


def _parse_float(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"{text[:MOST_DIGITS]} is not finite")
    return number


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not finite")


def _parts(value: Any) -> Iterable[Any]:
    if isinstance(value, dict):
        return value.values()
    return value if isinstance(value, list) else ()


def _kind(mode: int) -> str:
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    return kinds.get(stat.S_IFMT(mode), "a device")


def without_advice(error: Exception) -> str:
    """What an error of this module says is wrong, for a caller who knows better what to do.

    Examples
    --------
    >>> without_advice(ValueError("a.png is missing; restore it."))
    'a.png is missing'
    """
    text = str(error)
    for advice in ("; restore it.", "; make it smaller.", "; shrink it."):
        text = text.removesuffix(advice)
    return text.rstrip(".")


def words(reason: Exception) -> str:
    """What an exception says of a file that is named already, on one line."""
    return one_line(getattr(reason, "strerror", None) or reason)
