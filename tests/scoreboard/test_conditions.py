"""The conditions of the scoreboard: their names, and what each of them changes."""

from dataclasses import replace

import numpy as np
import pytest

from servoscope.poses import displacements_from_poses, pose_error
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane
from servoscope.scoreboard.cell import CONDITIONS, PIVOT, RANGES, SCENES, robot_at_start, start_pose

NAMES = (
    "range_0.4 range_1.0 range_1.5 gain_0.8 gain_0.95 light_moved covered_10 covered_20 noise_10 "
    "defocus depth_0.6 depth_1.5 other_casting repeatability arm stale_frames light_falloff planar"
)
PLANE = Scene(TexturedPlane(), image_size=128)


def seen(condition: str, number: int = 3, noisy: bool = False) -> np.ndarray:
    rng = np.random.default_rng(0) if noisy else None
    return render(CONDITIONS[condition].change(PLANE, number), T_WORLD_REF, rng).astype(float)


def test_names_and_their_order_are_those_that_are_published() -> None:
    assert " ".join(CONDITIONS) == NAMES
    assert SCENES == ("cylinder_head", "textured_plane")


@pytest.mark.parametrize("name", [n for n in CONDITIONS if n.startswith(("range", "depth"))])
def test_ranges_and_depths_leave_the_scene_alone(name: str) -> None:
    condition = CONDITIONS[name]
    assert condition.change(PLANE, 5) == PLANE
    kind, _, number = name.partition("_")
    assert {"range": condition.factor, "depth": condition.depth_factor}[kind] == float(number)
    assert condition.is_for_baseline_alone == (kind == "depth" or name == "range_1.0")


@pytest.mark.parametrize("gain", [0.8, 0.95])
def test_gain_scales_every_grey_level(gain: float) -> None:
    np.testing.assert_allclose(seen(f"gain_{gain:g}"), gain * seen("range_1.0"), atol=1.0)


@pytest.mark.parametrize("percent", [10, 20])
def test_a_share_of_the_view_is_covered_elsewhere_at_each_start(percent: int) -> None:
    plain = seen("range_1.0")
    a, b = (seen(f"covered_{percent}", number) != plain for number in (1, 2))
    assert (a.mean(), b.mean()) == pytest.approx((percent / 100, percent / 100), abs=0.01)
    assert (a != b).any()


def test_noise_has_a_deviation_of_ten_grey_levels() -> None:
    difference = seen("noise_10", noisy=True) - seen("noise_10")
    assert difference.std() == pytest.approx(10.0, rel=0.05)


def test_defocus_smooths_as_two_pixels_of_256_do() -> None:
    blur = CONDITIONS["defocus"].change(PLANE, 0).sensor.blur
    assert blur == pytest.approx(np.hypot(PLANE.sensor.blur, 2 / 256))
    assert np.diff(seen("defocus")).std() < 0.7 * np.diff(seen("range_1.0")).std()


def test_a_moved_light_is_the_first_one_moved_by_30_cm() -> None:
    before, after = PLANE.lighting.lamps, CONDITIONS["light_moved"].change(PLANE, 0).lighting.lamps
    moved = np.linalg.norm(np.subtract(after[0].position, before[0].position))
    assert moved == pytest.approx(0.3)
    assert after[1:] == before[1:]
    assert after[0].strength == before[0].strength
    assert np.abs(seen("light_moved") - seen("range_1.0")).mean() > 1


def test_another_casting_of_the_plane_is_the_same_but_for_some_of_it() -> None:
    differs = np.abs(seen("other_casting") - seen("range_1.0")) > 10
    assert 0.01 < differs.mean() < 0.08


def test_another_casting_of_the_head_is_the_other_variant() -> None:
    head = Scene()
    changed = CONDITIONS["other_casting"].change(head, 0)
    assert changed == replace(head, part=replace(head.part, variant=1))


def test_starts_fill_the_range_and_hang_on_the_seed() -> None:
    poses = np.stack([start_pose(5, start, 1.5) for start in range(200)])
    delta_p = displacements_from_poses(T_WORLD_REF, poses, PIVOT) / RANGES
    assert np.abs(delta_p).max() <= 1.5
    assert (np.abs(delta_p).max(axis=0) > 1.4).all()
    np.testing.assert_array_equal(start_pose(5, 3, 1.0), start_pose(5, 3, 1.0))
    assert pose_error(start_pose(5, 3, 1.0), start_pose(6, 3, 1.0))[0] > 1e-3


def test_every_method_sees_the_same_first_image() -> None:
    first, again, other = (
        robot_at_start("textured_plane", "noise_10", 32, 0, start).read() for start in (4, 4, 5)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_an_arm_starts_with_its_camera_where_a_free_one_does() -> None:
    free, arm = (
        robot_at_start("textured_plane", name, 16, 0, 1).true_pose for name in ("range_1.0", "arm")
    )
    distance, angle = pose_error(free, arm)
    assert distance < 1e-5
    assert angle < 1e-4


def test_stale_frames_show_where_the_camera_was_one_read_ago() -> None:
    robot = robot_at_start("textured_plane", "stale_frames", 32, 0, 4)
    prompt = robot_at_start("textured_plane", "range_1.0", 32, 0, 4)
    before = robot.read().astype(float)
    for cell in (robot, prompt):
        cell.move_to(T_WORLD_REF)
    late, new, seen_there = (camera.read().astype(float) for camera in (robot, robot, prompt))
    assert np.abs(late - before).mean() < 5 < np.abs(late - seen_there).mean()
    assert np.abs(new - seen_there).mean() < 5


def test_strengths_mean_the_same_for_images_as_for_the_scene() -> None:
    image, rng = render(PLANE, T_WORLD_REF), np.random.default_rng(0)
    for name in ("gain_0.8", "defocus"):
        disturbed = CONDITIONS[name].disturbances().disturb(image, rng).astype(float)
        assert np.abs(disturbed - seen(name)).mean() < 1
    covered = CONDITIONS["covered_20"].disturbances().disturb(image, rng)
    assert (covered != image).mean() == pytest.approx(0.2, abs=0.01)


def test_conditions_that_need_a_scene_are_not_of_images() -> None:
    assert [n for n in CONDITIONS if not CONDITIONS[n].is_of_images] == [
        "depth_0.6", "depth_1.5", "other_casting", "arm", "planar"
    ]  # fmt: skip
