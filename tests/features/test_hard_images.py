"""Every family of features on images and poses that are constant, masked or huge."""

import numpy as np
import pytest

import servoscope.features as features
from servoscope.errors import InvalidInputError

FAMILIES = [
    getattr(features, name)
    for name in features.__all__
    if isinstance(getattr(features, name), type) and hasattr(getattr(features, name), "transform")
]
IMAGES = np.random.default_rng(0).integers(0, 255, (40, 32, 32)).astype(np.uint8)
POSES = np.random.default_rng(1).normal(size=(40, 6))


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize(
    ("images", "poses"),
    [
        (np.full_like(IMAGES, 7), POSES),
        (np.zeros_like(IMAGES), POSES),
        (np.repeat(IMAGES[:1], 40, axis=0), POSES),
        (IMAGES, np.zeros_like(POSES)),
        (IMAGES, 1e200 * POSES),
        (IMAGES, 1e-200 * POSES),
    ],
)
def test_features_are_finite_or_refused(family, images, poses):
    try:
        found = family().fit(images, poses).transform(images)
    except InvalidInputError:
        return
    assert np.isfinite(found).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_masked_images_are_refused(family):
    hidden = np.ma.masked_greater(IMAGES, 200)
    with pytest.raises(InvalidInputError, match=r"X hides .* values behind a mask"):
        family().fit(hidden, POSES)


@pytest.mark.parametrize("family", [features.PoseImageCovariance, features.WhitenedPoseCovariance])
def test_masked_poses_are_refused(family):
    with pytest.raises(InvalidInputError, match=r"y hides .* values behind a mask"):
        family().fit(IMAGES, np.ma.masked_greater(POSES, 0.5))
