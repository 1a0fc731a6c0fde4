"""What a viewer shows stands where closed forms say that it does."""

import cv2
import numpy as np
import pytest

from planar import RANGES
from planar_cell import Cell, Oracle
from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.keyframe import CameraModel
from servoscope.poses import DOFS, poses_from_displacements
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.result import Step
from servoscope.viewer.history import History, Look, Relief, Setting
from small_keyframe import MOUNT, PIVOT, displacements, small_model


@pytest.fixture(scope="module")
def model():
    return small_model(guesses=False)


def step(D: np.ndarray, commanded: np.ndarray | None = None, std: float = 1e-3) -> Step:
    return Step(np.eye(4), 0.1, Estimate(D, np.full(6, std), 0.1, "fine"), commanded, None, 0.01)


def test_points_of_the_relief_are_seen_by_opencv_at_the_pixels_that_they_are_of(model) -> None:
    relief = Relief.of(model.keyframe)
    camera, (height, width) = model.keyframe.camera, model.image_shape
    middle = [(width - 1) / 2 + width * camera.cx, (height - 1) / 2 + width * camera.cy]
    K = np.array([[width * camera.f, 0, middle[0]], [0, width * camera.f, middle[1]], [0, 0, 1]])
    distortion = np.array([camera.k1, camera.k2, 0, 0])
    points = relief.points.astype(float)
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, distortion)
    columns, rows = pixels[:, 0].T
    np.testing.assert_allclose(columns, columns.round(), atol=1e-3)
    np.testing.assert_allclose(rows, rows.round(), atol=1e-3)
    seen = model.reference_image[rows.round().astype(int), columns.round().astype(int)]
    np.testing.assert_array_equal(relief.grey, seen)


def test_points_are_as_deep_as_the_keyframe_says_and_those_not_used_are_left_out() -> None:
    relief = Relief.of(small_model(depth=2.5, guesses=False).keyframe)
    np.testing.assert_allclose(relief.points[:, 2], 1 / 2.5, rtol=1e-6)
    assert 0.95 * 48 * 64 < len(relief.points) < 48 * 64
    neighbours = np.linalg.norm(np.diff(relief.points[-20:], axis=0), axis=1)
    assert relief.spacing == pytest.approx(np.median(neighbours), rel=0.2)


def test_what_informs_rotations_alone_has_no_relief() -> None:
    assert Relief.of(small_model(depth=1e-6, guesses=False).keyframe) is None


def test_colours_are_the_image_or_brighter_where_nearer_and_better_trusted() -> None:
    points = np.column_stack([np.zeros((50, 2)), np.linspace(0.4, 0.6, 50)]).astype(np.float32)
    grey, trust = np.arange(50, dtype=np.uint8), np.linspace(0, 1, 50, dtype=np.float32)
    relief = Relief(points, grey, trust, 0.01)
    np.testing.assert_array_equal(relief.colours("image"), np.stack([grey] * 3, axis=1))
    near, trusted = (relief.colours(by).sum(axis=1, dtype=int) for by in ("depth", "trust"))
    assert near[0] > near[25] > near[-1]
    assert trusted[0] < trusted[25] < trusted[-1]
    assert tuple(relief.colours("trust")[-1]) == (253, 231, 37)  # the end of viridis


def test_a_camera_on_a_flange_stands_where_the_mount_puts_it(model) -> None:
    setting, D = Setting.of_estimator(model), displacements(1, seed=4)[0]
    look = Look.of_step(step(D, np.linalg.inv(D)), model.reference_image, setting)
    np.testing.assert_allclose(MOUNT @ look.camera, D @ MOUNT, atol=1e-12)
    np.testing.assert_allclose(look.next_camera, np.eye(4), atol=1e-12)


def test_believed_dofs_have_a_band_of_two_deviations_in_mm_and_deg() -> None:
    setting = Setting(np.zeros((4, 4), np.uint8), PIVOT)
    history = History(setting)
    for share in (1.0, 0.5):
        delta_p = share * np.array([0.01, 0.02, -0.03, 0.1, -0.2, 0.3])
        D = poses_from_displacements(np.eye(4), delta_p, PIVOT)
        history.looks.append(Look.of_step(step(D), setting.reference_image, setting, truth=D))
    tx, rz = history.series("tx"), history.series("rz")
    np.testing.assert_array_equal(tx.number, [1, 2])
    np.testing.assert_allclose(tx.believed, [10, 5])
    np.testing.assert_allclose(tx.high - tx.low, 4.0)
    np.testing.assert_allclose(rz.believed, np.degrees([0.3, 0.15]))
    np.testing.assert_allclose(rz.low, rz.believed - np.degrees(2e-3))
    np.testing.assert_allclose(rz.truth, rz.believed)


def test_where_no_deviation_is_believed_the_band_is_closed_and_the_truth_may_be_unknown() -> None:
    setting = Setting(np.zeros((4, 4), np.uint8), PIVOT)
    look = Look.of_step(step(np.eye(4), std=np.nan), setting.reference_image, setting)
    series = History(setting, [look]).series("tx")
    assert series.low == series.believed == series.high
    assert np.isnan(series.truth)


def test_the_difference_is_white_where_equal_red_where_brighter_blue_where_darker() -> None:
    image = np.array([[100, 180, 20], [100, 132, 68]], np.uint8)
    setting = Setting(np.full((2, 3), 100, np.uint8), PIVOT)
    history = History(setting, [Look.of_step(step(np.eye(4)), image, setting)])
    white, red, blue = (255, 255, 255), (255, 0, 0), (0, 0, 255)
    shown = [tuple(pixel) for pixel in history.difference(0).reshape(-1, 3)]
    assert shown == [white, red, blue, white, (255, 128, 128), (128, 128, 255)]


def test_the_path_of_a_run_ends_at_the_reference() -> None:
    cell = Cell(0.5 * RANGES)
    estimator = Oracle(cell, std=0.01)
    history = History(Setting.of_estimator(estimator))

    def note(step: Step, image: np.ndarray) -> None:
        history.looks.append(Look.of_step(step, image, history.setting))

    Positioner(estimator).run(cell, cell, on_step=note)
    path = history.path()
    assert len(path) > 1
    first = poses_from_displacements(np.eye(4), 0.5 * RANGES, estimator.pivot)
    np.testing.assert_allclose(path[0], first[:3, 3])
    assert np.linalg.norm(path[-1]) < 1e-3 * np.linalg.norm(path[0])
    assert history.looks[-1].next_camera is None


def test_images_of_a_data_set_stand_where_the_robot_said(model) -> None:
    poses = displacements(3, seed=7)
    T_ref = MOUNT
    images = np.stack([model.keyframe.render(D)[0] for D in poses])
    data = PoseImageSet(images, T_ref @ poses, T_ref, model.reference_image)
    history = History.of_data_set(data)
    for look, D in zip(history.looks, poses, strict=True):
        np.testing.assert_allclose(look.camera, D, atol=1e-12)
        assert np.isnan(look.std).all()
    assert History.of_data_set(data, model).setting.relief is not None
    with pytest.raises(InvalidInputError, match="same reference image"):
        History.of_data_set(data, small_model((24, 32), guesses=False))


def test_the_field_of_view_is_that_of_the_camera(model) -> None:
    setting = Setting.of_estimator(model)
    assert np.tan(setting.field_of_view / 2) == pytest.approx(0.5 * 48 / 64 / 1.4)
    assert setting.dofs == DOFS
    assert setting.distance == pytest.approx(0.5, rel=0.1)
    assert isinstance(model.keyframe.camera, CameraModel)


@pytest.mark.parametrize("fault", ["size", "displacement", "move"])
def test_looks_that_cannot_be_shown_are_refused_in_one_line(fault: str) -> None:
    setting = Setting(np.zeros((4, 6), np.uint8), PIVOT)
    image = np.zeros((4, 4 if fault == "size" else 6), np.uint8)
    broken = np.full((4, 4), np.nan)
    D, move = (broken if fault == name else np.eye(4) for name in ("displacement", "move"))
    with pytest.raises(InvalidInputError) as refused:
        Look.of_step(step(D, move), image, setting)
    assert "\n" not in str(refused.value)
