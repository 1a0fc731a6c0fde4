import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError

SIDE = 160
INNER_RADIUS = 1 / 16


def blobs(turned=0.0, enlarged=1.0):
    """Three smooth blobs in a ring about the centre, turned from x towards y and enlarged."""
    y, x = np.indices((SIDE, SIDE)) - (SIDE - 1) / 2
    image = np.zeros((SIDE, SIDE))
    for angle, radius, width in [(0.3, 28, 4), (2.1, 40, 5), (4.0, 22, 3)]:
        u = enlarged * radius * np.cos(angle + turned)
        v = enlarged * radius * np.sin(angle + turned)
        image += np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * (enlarged * width) ** 2))
    return image[None]


def spectrum(image):
    """Complex ``M(m, k)`` by (m, k)."""
    features = sv.LogPolarFeatures(4, 3, INNER_RADIUS).set_output(transform="pandas")
    row = features.fit_transform(image).iloc[0]
    pairs = [tuple(map(int, name.split("_")[2:])) for name in row.index if name[2] == "s"]
    return {(m, k): row[f"l_c_{m}_{k}"] + 1j * row[f"l_s_{m}_{k}"] for m, k in pairs}


@pytest.mark.parametrize("angle", [0.2, -1.0, np.pi / 2])
def test_turning_the_picture_turns_the_phases(angle):
    before, after = spectrum(blobs()), spectrum(blobs(turned=angle))
    for (m, k), value in before.items():
        assert after[m, k] == pytest.approx(value * np.exp(-1j * m * angle), abs=1e-5), (m, k)


@pytest.mark.parametrize("factor", [0.8, 1.1, 1.3])
def test_enlarging_the_picture_turns_the_phases_and_scales_the_magnitudes(factor):
    before, after = spectrum(blobs()), spectrum(blobs(enlarged=factor))
    turn = -2 * np.pi * np.log(factor) / np.log(1 / INNER_RADIUS)
    for (m, k), value in before.items():
        expected = factor * value * np.exp(1j * k * turn)
        assert after[m, k] == pytest.approx(expected, abs=1e-5), (m, k)


def test_a_quarter_turn_of_any_pixels_is_exact():
    image = np.random.default_rng(0).uniform(0, 255, (1, 33, 33))
    before, after = spectrum(image), spectrum(np.rot90(image, axes=(1, 2)))
    for (m, k), value in before.items():  # rot90 turns from y towards x
        assert after[m, k] == pytest.approx(value * 1j**m, abs=1e-13), (m, k)


def test_features_are_of_the_ring_only():
    image = np.random.default_rng(0).uniform(1, 255, (1, 40, 60))
    y, x = np.indices((40, 60))
    radius = np.hypot(x - 29.5, y - 19.5)
    ring = (radius < 20) & (radius >= 5)
    features = sv.LogPolarFeatures(inner_radius=0.25).fit(image)
    inside = features.components_.reshape(-1, 40, 60)[:, ring]
    outside = features.components_.reshape(-1, 40, 60)[:, ~ring]
    assert (outside == 0).all()
    assert (inside != 0).any(axis=0).all()
    np.testing.assert_allclose(features.components_[0].sum(), np.sqrt(np.count_nonzero(ring)))


@pytest.mark.parametrize("share", [0, 1, -0.5, np.nan])
def test_inner_radius_that_is_no_share_is_refused(share, images):
    with pytest.raises(InvalidInputError, match="inner_radius must be between 0 and 1, got"):
        sv.LogPolarFeatures(inner_radius=share).fit(images)
