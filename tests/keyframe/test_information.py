"""What an image would say of a keyframe, against what the fit of such images comes to."""

import numpy as np
import pytest

from servoscope import CameraModel, Keyframe
from servoscope.keyframe import next_displacements
from servoscope.keyframe.next_images import KeyframeInformation
from servoscope.poses import poses_from_displacements

PIVOT = 0.5
NOISE = (1e-4, 1e-4)


def plate(depth=2.0, f=1.5, mount=None):
    """A keyframe of a textured plate across the view."""
    rng = np.random.default_rng(0)
    grey = rng.integers(20, 235, (48, 64), dtype=np.uint8)
    flat = np.full((24, 32), depth, np.float32)
    return Keyframe(
        grey, CameraModel(f), np.eye(4) if mount is None else mount, flat, np.ones_like(flat),
        poses_from_displacements(np.eye(4), 0.02 * np.eye(6), PIVOT), np.zeros((20, 20)),
        np.zeros(6), pivot=PIVOT, residual=2.0, noise=1.5,
    )  # fmt: skip


@pytest.fixture(scope="module")
def says():
    return KeyframeInformation(plate(), NOISE)


def displaced(*delta_p):
    return poses_from_displacements(np.eye(4), np.array(delta_p), PIVOT)


def test_information_is_symmetric_and_nowhere_negative(says):
    information = says.of(displaced(0.02, 0, 0.01, 0.1, 0, 0.1)).information
    np.testing.assert_allclose(information, information.T, atol=1e-6 * np.abs(information).max())
    assert np.linalg.eigvalsh(information).min() > -1e-6 * np.linalg.eigvalsh(information).max()


def test_an_image_at_the_reference_says_nothing_of_the_mount(says):
    at, aside = says.of(np.eye(4)), says.of(displaced(0.02, 0.01, 0, 0.1, 0.1, 0.1))
    assert np.abs(at.information[:6, :6]).max() < 1e-6 * np.abs(aside.information[:6, :6]).max()
    assert np.abs(at.sensitivity[:, :6]).max() < 1e-6


def test_a_translation_is_read_wrongly_in_proportion_to_the_depth(says):
    """A plate that is farther by a share is read to have moved farther by that share."""
    image = says.of(displaced(0.03, 0, 0, 0, 0, 0))
    patches = image.sensitivity[0, 17:]
    assert patches.sum() == pytest.approx(-0.03, rel=0.05)
    assert np.abs(image.sensitivity[3:, 17:].sum(axis=1)).max() < 0.01


def test_surer_poses_and_more_images_say_more(says):
    D = displaced(0.02, 0.01, 0.01, 0.1, 0.05, 0.1)
    sure = KeyframeInformation(plate(), (1e-5, 1e-5)).of(D).information
    assert np.trace(sure[:6, :6]) > 2 * np.trace(says.of(D).information[:6, :6])
    known = says.fitted()
    before, after = (
        np.sqrt(np.diag(np.linalg.inv(x))) for x in (known, known + says.of(D).information)
    )
    assert (after <= before * (1 + 1e-9)).all()
    assert (after[:6] < before[:6]).any()


@pytest.mark.parametrize(
    "aside", [(0.6, 0, 0, 0, 0, 0), (0, -0.6, 0, 0, 0, 1.0), (3.0, 2, 1, 1, 1, 1)]
)
def test_an_image_that_sees_nothing_of_the_view_says_nothing(says, aside):
    image = says.of(displaced(*aside))
    assert not image.information.any()
    assert not image.sensitivity.any()


def test_next_images_are_found_in_a_range_beyond_the_view():
    reach = np.array([0.5] * 3 + [np.radians(60)] * 3)
    chosen = next_displacements(plate(), 3, reach)
    assert (np.abs(chosen) <= reach).all()
    information = KeyframeInformation(plate(), NOISE).of(displaced(*chosen[0])).information
    assert np.isfinite(information).all()


def test_no_image_is_to_be_taken_twice():
    chosen = next_displacements(plate(), 200, [0.02] * 3 + [0.1] * 3)
    assert len(np.unique(chosen, axis=0)) == 200
