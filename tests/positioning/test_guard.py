"""Each check of the guard, at and beside its limit."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from planar import PIVOT, RANGES, planar_images
from servoscope.errors import InvalidInputError
from servoscope.poses import is_rigid, pose_error, poses_from_displacements, rigid_transform
from servoscope.positioning import guard
from servoscope.positioning.reference_view import image_error, thumbnail
from servoscope.positioning.result import plain
from servoscope.positioning.settings import LoopSettings

IMAGE = planar_images(np.zeros((1, 6)), 128, seed=0)[0]


def _moved(delta_p) -> np.ndarray:
    return poses_from_displacements(np.eye(4), np.asarray(delta_p, dtype=float), PIVOT)


def _error(image: np.ndarray) -> float:
    return image_error(thumbnail(image), thumbnail(IMAGE))


def test_a_white_part_that_is_clipped_in_the_reference_too_is_no_fault() -> None:
    white, half_white, whiter = (
        np.clip(IMAGE + (255.0 - np.percentile(IMAGE, q)), 0, 255).astype(np.uint8)
        for q in (40, 60, 5)
    )
    assert 0.35 < (half_white == 255).mean() < 0.5 < (white == 255).mean() < 0.65
    assert guard.exposure_fault(white, white) is None
    assert guard.exposure_fault(white, half_white) is None
    assert guard.exposure_fault(half_white, IMAGE) is None
    assert "saturated" in guard.exposure_fault(whiter, half_white)
    assert "saturated" in guard.exposure_fault(white, IMAGE)


@pytest.mark.parametrize("gain", [0.3, 0.5, 0.8, 1.2])
def test_image_error_knows_neither_gain_nor_offset(gain: float) -> None:
    assert _error((IMAGE * gain + 12).clip(0, 255).astype(np.uint8)) < 5e-3


def test_image_error_falls_on_the_way_home_even_when_noisy_or_covered() -> None:
    away = planar_images(np.linspace(1, 0, 6)[:, None] * RANGES * 0.8, 128, seed=0)
    rng = np.random.default_rng(0)
    noisy = np.clip(away + rng.normal(0, 20, away.shape), 0, 255).astype(np.uint8)
    covered = away.copy()
    covered[:, 20:77, 20:77] = 128
    for images in (away, noisy, covered):
        errors = [_error(image) for image in images]
        assert (np.diff(errors) < 0).all()
        assert errors[0] > errors[-1] + 0.05


def test_image_error_is_one_where_nothing_is_seen() -> None:
    assert _error(np.full_like(IMAGE, 7)) == 1.0


@settings(max_examples=50, deadline=None)
@example(delta_p=np.array([0.0, -1.0, 0.0, 0.25, 0.0, 1.0]), metres=0.03125, radians=0.5)
@given(
    delta_p=arrays(float, 6, elements=st.floats(-1, 1, width=32)),
    metres=st.floats(1e-3, 0.3),
    radians=st.floats(1e-3, 0.5),
)
def test_a_cut_step_reaches_a_limit_and_keeps_both_and_its_axis(delta_p, metres, radians) -> None:
    whole = _moved(delta_p * 4 * RANGES)
    cut = guard.limited(whole, PIVOT, (metres, radians))
    distance, angle = pose_error(np.eye(4), cut)
    assert is_rigid(cut)
    used = max(distance / metres, angle / radians)
    assert used <= 1 + 1e-12
    if not np.array_equal(cut, whole):
        assert 1 - 1e-5 < used <= 1
    axes = [Rotation.from_matrix(T[:3, :3]).as_rotvec() for T in (cut, whole)]
    np.testing.assert_allclose(np.cross(*axes), 0, atol=1e-9)


def test_a_cut_step_keeps_the_point_that_the_camera_turns_about() -> None:
    whole = _moved([0, 0, 0, 0.2, -0.1, 0.1])
    cut = guard.limited(whole, PIVOT, (1.0, 0.1))
    pivot = np.array([0, 0, PIVOT, 1])
    np.testing.assert_allclose(cut @ pivot, pivot, atol=1e-12)


def test_the_workspace_is_a_box_in_each_dof() -> None:
    half_widths = np.array([0.1, 0.2, 0.3, 0.1, 0.2, 0.3])
    start = _moved([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    for dof in range(6):
        for share, inside in ((0.99, True), (1.01, False)):
            offset = np.zeros(6)
            offset[dof] = -share * half_widths[dof]
            after = poses_from_displacements(start, offset, 0.0)
            reason = guard.workspace_fault(start, after, half_widths)
            assert (reason is None) == inside
    assert "rz 17.4 deg from the start, and 17.2 is the most" in reason


@pytest.mark.parametrize(
    ("asked_mm", "made_mm", "holds"),
    [(100, 81, True), (100, 79, False), (100, 121, False), (1, 0.6, True), (1, 0.4, False)],
)
def test_a_move_may_be_missed_by_a_fifth_or_half_a_millimetre(asked_mm, made_mm, holds) -> None:
    asked, made = (rigid_transform(np.eye(3), [mm / 1e3, 0, 0]) for mm in (asked_mm, made_mm))
    assert (guard.execution_fault(asked, made, LoopSettings()) is None) == holds


def test_a_turn_that_is_left_out_is_a_fault_though_the_way_is_right() -> None:
    asked = _moved([0, 0, 0, 0.1, 0, 0])
    made = rigid_transform(np.eye(3), asked[:3, 3])
    assert "5.730 deg and moved" in guard.execution_fault(asked, made, LoopSettings())


@pytest.mark.parametrize(
    ("errors", "diverging"),
    [
        ([0.1, 0.2, 0.3], True),
        ([0.5, 0.1, 0.2, 0.3], True),
        ([0.1, 0.2], False),
        ([0.1, 0.14, 0.3], False),
        ([0.1, 0.5, 0.5], False),
        ([0.1, 0.5, 0.4, 0.3], False),
        ([0.8, 0.3, 0.2, 0.1], False),
        ([0.1, 0.9, 0.3, 0.5], True),
    ],
)
def test_divergence_is_a_rise_in_two_moves(errors, diverging: bool) -> None:
    assert guard.is_diverging(errors, 0.05) == diverging


def test_the_box_and_the_steps_follow_the_reach_in_the_form_of_the_camera() -> None:
    box = LoopSettings().workspace(RANGES, PIVOT)
    np.testing.assert_allclose(1e3 * box[:2], 1.6 * (25 + 550 * np.sin(np.radians(15))))
    np.testing.assert_allclose(np.degrees(box[3:]), 1.6 * 15)
    metres, radians = LoopSettings().step_limits(RANGES, PIVOT)
    distance, angle = pose_error(np.eye(4), _moved(RANGES))
    assert distance < metres < 1.25 * distance
    assert angle < radians * 1.1
    assert LoopSettings(max_step_mm=3).step_limits(RANGES, PIVOT)[0] == 3e-3
    assert (LoopSettings().workspace(np.zeros(6), PIVOT) > 0).all()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("max_moves", -1, "max_moves must be a finite number that is not negative, got -1"),
        ("max_moves", 2.5, "whole number"),
        ("tolerance_mm", np.nan, "tolerance_mm must be a finite number"),
        ("novelty_limit", None, "novelty_limit must be a finite number"),
        ("max_step_mm", 0, "max_step_mm must be more than 0"),
        ("read_timeout_s", np.inf, "read_timeout_s must be a finite number"),
    ],
)
def test_impossible_settings_are_refused(name: str, value, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        LoopSettings(**{name: value})


def test_plain_values_are_strict_json() -> None:
    assert plain(np.array([[1.0, np.nan], [np.inf, 2]])) == [[1.0, None], [None, 2.0]]
    assert plain(None) is None


@pytest.mark.parametrize(
    ("believed", "patience", "wanders"),
    [
        ([50, 90, 80, 70], 3, True),
        ([50, 90, 80, 49], 3, False),
        ([50, 90, 80], 3, False),
        ([50, 40, 30, 20], 3, False),
        ([50, 50, 50, 50], 3, True),
        ([50, 90, 80, 70], 0, False),
    ],
)
def test_no_new_low_of_the_believed_distance_is_wandering(believed, patience, wanders) -> None:
    assert guard.is_wandering(believed, patience) == wanders
