import cv2
import numpy as np
import pytest
from scipy.signal.windows import hann

import servoscope as sv


def features_by_frequency(images, **options):
    """Magnitude and phasor of each frequency (u, v), of shape (n_images,) each."""
    fourier = sv.FourierFeatures(**options).set_output(transform="pandas")
    frame = fourier.fit_transform(images)
    frequencies = [name[4:] for name in frame.columns[::3]]
    return {
        tuple(map(int, f.split("_"))): (
            frame[f"f_a_{f}"].to_numpy(),
            (frame[f"f_c_{f}"] + 1j * frame[f"f_s_{f}"]).to_numpy(),
        )
        for f in frequencies
    }


@pytest.fixture(scope="module")
def random_images():
    return np.random.default_rng(0).uniform(0, 255, (3, 24, 30))


def test_magnitudes_and_phases_are_those_of_numpy(random_images):
    lengths = np.linalg.norm(random_images, axis=(1, 2))
    expected = np.fft.fft2(random_images, norm="ortho") / lengths[:, None, None]
    found = features_by_frequency(random_images, max_frequency=4, window="none")
    assert len(found) == 24
    for (u, v), (magnitude, phasor) in found.items():
        value = expected[:, v, u]
        np.testing.assert_allclose(magnitude, abs(value), atol=1e-14)
        np.testing.assert_allclose(phasor * np.hypot(abs(value), 0.1), value, atol=1e-14)


def test_window_is_that_of_hann(random_images):
    window = np.outer(*(hann(2 * n_pixels + 1)[1::2] for n_pixels in (24, 30)))
    means = np.average(random_images.reshape(3, -1), weights=window.ravel(), axis=1)
    spectra = np.fft.fft2(window * (random_images - means[:, None, None]))
    spectra /= np.linalg.norm(window) * np.linalg.norm(random_images, axis=(1, 2))[:, None, None]
    for (u, v), (magnitude, _) in features_by_frequency(random_images, window="hann").items():
        np.testing.assert_allclose(magnitude, abs(spectra[:, v, u]), atol=1e-14)


def test_shift_turns_phases_and_leaves_magnitudes(random_images):
    dx, dy = 7, -4
    shifted = np.roll(random_images, (dy, dx), axis=(1, 2))
    before = features_by_frequency(random_images, window="none")
    after = features_by_frequency(shifted, window="none")
    for (u, v), (magnitude, phasor) in before.items():
        turn = np.exp(-2j * np.pi * (u * dx / 30 + v * dy / 24))
        np.testing.assert_allclose(after[u, v][0], magnitude, atol=1e-14)
        np.testing.assert_allclose(after[u, v][1], phasor * turn, atol=1e-12)


def test_of_opposite_frequencies_one_stands_and_none_twice(random_images):
    found = set(features_by_frequency(random_images, max_frequency=3))
    disc = {(u, v) for u in range(-3, 4) for v in range(-3, 4) if 0 < u * u + v * v <= 9}
    opposite = {(-u, -v) for u, v in found}
    assert found | opposite == disc
    assert not found & opposite


def test_window_takes_the_cross_of_the_edges_away():
    slope = np.tile(np.linspace(0, 255, 64), (1, 64, 1))  # jumps from 255 to 0 at the edge
    without = features_by_frequency(slope, max_frequency=5, window="none")
    windowed = features_by_frequency(slope, max_frequency=5, window="hann")
    assert without[5, 0][0] > 0.05
    assert windowed[5, 0][0] < 0.1 * without[5, 0][0]


def test_window_alone_has_no_features(random_images):
    offset = random_images + 500.0
    assert all(
        magnitude < 1e-13
        for magnitude, _ in features_by_frequency(np.full((1, 20, 30), 9.0), window="hann").values()
    )
    lengths = np.linalg.norm(random_images, axis=(1, 2)), np.linalg.norm(offset, axis=(1, 2))
    before, after = (features_by_frequency(i, window="hann") for i in (random_images, offset))
    for frequency, (magnitude, _) in before.items():
        np.testing.assert_allclose(
            after[frequency][0] * lengths[1], magnitude * lengths[0], atol=1e-10
        )


@pytest.mark.parametrize("window", ["hann", "none"])
def test_nothing_jumps_while_a_picture_moves(window):
    pattern = cv2.GaussianBlur(np.random.default_rng(3).normal(size=(64, 200)), (0, 0), 5)
    pattern = 100 + 400 * pattern
    steps = np.arange(0, 120, 0.25)
    views = np.array(
        [cv2.warpAffine(pattern, np.float32([[1, 0, -s], [0, 1, 0]]), (64, 64)) for s in steps]
    )
    features = sv.FourierFeatures(window=window).fit_transform(views)
    at_once = abs(np.diff(features, axis=0)).max(axis=0)
    of_all = np.ptp(features, axis=0)
    assert (at_once < 0.25 * of_all).all()


def test_phase_of_a_faint_frequency_counts_for_little(random_images):
    faint = 1 + 1e-6 * random_images
    for _, phasor in features_by_frequency(faint).values():
        assert (abs(phasor) < 1e-2).all()
