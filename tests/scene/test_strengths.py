"""A strength is one and the same in images of every size, and wherever it is used."""

from dataclasses import replace

import numpy as np
import pytest

from servoscope.positioning.disturbances import Disturbances
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.sensor import Sensor
from servoscope.scene.strengths import amplified, as_widths, defocused, noisier
from servoscope.scene.textured_plane import TexturedPlane
from servoscope.scoreboard.conditions import CONDITIONS
from servoscope.sensitivity.disturbances import DISTURBANCES, Look

SIZES = (64, 128, 256, 512)


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


@pytest.mark.parametrize("size", SIZES[:3])
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
