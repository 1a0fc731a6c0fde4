from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.selection.sweep import ThresholdSubset, best_subset, threshold_subsets

relevances = st.lists(st.floats(0, 2), min_size=1, max_size=20)
thresholds = st.lists(st.floats(0, 1), max_size=20, unique=True)


@given(relevances, thresholds)
def test_each_threshold_is_found_once_with_just_the_features_above_it(relevance, thresholds):
    order = np.random.default_rng(0).permutation(len(relevance))
    subsets = threshold_subsets(order, relevance, thresholds)
    subset_at = {t: subset.features for subset in subsets for t in subset.thresholds}
    assert sum(len(subset.thresholds) for subset in subsets) == len(subset_at)
    for threshold in thresholds:
        above = [i for i, r in zip(order, relevance, strict=True) if r > threshold]
        assert list(subset_at.get(threshold, ())) == above


@given(relevances, thresholds)
def test_subsets_are_distinct_nested_and_not_empty(relevance, thresholds):
    subsets = threshold_subsets(range(len(relevance)), relevance, thresholds)
    assert all(subset.features for subset in subsets)
    for larger, smaller in pairwise(subsets):
        assert set(smaller.features) < set(larger.features)


def test_default_thresholds_go_from_0_to_1_bit():
    (subset,) = threshold_subsets([3, 1], [1.5, 1.2])
    assert subset.thresholds[0] == 0.0
    assert subset.thresholds[-1] == 1.0


def test_a_feature_exactly_at_the_threshold_is_left_out():
    assert threshold_subsets([0, 1], [0.5, 0.6], [0.5]) == [ThresholdSubset((1,), (0.5,))]


def test_the_subset_with_the_least_error_is_best():
    subsets = threshold_subsets([0, 1, 2], [0.9, 0.6, 0.3], [0.0, 0.5, 0.8])
    assert best_subset(subsets, [0.2, 0.1, 0.3]) == 1


def test_of_equal_errors_the_fewest_features_are_best():
    subsets = threshold_subsets([0, 1, 2], [0.9, 0.6, 0.3], [0.0, 0.5, 0.8])
    assert best_subset(subsets, [0.1, 0.1, 0.2]) == 1
    assert best_subset(subsets[::-1], [0.2, 0.1, 0.1]) == 1


def test_a_net_that_failed_is_never_best():
    subsets = threshold_subsets([0, 1], [0.9, 0.6], [0.0, 0.8])
    assert best_subset(subsets, [np.nan, 0.7]) == 1


@pytest.mark.parametrize(
    ("order", "relevance", "thresholds", "message"),
    [
        ([0, 1], [0.5], [0.0], "one entry for each ranked feature"),
        ([0], [np.nan], [0.0], "must be finite"),
        ([0], [0.5], [np.inf], "must be finite"),
    ],
)
def test_bad_input_is_refused(order, relevance, thresholds, message):
    with pytest.raises(InvalidInputError, match=message):
        threshold_subsets(order, relevance, thresholds)


@pytest.mark.parametrize(
    ("rms", "message"), [([0.1, 0.2], "must be 1 errors"), ([np.nan], "all of it is NaN")]
)
def test_errors_that_do_not_fit_the_subsets_are_refused(rms, message):
    with pytest.raises(InvalidInputError, match=message):
        best_subset(threshold_subsets([0], [0.5], [0.0]), rms)
