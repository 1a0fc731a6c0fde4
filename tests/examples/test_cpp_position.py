"""The C++ example is compiled, and says where the model would have the robot go."""

import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from servoscope.export.onnx_model import to_onnx
from servoscope.poses import poses_from_displacements
from small_keyframe import shown, small_model, texture

onnxruntime = pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "examples" / "cpp" / "position.cpp"
HEADERS = (
    os.environ.get("ONNXRUNTIME_INCLUDE", ""),
    ROOT / "build" / "onnxruntime" / "include",
    "/usr/include/onnxruntime",
    "/usr/include/onnxruntime/core/session",
    "/usr/local/include/onnxruntime",
)


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The example, linked with the library of the wheel."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    headers = [folder for folder in HEADERS if (Path(folder) / "onnxruntime_cxx_api.h").exists()]
    libraries = list(Path(onnxruntime.__file__).parent.glob("capi/libonnxruntime.so.*"))
    if compiler is None:
        pytest.skip("needs a compiler of C++")
    if not headers:
        pytest.skip("needs headers: .ci/onnxruntime_headers build/onnxruntime/include")
    if not libraries:
        pytest.skip("needs the library of onnxruntime as its wheels for Linux have it")
    folder = tmp_path_factory.mktemp("cpp")
    for name in ("libonnxruntime.so", "libonnxruntime.so.1"):
        (folder / name).symlink_to(libraries[0])
    options = ["-std=c++20", "-Wall", "-Wextra", "-Werror", "-isystem", str(headers[0])]
    link = ["-o", str(folder / "position"), f"-L{folder}", "-lonnxruntime", f"-Wl,-rpath,{folder}"]
    subprocess.run([compiler, *options, str(SOURCE), *link], check=True)
    return folder / "position"


POSE = poses_from_displacements(np.eye(4), np.array([0.4, -0.1, 0.5, 3.0, 0.1, 0.4]), 0.0)


@pytest.fixture(scope="module")
def model():
    box = [[0.3, None, 0.4], [0.5, 0.0, None]]
    return replace(small_model(guesses=False), trained_on={"workspace": box})


@pytest.fixture(scope="module")
def file(model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.onnx"
    path.write_bytes(to_onnx(model))
    return path


def run(program, file, image, tmp_path, pose=POSE):
    path = tmp_path / "image.pgm"
    cv2.imwrite(str(path), image)
    return subprocess.run(
        [program, file, path],
        input="\n".join(" ".join(map(repr, row)) for row in np.asarray(pose).tolist()),
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_it_is_no_longer_than_a_page():
    assert len(SOURCE.read_text().splitlines()) <= 50


def test_it_goes_where_the_model_would_have_it_go(program, file, model, tmp_path):
    image = shown(model)[1]
    ended = run(program, file, image, tmp_path)
    assert ended.returncode == 0, ended.stderr
    goal = np.array([line.split() for line in ended.stdout.splitlines()], float)
    expected = POSE @ np.linalg.inv(model.estimate(image).displacement)
    np.testing.assert_allclose(goal, expected[:3], atol=1e-6)


def test_it_stops_where_nothing_is_recognised(program, file, tmp_path):
    ended = run(program, file, texture((48, 64), 77).astype(np.uint8), tmp_path)
    assert (ended.returncode, ended.stdout) == (2, "not recognised: do not move\n")


def test_it_stops_at_the_reference(program, file, model, tmp_path):
    ended = run(program, file, model.reference_image, tmp_path)
    assert (ended.returncode, ended.stdout) == (0, "arrived: nearer than is known\n")


@pytest.mark.parametrize("pose", [np.eye(4), POSE + [[0], [0.2], [0], [0]] @ np.eye(4)[3:]])
def test_it_does_not_leave_the_workspace_of_the_images(program, file, model, tmp_path, pose):
    ended = run(program, file, shown(model)[1], tmp_path, pose)
    assert (ended.returncode, ended.stdout) == (3, "outside the workspace: do not move\n")


@pytest.mark.parametrize("pose", [np.eye(3), np.full((4, 4), np.nan)])
def test_a_pose_that_is_none_moves_nothing(program, file, model, tmp_path, pose):
    ended = run(program, file, shown(model)[1], tmp_path, pose)
    assert ended.returncode in (1, 3)
    assert "." not in ended.stdout


@pytest.mark.parametrize(
    "content", [b"", b"P2\n64 48\n255\n", b"P5\n64 48\n255\n12", b"P5\n8 8\n255\n" + bytes(64)]
)
def test_what_is_no_image_of_the_model_ends_it_in_a_line(program, file, tmp_path, content):
    image = tmp_path / "image.pgm"
    image.write_bytes(content)
    ended = subprocess.run([program, file, image], capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert ended.stderr.startswith("position: ")
    assert ended.stdout == ""
