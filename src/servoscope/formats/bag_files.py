"""Messages of rosbag 1, rosbag 2 and MCAP files, one after the other; nothing large is kept.

Chunks and messages declare their sizes and are not unpacked beyond them.
"""

from __future__ import annotations

import bz2
import shutil
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from servoscope.errors import DataSetError
from servoscope.formats.folder import natural
from servoscope.storage.reading import check_regular, words

LARGEST_CHUNK = 2**29
"""Most bytes of a chunk or a message once it is unpacked."""

_ENDINGS = (".bag", ".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
_ANY_SIZE = 2**63
_SHARE_OF_DISK = 0.8
_ZSTD = b"\x28\xb5\x2f\xfd"


FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types of messages that hold transforms between frames, of ROS 2 and of ROS 1."""


class Message(NamedTuple):
    """A message: the file it is in, its topic, when it was logged [ns], and its fields."""

    file: int
    topic: str
    logged: int
    fields: Any


class Bag:
    """The messages of one recording, which may be in several files.

    Parameters
    ----------
    path : Path
    readers : list
        Open readers of rosbags, one a file.
    """

    def __init__(self, path: Path, readers: list[Any]) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.path, self._readers = path, readers
        ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
        for name in FRAMES:
            if name not in ros1.types:
                ros1.register(
                    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name)
                )
        self._decode: list[Callable[[bytes, str], Any]] = [
            ros1.deserialize_ros1 if _is_ros1(reader) else ros2.deserialize_cdr
            for reader in readers
        ]
        self.types: dict[str, str] = {}
        self.counts: Counter[str] = Counter()
        for reader in readers:
            for connection in reader.connections:
                self.types[connection.topic] = connection.msgtype
                self.counts[connection.topic] += connection.msgcount

    def of_types(self, types: Collection[str]) -> list[str]:
        """The topics that hold messages of one of some types."""
        return [t for t, kind in sorted(self.types.items()) if kind in types and self.counts[t]]

    def listing(self) -> str:
        """The topics with their types and how many messages they have."""
        found = [f"{t} ({self.types[t]}, {self.counts[t]})" for t in sorted(self.types)]
        return ", ".join(found) or "none"

    def messages(
        self,
        topics: Collection[str],
        file: int | None = None,
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[Message]:
        """The messages of some topics, file by file in the order in which they were logged.

        Parameters
        ----------
        topics : collection of str
        file : int, optional
            Of one file alone.
        start, stop : int, optional
            Logged from and before, [ns].

        Raises
        ------
        DataSetError
            If a file is damaged, or something in it would be unpacked to more than it declares.
        """
        for number, reader in enumerate(self._readers):
            connections = [c for c in reader.connections if c.topic in topics]
            if not connections or file not in (None, number):
                continue
            try:
                for connection, logged, raw in reader.messages(connections, start, stop):
                    raw = _unpacked(raw)
                    fields = self._decode[number](raw, connection.msgtype)
                    yield Message(number, connection.topic, logged, fields)
            except DataSetError:
                raise
            except Exception as error:  # rosbags raises of every kind on damaged files
                raise DataSetError(
                    f"{reader.path} is damaged ({type(error).__name__}: {words(error)}); "
                    "mend it, or record it anew."
                ) from error


@contextmanager
def open_bag(src: Path) -> Iterator[Bag]:
    """The recording in a file, or in a folder of such files.

    Raises
    ------
    DataSetError
        If rosbags is not installed, there are no such files, or they cannot be read.
    """
    try:
        import rosbags  # noqa: F401
    except ImportError as error:
        raise DataSetError(
            "Bags are read by the package rosbags, which is not installed; install "
            "servoscope[bags]."
        ) from error
    files = _files(src)
    with ExitStack() as stack:
        readers = []
        for path in files:
            check_regular(path, DataSetError, _ANY_SIZE)
            try:
                readers.append(stack.enter_context(_reader(_unpacked_file(path, stack))))
            except DataSetError:
                raise
            except Exception as error:  # rosbags raises of every kind on damaged files
                raise DataSetError(
                    f"{path} cannot be read ({type(error).__name__}: {words(error)}); name a "
                    "rosbag 1 file, or a rosbag 2 folder or file of SQLite or MCAP."
                ) from error
            _bound_chunks(readers[-1], path)
        yield Bag(src, readers)


def _files(src: Path) -> list[Path]:
    if not src.exists():
        raise DataSetError(f"{src} does not exist; name a bag, or the folder of a rosbag 2.")
    if not src.is_dir():
        if not src.name.endswith(_ENDINGS):
            raise DataSetError(f"{src} must end with one of {', '.join(_ENDINGS)}.")
        return [src]
    found = [f for f in src.iterdir() if f.name.endswith(_ENDINGS)]
    if not found:
        raise DataSetError(f"{src} holds no file that ends with one of {', '.join(_ENDINGS)}.")
    return sorted(found, key=lambda file: natural(file.name))


def _reader(path: Path) -> Any:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    return Reader1(path) if path.suffix == ".bag" else Reader2(path)


def _is_ros1(reader: Any) -> bool:
    from rosbags.rosbag1 import Reader

    return isinstance(reader, Reader)


def _bound_chunks(reader: Any, path: Path) -> None:
    """See that no chunk is unpacked beyond its limit."""
    import lz4.frame

    if _is_ros1(reader):
        bounded = {bz2.decompress: _bz2, lz4.frame.decompress: _lz4}
        for place, chunk in reader.chunks.items():
            if chunk.datasize > LARGEST_CHUNK:
                _refuse_chunk(path, chunk.datasize)
            unpack = bounded.get(chunk.decompressor, chunk.decompressor)
            reader.chunks[place] = chunk._replace(decompressor=unpack)
        return
    for chunk in getattr(reader.storage, "chunks", ()):
        if max(chunk.uncompressed_size, chunk.compressed_size) > LARGEST_CHUNK:
            _refuse_chunk(path, chunk.uncompressed_size)
    from rosbags.rosbag2 import storage_mcap

    storage_mcap.DECOMPRESSORS.update(lz4=_lz4, zstd=_zstd)


def _refuse_chunk(path: Path, size: int) -> None:
    raise DataSetError(
        f"{path} holds a chunk of {size} bytes, more than {LARGEST_CHUNK}; record smaller chunks."
    )


def _bz2(content: bytes) -> bytes:
    return _whole(bz2.BZ2Decompressor(), content)


def _lz4(content: bytes, size: int | None = None) -> bytes:
    import lz4.frame

    return _whole(lz4.frame.LZ4FrameDecompressor(), content, size)


def _zstd(content: bytes, size: int | None = None) -> bytes:
    return _whole(_zstd_module().ZstdDecompressor(), content, size)


def _whole(decompressor: Any, content: bytes, size: int | None = None) -> bytes:
    most = LARGEST_CHUNK if size is None else size
    unpacked: bytes = decompressor.decompress(content, most + 1)
    if len(unpacked) > most or not decompressor.eof:
        raise ValueError(f"what is packed is cut off, or unpacks to more than {most} bytes")
    return unpacked


def _unpacked(raw: bytes) -> bytes:
    """A message, which rosbag 2 may have packed by itself: CDR never begins as zstd does."""
    return _zstd(bytes(raw)) if raw[:4] == _ZSTD else raw


def _unpacked_file(path: Path, stack: ExitStack) -> Path:
    """The file, or for one that is packed as a whole, what it unpacks to in a temporary folder."""
    if path.suffix != ".zstd":
        return path
    place = Path(stack.enter_context(TemporaryDirectory(prefix="servoscope-")))
    most, written, out = int(_SHARE_OF_DISK * shutil.disk_usage(place).free), 0, place / path.stem
    with _zstd_module().open(path, "rb") as packed, open(out, "wb") as unpacked:
        while block := packed.read(2**22):
            written += len(block)
            if written > most:
                raise DataSetError(
                    f"{path} unpacks to more than {most} bytes, {100 * _SHARE_OF_DISK:.0f} % of "
                    f"what is free in {place.parent}; unpack it elsewhere with zstd."
                )
            unpacked.write(block)
    return out


def _zstd_module() -> Any:
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd
    return zstd
