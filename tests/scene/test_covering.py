"""A covering hides what it says, in the same place of every image."""

from dataclasses import replace

import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.poses import rigid_transform
from servoscope.scene.covering import Covering
from servoscope.scene.render import render, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.sensor import Sensor
from servoscope.scene.textured_plane import TexturedPlane

SHIFTED = T_WORLD_REF @ rigid_transform(np.eye(3), [0.02, 0.01, 0.0])


def _hidden(scene: Scene, T_world_cam: np.ndarray = T_WORLD_REF) -> np.ndarray:
    bare = render_radiance(replace(scene, covering=None), T_world_cam)
    return render_radiance(scene, T_world_cam) != bare


@pytest.mark.parametrize("share", [0.1, 0.2, 0.5, 0.93])
@pytest.mark.parametrize("seed", range(4))
def test_a_rectangle_of_the_share_is_hidden_to_half_a_row(share: float, seed: int) -> None:
    scene = Scene(TexturedPlane(), image_size=100, covering=Covering(share, seed))
    hidden = _hidden(scene)
    rows, columns = np.flatnonzero(hidden.any(axis=1)), np.flatnonzero(hidden.any(axis=0))
    assert hidden[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].all()
    assert abs(hidden.sum() - share * 100**2) <= len(columns) / 2
    assert len(np.unique(render_radiance(scene, T_WORLD_REF)[hidden])) == 1


def test_nothing_and_everything_can_be_hidden() -> None:
    for share in (0.0, 1.0):
        scene = Scene(TexturedPlane(), image_size=32, covering=Covering(share))
        assert _hidden(scene).mean() == share


def test_it_stays_in_the_image_when_the_camera_moves() -> None:
    scene = Scene(image_size=64, covering=Covering(0.2, seed=3))
    np.testing.assert_array_equal(
        render_radiance(scene, T_WORLD_REF)[_hidden(scene)],
        render_radiance(scene, SHIFTED)[_hidden(scene, SHIFTED)],
    )


def test_another_seed_hangs_it_elsewhere_in_another_grey() -> None:
    images = [
        render_radiance(
            Scene(TexturedPlane(), image_size=64, covering=Covering(0.2, seed)), T_WORLD_REF
        )
        for seed in (0, 0, 1)
    ]
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[0] != images[2]).mean() > 0.2


def test_the_sensor_adds_its_noise_over_it() -> None:
    scene = Scene(TexturedPlane(), sensor=Sensor(blur=0.0), image_size=64, covering=Covering(0.3))
    image = render(scene, T_WORLD_REF, np.random.default_rng(0))
    assert image[_hidden(scene)].std() > 0.5


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_shares_out_of_range_are_refused(share: float) -> None:
    with pytest.raises(InvalidInputError, match="share must be from 0 to 1, got"):
        Covering(share)


@pytest.mark.parametrize("seed", [-1, 0.5])
def test_seeds_that_are_no_count_are_refused(seed: float) -> None:
    with pytest.raises(InvalidInputError, match="seed must be a whole number from 0"):
        Covering(0.1, seed)
