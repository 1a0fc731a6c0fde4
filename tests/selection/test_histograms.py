import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from servoscope.errors import InvalidInputError
from servoscope.selection.estimators import information_of_codes, mutual_information
from servoscope.selection.histograms import JointCounts, bin_codes, conditional_information

finite = st.floats(-1e9, 1e9, allow_subnormal=True)


def codes_by_edges(x, n_bins):
    edges = np.linspace(x.min(), x.max(), n_bins + 1)
    return np.digitize(x, edges[1:-1]) if x.min() < x.max() else np.zeros(len(x), int)


@given(hnp.arrays(float, st.integers(1, 60), elements=finite), st.integers(2, 256))
def test_bins_are_those_between_linspace_edges(x, n_bins):
    np.testing.assert_array_equal(bin_codes(x[:, None], n_bins)[0], codes_by_edges(x, n_bins))


@given(finite, st.floats(1e-3, 1e6), st.integers(2, 40))
def test_values_on_edges_are_counted_as_numpy_histogram_does(low, width, n_bins):
    edges = np.linspace(low, low + width, n_bins + 1)
    x = np.concatenate(
        [edges, np.nextafter(edges[1:-1], -np.inf), np.nextafter(edges[1:-1], np.inf)]
    )
    counts = np.bincount(bin_codes(x[:, None], n_bins)[0], minlength=n_bins)
    np.testing.assert_array_equal(counts, np.histogram(x, n_bins)[0])


def test_every_column_has_its_own_range_and_a_constant_one_falls_in_bin_zero(rng):
    X = np.column_stack([rng.normal(size=500), 1e6 * rng.uniform(size=500), np.full(500, 7.0)])
    codes = bin_codes(X, 10)
    assert codes.dtype == np.uint8
    assert codes.flags.c_contiguous
    for column, row in zip(X.T, codes, strict=True):
        np.testing.assert_array_equal(row, codes_by_edges(column, 10))


def test_layout_and_number_type_of_the_input_do_not_matter(rng):
    X = rng.integers(0, 50, size=(200, 4))
    expected = bin_codes(X.astype(float))
    np.testing.assert_array_equal(bin_codes(X), expected)
    np.testing.assert_array_equal(bin_codes(np.asfortranarray(X)), expected)
    np.testing.assert_array_equal(bin_codes(X.astype(np.float32)), expected)
    np.testing.assert_array_equal(bin_codes(X.tolist()), expected)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused_with_its_column(bad):
    X = np.zeros((5, 3))
    X[2, 1] = bad
    with pytest.raises(InvalidInputError, match=r"X must be finite .* column 1 .* \(1 such"):
        bin_codes(X)


def test_a_span_beyond_floating_point_is_refused():
    with pytest.raises(InvalidInputError, match="span less than"):
        bin_codes([[-1.7e308], [1.7e308]])


@pytest.mark.parametrize("n_bins", [1, 0, -3, 257, 2.5, "10"])
def test_a_number_of_bins_out_of_range_is_refused(n_bins):
    with pytest.raises(InvalidInputError, match="n_bins must be an integer from 2 to 256"):
        bin_codes([[0.0], [1.0]], n_bins)


@pytest.mark.parametrize("shape", [(5,), (0, 3), (5, 0), (2, 2, 2)])
def test_what_is_no_table_is_refused(shape):
    with pytest.raises(InvalidInputError, match="X must be a table of shape"):
        bin_codes(np.zeros(shape))


def test_text_is_refused():
    with pytest.raises(InvalidInputError, match="targets must be an array of numbers"):
        bin_codes([["a"], ["b"]], name="targets")


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
    np.testing.assert_allclose(found, information_of_codes(codes[:3], codes[3:], 5)[0][:, 0])


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


@given(seed=st.integers(0, 99), n_bins=st.integers(2, 20), cuts=st.lists(st.integers(0, 200)))
@settings(max_examples=30, deadline=None)
def test_counts_of_blocks_give_the_information_of_all_samples(seed, n_bins, cuts) -> None:
    rng = np.random.default_rng(seed)
    X, y = rng.normal(size=(200, 3)), rng.integers(0, 4, (200, 2)).astype(float)
    y[:, 1] = 7.0
    ranges = [(table.min(axis=0), table.max(axis=0)) for table in (X, y)]
    counts = JointCounts(*ranges, n_bins)
    for part in rng.permutation(len(cuts) + 1):
        rows = np.split(np.arange(200), sorted(cuts))[part]
        own = JointCounts(*ranges, n_bins)
        counts.merge(own.update(X[rows], y[rows]))
    np.testing.assert_array_equal(counts.finalize(), mutual_information(X, y, n_bins))


ONE = ([0.0], [1.0])


@pytest.mark.parametrize(
    "other",
    [
        JointCounts(([0.0], [2.0]), ONE),
        JointCounts(ONE, ([-1.0], [1.0])),
        JointCounts(ONE, ONE, n_bins=5),
        JointCounts(([0.0, 0.0], [1.0, 1.0]), ONE),
    ],
)
def test_counts_of_other_bins_are_not_merged(other):
    with pytest.raises(InvalidInputError, match="ranges and bins are the same"):
        JointCounts(ONE, ONE).merge(other)


def test_an_empty_block_counts_nothing_and_one_target_may_be_a_row():
    x = np.random.default_rng(0).uniform(size=(50, 1))
    counts = JointCounts(ONE, ONE).update(x, x[:, 0] ** 2).update(x[:0], x[:0])
    once = JointCounts(ONE, ONE).update(x, x**2)
    np.testing.assert_array_equal(counts.finalize(), once.finalize())


@pytest.mark.parametrize("X_range", [(0.0, 1.0), ([1.0], [0.0]), ([], []), ([0.0], [1.0, 2.0])])
def test_ranges_that_are_none_are_refused(X_range):
    with pytest.raises(InvalidInputError, match="range of X must be its least and greatest"):
        JointCounts(X_range, ONE)


def test_counts_of_values_beyond_the_ranges_are_refused() -> None:
    counts = JointCounts(([0.0], [1.0]), ([0.0], [1.0]))
    with pytest.raises(InvalidInputError, match="none was counted"):
        counts.finalize()
    for X, y, what in (
        ([[2.0]], [[0.0]], "X must be within the ranges"),
        ([[0.0]], [[np.nan]], "y"),
    ):
        with pytest.raises(InvalidInputError, match=what):
            counts.update(X, y)
    with pytest.raises(InvalidInputError, match="as many rows"):
        counts.update([[0.0], [1.0]], [[0.0]])
