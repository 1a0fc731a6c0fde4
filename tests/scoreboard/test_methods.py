"""Photometric servoing as the scoreboard has it, and the settings of every method."""

from pathlib import Path

import numpy as np
import pytest

from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.positioning.photometric import PhotometricServoing
from servoscope.robots.arm import MOUNT
from servoscope.robots.free_camera import Repeatability
from servoscope.scoreboard.methods import Mounted, loop_settings, make_photometric
from servoscope.scoreboard.trial import run_start

PLANE = "textured_plane"
CONDITION = {"free": "range_1.0", "arm": "arm"}


def acquisition(robot: str, size: int = 256) -> AcquisitionConfig:
    return AcquisitionConfig(schedule=((1, 1.6),), part=PLANE, robot=robot, image_size=size)


def images(path: Path, config: AcquisitionConfig) -> PoseImageSet:
    return acquire(path / config.robot, config, n_jobs=1)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["free", "arm"])
def test_the_baseline_arrives_on_the_plane_whatever_carries_the_camera(
    robot: str, tmp_path: Path
) -> None:
    config = acquisition(robot)
    servoing = make_photometric(PLANE, images(tmp_path, config), config, 1.0)
    settings = loop_settings("photometric", Repeatability())
    trial = run_start(PLANE, CONDITION[robot], 256, 0, 0, servoing, settings)
    assert trial.succeeded, trial.message
    assert 50 < trial.moves <= 200
    assert trial.end_mm < 0.2


def test_on_an_arm_its_estimates_are_those_of_the_flange(tmp_path: Path) -> None:
    config = acquisition("arm", size=64)
    data = images(tmp_path, config)
    mounted = make_photometric(PLANE, data, config, 1.0)
    assert isinstance(mounted, Mounted)
    np.testing.assert_allclose(mounted.T_flange_cam, MOUNT, atol=1e-9)
    assert mounted.pivot == data.pivot != 0.55
    inner = mounted.servoing.estimate(data.images[0], None)
    outer = mounted.estimate(data.images[0], None)
    for told, seen in ((outer.displacement, inner.displacement), (outer.step, inner.step)):
        np.testing.assert_allclose(told @ MOUNT, MOUNT @ seen, atol=1e-9)
    assert mounted.estimate(data.images[0], outer).moves == 1


def test_the_depth_that_is_told_scales_what_is_believed_of_translations(tmp_path: Path) -> None:
    config = acquisition("free", size=64)
    data = images(tmp_path, config)
    exact, far = (make_photometric(PLANE, data, config, factor) for factor in (1.0, 1.5))
    assert isinstance(exact, PhotometricServoing)
    np.testing.assert_allclose(far.interaction_[:3], exact.interaction_[:3] / 1.5, rtol=1e-5)
    np.testing.assert_array_equal(far.interaction_[3:], exact.interaction_[3:])
    np.testing.assert_array_equal(exact.reference_image, data.reference_image)


def test_who_learns_has_few_moves_and_the_guard_and_knows_its_robot() -> None:
    repeatability = Repeatability(5e-5, float(np.radians(0.01)))
    ours, baseline = (loop_settings(method, repeatability) for method in ("ours", "photometric"))
    assert (ours.max_moves, baseline.max_moves) == (12, 200)
    assert ours.growth < 0.1 < baseline.growth
    assert ours.repeatability_mm == pytest.approx(0.05)
    assert ours.repeatability_deg == pytest.approx(0.01)
