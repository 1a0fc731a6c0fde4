"""What commands print is printed in every encoding, without streams, and commands no terminal."""

import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import cv2
import numpy as np
import pytest

from servoscope.cli import main
from servoscope.commands.output import console, print_facts, print_json, progress_bar
from servoscope.data.images import PoseImageSet

ENCODINGS = ("cp932", "cp437", "latin-1", "ascii", "utf-8")
COMMANDS = (
    *((), ("study",), ("acquire",), ("assess",), ("train",), ("position",), ("sensitivity",)),
    *(("report",), ("info",), ("import",), ("import", "folder"), ("import", "tum")),
    *(("benchmark",), ("benchmark", "positioning")),
)
HOSTILE = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202e\r\x7f"
TERMINAL = "\x1b\x07\x9b\u202e\r\x7f"


def source_with_names(folder: Path, *names: str) -> None:
    """A table of poses for images of these names."""
    rows = [f"{name},0,0,{i},0,0,0,1\n" for i, name in enumerate(names)]
    text = "name,tx,ty,tz,qx,qy,qz,qw\n" + "".join(rows)
    (folder / "poses.csv").write_text(text, encoding="utf-8")


class Streams:
    """Standard streams of an encoding, as the whole process has them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, encoding: str) -> None:
        self.encoding, self.monkeypatch = encoding, monkeypatch

    def run(self, *arguments: str) -> tuple[int, str, str]:
        written = io.BytesIO(), io.BytesIO()
        with self.monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["servoscope", *arguments])
            for name, raw in zip(("stdout", "stderr"), written, strict=True):
                patch.setattr(sys, name, io.TextIOWrapper(raw, encoding=self.encoding))
            try:
                code = main()
            except SystemExit as ended:
                code = ended.code
            sys.stdout.flush()
            sys.stderr.flush()
            out, err = (raw.getvalue().decode(self.encoding) for raw in written)
            sys.stdout.detach()
            sys.stderr.detach()
        return code, out, err


@pytest.fixture(params=ENCODINGS)
def streams(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Streams:
    return Streams(monkeypatch, request.param)


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_is_printed(streams: Streams, command: tuple[str, ...]) -> None:
    code, out, err = streams.run(*command, "--help")
    assert (code, err) == (0, "")
    assert "usage: servoscope" in out


def test_tables_and_errors_are_printed(streams: Streams, tmp_path: Path, plane: PoseImageSet):
    folder = tmp_path / "größe ± 日本"
    plane.save(folder)
    code, out, err = streams.run("info", str(folder))
    assert (code, err) == (0, "")
    assert ("größe ± 日本" if streams.encoding == "utf-8" else "gr") in out
    code, out, err = streams.run("info", str(folder / "ÿ"))
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert "is not a folder" in err
    code, out, err = streams.run("info", "--größe")
    assert (code, out) == (2, "")


def test_what_ascii_lacks_is_written_with_what_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("servoscope.commands.info.describe_installation", lambda: {"a": "±5° é"})
    assert Streams(monkeypatch, "ascii").run("info")[1].split() == ["a", "+-5", "deg", "\\xe9"]


@pytest.mark.skipif(os.name != "posix", reason="closes descriptors")
@pytest.mark.parametrize("closed", [(1,), (2,), (0, 1, 2)])
def test_commands_work_without_streams(closed: tuple[int, ...], tmp_path: Path) -> None:
    def close() -> None:
        for descriptor in closed:
            os.close(descriptor)

    source_with_names(tmp_path, "a.png", "b.png")
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), np.uint8(9 * np.eye(24) * np.arange(5, 29)))
    command = ["import", "folder", str(tmp_path), str(tmp_path / "data")]
    done = subprocess.run(
        [sys.executable, "-m", "servoscope", *command], preexec_fn=close, check=True
    )
    assert done.returncode == 0
    assert len(PoseImageSet.load(tmp_path / "data")) == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_an_output_that_cannot_be_written_is_one_line() -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "servoscope", "--version"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
        )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "No space left on device" in line


def is_harmless(text: str) -> bool:
    return not set(text) & set(TERMINAL)


def test_names_in_errors_command_no_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    source_with_names(tmp_path, f"{HOSTILE}.png".replace("\r", ""), "b.png")
    for debug in ((), ("--debug",)):
        assert main(["import", "folder", str(tmp_path), str(tmp_path / "out"), *debug]) == 1
        err = capsys.readouterr().err
        assert "?[2J?]0;owned?" in err
        assert is_harmless(err)


def test_names_in_wrong_usage_command_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    for wrong in (["acquire", "out", "--part", HOSTILE], [f"--{HOSTILE}"], [HOSTILE]):
        with pytest.raises(SystemExit, match="2"):
            main(wrong)
        err = capsys.readouterr().err
        assert "owned" in err
        assert is_harmless(err)


def test_warnings_command_no_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def warn() -> dict[str, str]:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn(HOSTILE, stacklevel=1)
        return {}

    monkeypatch.setattr("servoscope.commands.info.describe_installation", warn)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    assert main(["info"]) == 0
    err = capsys.readouterr().err
    assert err.startswith("servoscope: warning: ?[2J?]0;owned?")
    assert is_harmless(err)


def test_tables_and_json_command_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    print_facts({"a": HOSTILE, "b": [{HOSTILE: HOSTILE}]})
    console().print(HOSTILE, HOSTILE, soft_wrap=True)
    print_json({HOSTILE: HOSTILE})
    out = capsys.readouterr().out
    assert out.count("owned") == 7
    assert is_harmless(out)


@pytest.mark.parametrize("is_terminal", [False, True])
def test_progress_commands_no_terminal_but_its_own(
    is_terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if is_terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
        monkeypatch.setenv("TERM", "xterm")
    with progress_bar(HOSTILE, 2) as advance:
        advance(2)
    err = capsys.readouterr().err
    assert "owned" in err
    assert "\x1b]0" not in err
    assert not set(err) & {"\x07", "\x9b", "\u202e", "\x7f"}
    assert is_terminal or is_harmless(err)


def test_names_of_images_that_cannot_be_decoded_command_no_terminal(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Libraries write to the descriptor itself, past Python."""
    name = HOSTILE.replace("\r", "").replace("/", "") + ".png"
    source_with_names(tmp_path, name, "b.png")
    cv2.imwrite(str(tmp_path / "b.png"), np.eye(24, dtype=np.uint8))
    _, png = cv2.imencode(".png", np.eye(24, dtype=np.uint8))
    (tmp_path / name).write_bytes(png.tobytes()[:40])
    assert main(["import", "folder", str(tmp_path), str(tmp_path / "out")]) == 1
    err = capfd.readouterr().err
    assert "owned" in err
    assert is_harmless(err)
