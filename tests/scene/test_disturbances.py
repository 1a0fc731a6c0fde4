"""Disturbances: each does what its name says, by the same strength in images and in the cell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLAY_FACTORS, DOFS, displacements_from_poses
from servoscope.scene.camera import Sensor
from servoscope.scene.disturbances import (
    DISTURBANCES,
    SINGLE_DISTURBANCES,
    Disturbances,
    Look,
    amplified,
    as_widths,
    defocused,
    noisier,
)
from servoscope.scene.render import render, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane
from servoscope.scoreboard.cell import CONDITIONS


def disturbed(image: np.ndarray, seed: int = 0, **strengths: float) -> np.ndarray:
    return Disturbances.only(**strengths).disturb(image, np.random.default_rng(seed))


@settings(max_examples=20)
@given(gain=st.floats(0, 3), offset=st.floats(-100, 100))
def test_gain_and_offset_follow_their_formula(gain: float, offset: float) -> None:
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    expected = np.clip(gain * image.astype(float) + offset, 0, 255)
    got = disturbed(image, gain=gain, offset=offset)
    assert np.abs(got - expected).max() <= 0.5 + 1e-3


@settings(max_examples=30)
@given(share=st.floats(0, 1), seed=st.integers(0, 1000))
def test_a_covering_hides_its_share_to_half_a_row(share: float, seed: int) -> None:
    image = np.random.default_rng(0).choice([0, 255], (60, 80)).astype(np.uint8)
    changed = disturbed(image, seed, covering=share)
    hidden = ~np.isin(changed, [0, 255])
    rows, columns = hidden.any(axis=1).sum(), hidden.any(axis=0).sum()
    if len(np.unique(changed[hidden])):
        assert hidden.sum() == rows * columns
        assert abs(hidden.mean() - share) <= 0.5 / 60 + 0.5 / 80
        assert len(np.unique(changed[hidden])) == 1


def test_noise_has_its_deviation_and_no_mean() -> None:
    noise = disturbed(np.full((200, 200), 128, np.uint8), noise=10.0) - 128.0
    assert noise.std() == pytest.approx(10, rel=0.02)
    assert abs(noise.mean()) < 0.2


def test_a_light_is_smooth_and_of_its_strength() -> None:
    image = np.full((96, 96), 100, np.uint8)
    fields = [np.log(disturbed(image, seed, light=0.2) / 100.0) for seed in range(60)]
    knots = np.array([field[16::32, 16::32] for field in fields])
    assert knots.std() == pytest.approx(0.2, rel=0.15)
    assert max(np.abs(np.diff(field, axis=0)).max() for field in fields) < 0.05


def test_nothing_is_done_where_nothing_is_asked_for(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (20, 30), dtype=np.uint8)
    np.testing.assert_array_equal(disturbed(image), image)
    np.testing.assert_array_equal(disturbed(image, covering=0.0, noise=0.0, light=0.0), image)


def test_the_same_generator_gives_the_same_image_and_leaves_the_first_alone() -> None:
    image = np.random.default_rng(1).integers(0, 256, (64, 64), dtype=np.uint8)
    before = image.copy()
    first, again, other = (
        Disturbances().disturb(image, np.random.default_rng(seed)) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    np.testing.assert_array_equal(image, before)


def test_probabilities_are_kept() -> None:
    image = np.full((8, 8), 100, np.uint8)
    often = Disturbances(**dict.fromkeys(SINGLE_DISTURBANCES) | {"gain": (0.5, 0.5, 0.3)})
    rng = np.random.default_rng(0)
    share = np.mean([often.disturb(image, rng)[0, 0] == 50 for _ in range(2000)])
    assert share == pytest.approx(0.3, abs=0.04)


@pytest.mark.parametrize(
    ("strengths", "message"),
    [
        ({"gain": (1.2, 0.8, 1.0)}, "strength of gain must be from 0 to 100, the lower bound"),
        ({"covering": (0.0, 1.5, 1.0)}, "covering must be from 0 to 1"),
        ({"noise": (0.0, 1.0, 2.0)}, "its probability from 0 to 1"),
        ({"defocus": (np.nan, 1.0, 1.0)}, "defocus must be"),
    ],
)
def test_strengths_out_of_range_are_refused(strengths: dict, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        Disturbances(**strengths)


def test_an_unknown_disturbance_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"Disturbances are defocus, .* got fog"):
        Disturbances.only(fog=1.0)


SIZES = (64, 128, 256)


def edge(size, sensor):
    """Width of an edge that a sensor sees: the deviation of its derivative, [image widths]."""
    radiance = np.zeros((size, size), np.float32)
    radiance[:, size // 2 :] = 0.8
    slope = np.diff(replace(sensor, vignetting=0.0).read_out(radiance)[size // 2].astype(float))
    return deviation_of(slope, size)


def deviation_of(slope, size):
    x = np.arange(len(slope)) / size
    mean = slope @ x / slope.sum()
    return np.sqrt(slope @ (x - mean) ** 2 / slope.sum())


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("px", [2.0, 4.0])
def test_a_blur_spreads_an_edge_by_the_same_share_of_the_view(size, px):
    sensor = Sensor(blur=0.0)
    seen = edge(size, defocused(sensor, px))
    assert seen == pytest.approx(px / 256, rel=0.1)
    image = np.zeros((32, size), np.uint8)
    image[:, size // 2 :] = 200
    copy = Disturbances.only(defocus=px).disturb(image, np.random.default_rng(0))
    assert deviation_of(np.diff(copy[16].astype(float)), size) == pytest.approx(seen, rel=0.05)


@pytest.mark.parametrize("size", SIZES)
def test_every_list_of_disturbances_means_the_same(size):
    scene = Scene(TexturedPlane(), image_size=size)
    look = Look(scene)
    blurred = DISTURBANCES["defocus"].change(look, 2.0, np.random.default_rng(0)).scene
    assert blurred == CONDITIONS["defocus"].change(scene, 0)
    darker = DISTURBANCES["gain"].change(look, -20.0, np.random.default_rng(0)).scene
    assert darker == CONDITIONS["gain_0.8"].change(scene, 0)
    moved = DISTURBANCES["principal_point_x"].change(look, 4.0, np.random.default_rng(0)).scene
    assert np.subtract(moved.lens.principal_point, scene.lens.principal_point) == pytest.approx(
        [as_widths(4.0), 0.0]
    )


@pytest.mark.parametrize("size", SIZES[:2])
def test_noise_is_of_as_many_grey_levels_in_every_pixel(size):
    scene = Scene(TexturedPlane(), image_size=size)
    clean = render(scene, T_WORLD_REF).astype(float)
    inner = (clean > 60) & (clean < 195)
    own = (render(scene, T_WORLD_REF, np.random.default_rng(0)) - clean)[inner].std()
    noisy = CONDITIONS["noise_10"].change(scene, 0)
    seen = (render(noisy, T_WORLD_REF, np.random.default_rng(0)) - clean)[inner].std()
    assert seen == pytest.approx(np.hypot(own, 10), rel=0.05)
    look = DISTURBANCES["noise"].change(Look(scene), 10.0, np.random.default_rng(0))
    assert look.added_noise.std() == pytest.approx(10, rel=0.05)
    copy = Disturbances.only(noise=10.0).disturb(
        np.full((size, size), 128, np.uint8), np.random.default_rng(0)
    )
    assert copy.std() == pytest.approx(10, rel=0.05)


def test_noise_is_in_the_grey_levels_that_come_out_whatever_the_gain():
    for gain in (0.5, 1.0, 1.7):
        sensor = amplified(Sensor(read_noise=0.0, full_well=1e9, exposure=0.4), gain)
        flat = np.ones((200, 200), np.float32)
        clean = sensor.read_out(flat).astype(float)
        noise = noisier(sensor, 10.0).read_out(flat, np.random.default_rng(0)) - clean
        assert noise.std() == pytest.approx(10.0, rel=0.03)


SCENE = Scene(part=TexturedPlane(), image_size=64)


def changed(name, strength, rng=None):
    return DISTURBANCES[name].change(Look(SCENE), strength, rng)


@pytest.mark.parametrize(("name", "axis"), [("principal_point_x", 1), ("principal_point_y", 0)])
def test_a_principal_point_farther_moves_what_is_seen_by_as_much(name, axis):
    clean = render_radiance(SCENE, T_WORLD_REF)
    moved = render_radiance(changed(name, 4.0).scene, T_WORLD_REF)  # 4 px of 256 are 1 of 64
    shifted = np.delete(moved, 0, axis) - np.delete(clean, -1, axis)
    assert np.abs(shifted).max() < 1e-4
    assert np.abs(moved - clean).max() > 0.1


def test_a_focal_length_of_5_percent_more_moves_points_5_percent_outwards():
    point = [0.05, -0.03, 0.5]
    middle = SCENE.lens.camera_matrix(64)[:2, 2]
    seen, longer = (
        scene.lens.project(point, 64) - middle
        for scene in (SCENE, changed("focal_length", 5.0).scene)
    )
    assert longer == pytest.approx(1.05 * seen)


def test_k1_moves_points_outwards_by_the_cube_of_their_distance():
    point = np.array([0.05, 0.0, 0.5])
    by = changed("distortion_k1", 0.02).scene.lens.project(point, 64) - SCENE.lens.project(
        point, 64
    )
    assert by == pytest.approx([SCENE.lens.focal_length * 64 * 0.02 * 0.1**3, 0.0])


def test_blurs_add_up_as_variances():
    blur = changed("defocus", 2.0).scene.sensor.blur
    assert (256 * blur) ** 2 == pytest.approx((256 * SCENE.sensor.blur) ** 2 + 4.0)


def test_gain_is_in_percent_and_light_in_millimetres():
    assert changed("gain", -20.0).scene.sensor.gain == pytest.approx(0.8)
    before, after = (scene.lighting.lamps for scene in (SCENE, changed("light_z", 300.0).scene))
    assert np.subtract(after[0].position, before[0].position) == pytest.approx([0, 0, 0.3])
    assert after[1] == before[1]


@pytest.mark.parametrize("axis", range(6))
def test_a_remounted_camera_is_displaced_in_one_dof_alone(axis):
    departure = changed(f"hand_eye_{DOFS[axis]}", 0.5).departure
    by = displacements_from_poses(np.eye(4), departure, pivot=0.0) * DISPLAY_FACTORS
    assert by == pytest.approx(0.5 * np.eye(6)[axis])


@pytest.mark.parametrize(("name", "moved"), [("mm", slice(0, 3)), ("deg", slice(3, 6))])
def test_a_robot_rests_with_the_deviation_that_is_asked_for(name, moved):
    rng = np.random.default_rng(0)
    departures = [changed(f"repeatability_{name}", 0.3, rng).departure for _ in range(2000)]
    by = displacements_from_poses(np.eye(4), departures, pivot=0.0) * DISPLAY_FACTORS
    assert by[:, moved].std(axis=0) == pytest.approx([0.3] * 3, rel=0.06)
    assert not np.delete(by, np.r_[moved], axis=1).any()


@pytest.mark.parametrize("size", SIZES)
def test_two_pixels_of_defocus_blur_an_image_as_they_blur_the_scene_it_is_of(size):
    scene = Scene(TexturedPlane(), image_size=size)
    clean, seen = (
        render(one, T_WORLD_REF).astype(float)[8:-8, 8:-8]
        for one in (scene, DISTURBANCES["defocus"].change(Look(scene), 2.0, None).scene)
    )
    images = {
        px: Disturbances.only(defocus=px).disturb(
            render(scene, T_WORLD_REF), np.random.default_rng(0)
        )
        for px in (1.0, 2.0, 4.0)
    }
    off = {px: np.abs(image[8:-8, 8:-8] - seen).mean() for px, image in images.items()}
    assert min(off, key=off.get) == 2.0
    assert off[2.0] < 0.2 * np.abs(clean - seen).mean()
