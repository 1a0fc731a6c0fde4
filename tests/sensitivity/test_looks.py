"""Images taken anew: the acquisition's own when nothing is disturbed, and only then."""

from dataclasses import replace

import numpy as np
import pytest

from servoscope.acquisition import acquire
from servoscope.acquisition_config import AcquisitionConfig
from servoscope.errors import InvalidInputError
from servoscope.sensitivity import DISTURBANCES, take_images

CONFIG = AcquisitionConfig(n_images=6, image_size=64, seed=3, part="textured_plane")


def test_undisturbed_images_are_those_of_the_acquisition(tmp_path):
    data = acquire(tmp_path / "data", CONFIG, n_jobs=1)
    assert np.array_equal(take_images(CONFIG, [4, 1]), data.images[[4, 1]])


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_leaves_images_as_they_are_at_strength_0_alone(name):
    disturbance = DISTURBANCES[name]
    config = replace(CONFIG, image_size=128)
    clean = take_images(config, [2])
    assert np.array_equal(take_images(config, [2], disturbance, 0.0), clean)
    for strength in (min(disturbance.strengths), max(disturbance.strengths)):
        assert not np.array_equal(take_images(config, [2], disturbance, strength), clean)


def test_draws_differ_and_each_goes_one_way_at_every_strength():
    noise = DISTURBANCES["noise"]
    clean = take_images(CONFIG, [0]).astype(float)
    weak, strong, other = (
        take_images(CONFIG, [0], noise, strength, draw) - clean
        for strength, draw in ((5.0, 0), (10.0, 0), (5.0, 1))
    )
    assert np.corrcoef(weak.ravel(), strong.ravel())[0, 1] > 0.99
    assert abs(np.corrcoef(weak.ravel(), other.ravel())[0, 1]) < 0.1
    assert strong.std() == pytest.approx(10.0, rel=0.05)


def test_another_robot_or_image_is_refused():
    with pytest.raises(InvalidInputError, match="robot free only"):
        take_images(AcquisitionConfig(n_images=5, robot="arm"), [0])
    with pytest.raises(InvalidInputError, match="of the 6 images"):
        take_images(CONFIG, [6])
