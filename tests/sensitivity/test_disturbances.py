"""What each disturbance does to the scene or to the camera, against closed forms."""

import numpy as np
import pytest

from servoscope.poses import DISPLAY_FACTORS, DOFS, displacements_from_poses
from servoscope.scene.render import render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane
from servoscope.sensitivity import DISTURBANCES
from servoscope.sensitivity.disturbances import Look

SCENE = Scene(part=TexturedPlane(), image_size=64)


def disturbed(name, strength, rng=None):
    return DISTURBANCES[name].change(Look(SCENE), strength, rng)


@pytest.mark.parametrize(("name", "axis"), [("principal_point_x", 1), ("principal_point_y", 0)])
def test_a_principal_point_farther_moves_what_is_seen_by_as_much(name, axis):
    clean = render_radiance(SCENE, T_WORLD_REF)
    moved = render_radiance(disturbed(name, 4.0).scene, T_WORLD_REF)  # 4 px of 256 are 1 of 64
    shifted = np.delete(moved, 0, axis) - np.delete(clean, -1, axis)
    assert np.abs(shifted).max() < 1e-4
    assert np.abs(moved - clean).max() > 0.1


def test_a_focal_length_of_5_percent_more_moves_points_5_percent_outwards():
    point = [0.05, -0.03, 0.5]
    middle = SCENE.lens.camera_matrix(64)[:2, 2]
    seen, longer = (
        scene.lens.project(point, 64) - middle
        for scene in (SCENE, disturbed("focal_length", 5.0).scene)
    )
    assert longer == pytest.approx(1.05 * seen)


def test_k1_moves_points_outwards_by_the_cube_of_their_distance():
    point = np.array([0.05, 0.0, 0.5])
    by = disturbed("distortion_k1", 0.02).scene.lens.project(point, 64) - SCENE.lens.project(
        point, 64
    )
    assert by == pytest.approx([SCENE.lens.focal_length * 64 * 0.02 * 0.1**3, 0.0])


def test_blurs_add_up_as_variances():
    blur = disturbed("defocus", 2.0).scene.sensor.blur
    assert (256 * blur) ** 2 == pytest.approx((256 * SCENE.sensor.blur) ** 2 + 4.0)


def test_gain_is_in_percent_and_light_in_millimetres():
    assert disturbed("gain", -20.0).scene.sensor.gain == pytest.approx(0.8)
    before, after = (scene.lighting.lamps for scene in (SCENE, disturbed("light_z", 300.0).scene))
    assert np.subtract(after[0].position, before[0].position) == pytest.approx([0, 0, 0.3])
    assert after[1] == before[1]


@pytest.mark.parametrize("axis", range(6))
def test_a_remounted_camera_is_displaced_in_one_dof_alone(axis):
    departure = disturbed(f"hand_eye_{DOFS[axis]}", 0.5).departure
    by = displacements_from_poses(np.eye(4), departure, pivot=0.0) * DISPLAY_FACTORS
    assert by == pytest.approx(0.5 * np.eye(6)[axis])


@pytest.mark.parametrize(("name", "moved"), [("mm", slice(0, 3)), ("deg", slice(3, 6))])
def test_a_robot_rests_with_the_deviation_that_is_asked_for(name, moved):
    rng = np.random.default_rng(0)
    departures = [disturbed(f"repeatability_{name}", 0.3, rng).departure for _ in range(2000)]
    by = displacements_from_poses(np.eye(4), departures, pivot=0.0) * DISPLAY_FACTORS
    assert by[:, moved].std(axis=0) == pytest.approx([0.3] * 3, rel=0.06)
    assert not np.delete(by, np.r_[moved], axis=1).any()
