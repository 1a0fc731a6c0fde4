import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.selection.conditional_information import conditional_information
from servoscope.selection.mutual_information import information_of_codes


def cells(*codes):
    return np.unique(np.stack(codes), axis=1, return_counts=True)[1]


def entropy(*codes):
    p = cells(*codes) / len(codes[0])
    return -np.sum(p * np.log2(p))


@given(st.integers(1, 120), st.integers(2, 7), st.integers(1, 40), st.integers(0, 1000))
def test_information_is_that_of_the_entropies(n_samples, n_bins, n_conditions, seed):
    rng = np.random.default_rng(seed)
    features = rng.integers(0, n_bins, (3, n_samples)).astype(np.uint8)
    y = rng.integers(0, n_bins, n_samples).astype(np.uint8)
    z = rng.integers(0, n_conditions, n_samples)
    information, bias = conditional_information(features, y, z, n_bins)
    for i, f in enumerate(features):
        expected = entropy(f, z) + entropy(y, z) - entropy(f, y, z) - entropy(z)
        assert information[i] == pytest.approx(expected, abs=1e-12)
        excess = sum(map(len, (cells(f, y, z), cells(z))))
        excess -= sum(map(len, (cells(f, z), cells(y, z))))
        assert bias[i] == pytest.approx(excess / (2 * n_samples * np.log(2)), abs=1e-15)


def test_a_constant_condition_changes_nothing(rng):
    codes = rng.integers(0, 5, (4, 300)).astype(np.uint8)
    found, _ = conditional_information(codes[:3], codes[3], np.zeros(300, np.uint8), 5)
    np.testing.assert_allclose(found, information_of_codes(codes[:3], codes[3:], 5)[:, 0])


def test_what_is_known_adds_exactly_nothing(rng):
    codes = rng.integers(0, 5, (2, 300)).astype(np.uint8)
    constant = np.zeros((1, 300), np.uint8)
    assert conditional_information(np.vstack([codes, constant]), codes[1], codes[0], 5)[0][0] == 0
    assert conditional_information(constant, codes[1], codes[0], 5)[0].tolist() == [0]
    assert conditional_information(codes[:1], codes[1], codes[1], 5)[0].tolist() == [0]


def test_bias_is_that_of_unrelated_variables(rng):
    codes = rng.integers(0, 4, (200, 2000)).astype(np.uint8)
    y, z = rng.integers(0, 4, (2, 2000)).astype(np.uint8)
    information, bias = conditional_information(codes, y, z, 4)
    assert bias[0] == pytest.approx(3 * 3 * 4 / (4000 * np.log(2)))
    assert information.mean() == pytest.approx(bias.mean(), rel=0.05)
