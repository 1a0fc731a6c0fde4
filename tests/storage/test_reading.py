import os
import socket
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from servoscope.errors import DataSetError
from servoscope.storage import reading
from servoscope.storage.reading import (
    open_image,
    parse_json,
    read_bytes,
    read_grey_png,
    read_json,
    read_lines,
)


def read_all_lines(path, error):
    return list(read_lines(path, error))


def open_whole_image(path, error):
    with open_image(path, error) as image:
        return image.size


def refused(read, match):
    with pytest.raises(DataSetError, match=match) as caught:
        read()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("read", [read_bytes, read_all_lines, read_json, open_whole_image])
def test_what_is_no_file_is_refused_without_being_waited_for(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        for kind in ("pipe", "folder", "socket"):
            refused(
                lambda k=kind: read(tmp_path / k, DataSetError), f"must be a file, but is a {kind}"
            )
    refused(lambda: read(tmp_path / "nothing", DataSetError), "is missing")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    refused(lambda: read(tmp_path / "loop", DataSetError), "cannot be read")


def test_a_device_is_no_file(tmp_path):
    (tmp_path / "endless").symlink_to("/dev/zero")
    refused(lambda: read_bytes(tmp_path / "endless", DataSetError), "but is a device")


def test_a_file_above_the_limit_is_not_read(tmp_path, monkeypatch):
    (tmp_path / "sparse").touch()
    os.truncate(tmp_path / "sparse", 2**40)
    for read in (read_bytes, read_all_lines, read_json):
        refused(lambda r=read: r(tmp_path / "sparse", DataSetError), r"more than \d+ bytes")


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"9" * 400, "an integer has 400 digits"),
        (b"9" * 5000, "an integer has 5000 digits"),
        (b"1e400", "not finite"),
        (b"NaN", "NaN is not finite"),
        (b"-Infinity", "not finite"),
        (b"[" * 100 + b"]" * 100, "nested deeper than 64"),
        (b"[" * 200_000, "nested too deeply"),
        (b"\xff\xfe", "utf-8"),
        (b"", "Expecting value"),
    ],
)
def test_json_that_no_program_should_write_is_refused(tmp_path, content, match):
    (tmp_path / "a.json").write_bytes(b'{"n": ' + content + b"}")
    refused(lambda: read_json(tmp_path / "a.json", DataSetError), match)


def test_plain_json_is_read():
    assert parse_json(b'{"n": [1, -2.5e3, null, "\xc3\xa9", true]}') == {
        "n": [1, -2500.0, None, "é", True]
    }


def test_lines_are_told_apart_whatever_ends_them(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\xef\xbb\xbfone\r\n\r\n two\rthree")
    expected = ["one\n", "\n", " two\n", "three"]
    assert read_all_lines(tmp_path / "a.txt", DataSetError) == expected


def test_too_many_lines_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "MOST_LINES", 9)
    (tmp_path / "a.txt").write_bytes(b"\n" * 10)
    refused(lambda: read_all_lines(tmp_path / "a.txt", DataSetError), "more than 9 lines")
    (tmp_path / "a.txt").write_bytes(b"\n" + b"," * 2**20)
    refused(lambda: read_all_lines(tmp_path / "a.txt", DataSetError), "line 2 has more than 65536")


@pytest.mark.parametrize("side", [9_000, 12_000, 40_000])
def test_an_image_is_not_decoded_if_it_declares_too_many_pixels(tmp_path, side):
    Image.new("1", (1, 1)).save(tmp_path / "a.png")
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[16:24] = struct.pack(">II", side, side)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    (tmp_path / "a.png").write_bytes(content)
    refused(lambda: open_whole_image(tmp_path / "a.png", DataSetError), "more than 67108864 pixels")


def test_pictures_that_other_programs_would_draw_are_refused(tmp_path):
    Image.new("L", (2, 2)).save(tmp_path / "a.eps")
    refused(lambda: open_whole_image(tmp_path / "a.eps", DataSetError), "is none of PNG, JPEG")


def test_a_grey_image_must_have_the_size_that_is_wanted(tmp_path):
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)
    Image.fromarray(image).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_grey_png(tmp_path / "a.png", (3, 4), DataSetError), image)
    refused(
        lambda: read_grey_png(tmp_path / "a.png", (4, 3), DataSetError),
        "grey 8-bit image of 3 x 4 px, got 4 x 3 px of mode L",
    )
    (tmp_path / "a.png").write_bytes((tmp_path / "a.png").read_bytes()[:50])
    refused(lambda: read_grey_png(tmp_path / "a.png", (3, 4), DataSetError), "not a whole image")
