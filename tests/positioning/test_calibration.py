"""What a user knows of camera and poses is read from a line, and checked."""

import numpy as np
import pytest

from servoscope.cli import main
from servoscope.errors import InvalidInputError
from servoscope.keyframe import CameraModel
from servoscope.positioning.calibration import (
    TRACKER,
    Calibration,
    parse_intrinsics,
    parse_pose_noise,
)


def test_a_point_is_seen_where_opencv_sees_it() -> None:
    import cv2

    camera = parse_intrinsics("300,302,155,118,-0.1,0.05", (240, 320))
    K = np.array([[301, 0, 155], [0, 301, 118], [0, 0, 1.0]])
    points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.0], [0.0, 0.0, 1.0]])
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array([-0.1, 0.05, 0, 0]))
    seen = (pixels[0].reshape(-1, 2) + 0.5 - [160, 120]) / 320
    rays, _ = camera.rays(seen)
    np.testing.assert_allclose(rays, points[:, :2], atol=2e-4)


def test_what_is_not_given_is_left_to_the_fit() -> None:
    assert Calibration().options(is_sequence=False) == {}
    assert Calibration().options(is_sequence=True) == {"pose_noise": TRACKER}
    camera = CameraModel(0.8)
    given = Calibration(camera, (1e-4, 2e-4), 0.7).options(is_sequence=True)
    assert given == {"camera": camera, "pose_noise": (1e-4, 2e-4), "distance": 0.7}


@pytest.mark.parametrize(
    "text",
    [
        "", "300", "300,300,160", "300,300,160,120,1,2,3", "a,b,c,d", "300,300,nan,120",
        "300,400,160,120", "3,3,160,120", "300,300,900,120", "300,300,160,-5", "0,0,160,120",
        "300,300,160,120,9", "-300,-300,160,120", "inf,inf,160,120",
    ],
)  # fmt: skip
def test_bad_intrinsics_are_refused_in_a_line(text) -> None:
    with pytest.raises(InvalidInputError, match="intrinsics") as caught:
        parse_intrinsics(text, (240, 320))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "512,512,319.5,239.5,-1.5,0", "512,512,319.5,239.5,-2,1", "200,200,0,0,-0.5,0",
        "512,512,0,0,-0.3,0", "400,400,319.5,239.5,0.5,-2", "512,512,639,479,-0.3,0",
    ],
)  # fmt: skip
def test_a_lens_that_folds_the_image_is_refused_in_a_line(text) -> None:
    with pytest.raises(InvalidInputError, match="fold the image back") as caught:
        parse_intrinsics(text, (480, 640))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["512,512,319.5,239.5,-0.28,0.07", "320,320,300,250,-0.3,0.1", "600,600,320,240,0.5,0.5"],
)
def test_a_lens_as_they_are_is_taken(text) -> None:
    assert parse_intrinsics(text, (480, 640)).k1 == float(text.split(",")[4])


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "0,1", "1,0", "-1,1", "nan,1", "200,1", "1,30"])
def test_bad_pose_noise_is_refused_in_a_line(text) -> None:
    with pytest.raises(InvalidInputError, match="pose-noise"):
        parse_pose_noise(text)


@pytest.mark.parametrize(
    ("option", "value"),
    [("--intrinsics", "1,2"), ("--pose-noise", "x"), ("--distance-mm", "-3")],
)
def test_the_command_says_what_is_wrong_before_it_trains(
    option, value, plane, tmp_path, capsys
) -> None:
    plane.save(tmp_path / "data")
    out = tmp_path / "model"
    assert main(["train", str(tmp_path / "data"), "--out", str(out), option, value]) == 1
    said = capsys.readouterr().err
    assert option.removeprefix("--") in said
    assert len(said.splitlines()) == 1
    assert not out.exists()
