import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from servoscope.errors import InvalidInputError
from servoscope.selection.bootstrap import information_interval

RHO = 0.6


def pairs(rng, n_samples, n_pairs, memory=0.0):
    """Gaussian pairs of correlation RHO, each a sequence that remembers by `memory`."""
    drawn = rng.normal(size=(n_samples, 2, n_pairs))
    for t in range(1, n_samples):
        drawn[t] = memory * drawn[t - 1] + np.sqrt(1 - memory**2) * drawn[t]
    return drawn[:, 0], RHO * drawn[:, 0] + np.sqrt(1 - RHO**2) * drawn[:, 1]


def information_of_bins(n_bins):
    """Information of the bins of equal frequency of Gaussians, by their distribution function."""
    edges = np.concatenate([[-9], norm.ppf(np.arange(1, n_bins) / n_bins), [9]])
    corners = np.stack(np.meshgrid(edges, edges, indexing="ij"), axis=-1)
    below = multivariate_normal([0, 0], [[1, RHO], [RHO, 1]]).cdf(corners)
    p = np.diff(np.diff(below, axis=0), axis=1)
    return np.sum(p * np.log2(p * n_bins**2))


TRUTH = {
    "gaussian_copula": -0.5 * np.log2(1 - RHO**2),
    "equal_frequency": information_of_bins(6),
    "ksg": -0.5 * np.log2(1 - RHO**2),
}


def coverage(estimator, n_pairs, n_samples=400, memory=0.0, **options):
    """Share of the 90 % intervals that hold the truth."""
    X, Y = pairs(np.random.default_rng(12), n_samples, n_pairs, memory)
    held = 0
    for x, y in zip(X.T, Y.T, strict=True):
        interval = information_interval(x[:, None], y, estimator, confidence=0.9, **options)
        held += interval.low[0] <= TRUTH[estimator] <= interval.high[0]
    return held / n_pairs


@pytest.mark.slow
@pytest.mark.parametrize("resampling", ["bootstrap", "halves"])
@pytest.mark.parametrize(
    ("estimator", "options"), [("gaussian_copula", {}), ("equal_frequency", {"n_bins": 6})]
)
def test_intervals_hold_the_truth_as_often_as_they_say(estimator, options, resampling):
    found = coverage(estimator, 100, resampling=resampling, n_resamples=60, **options)
    assert found == pytest.approx(0.87, abs=0.09)


@pytest.mark.slow
def test_blocks_hold_the_truth_of_sequences_and_single_samples_do_not():
    options = {"n_samples": 500, "memory": 0.8, "n_resamples": 60}
    assert coverage("gaussian_copula", 50, **options) < 0.65
    assert coverage("gaussian_copula", 50, block_length=20, **options) > 0.75


@pytest.mark.slow
def test_halves_hold_the_truth_of_nearest_neighbours():
    found = coverage("ksg", 20, n_samples=150, resampling="halves", n_resamples=40)
    assert found > 0.6


def test_the_interval_of_a_histogram_lies_below_the_biased_estimate():
    rng = np.random.default_rng(13)
    interval = information_interval(rng.uniform(size=(300, 4)), rng.uniform(size=300))
    assert (interval.estimate > interval.high).all()
    assert (interval.low == 0).all()


def test_the_same_seed_gives_the_same_interval_and_targets_have_columns(rng):
    X, Y = rng.normal(size=(90, 3)), rng.normal(size=(90, 2))
    one, other = (information_interval(X, Y, n_resamples=9, random_state=1) for _ in range(2))
    np.testing.assert_array_equal(one.low, other.low)
    assert one.high.shape == (3, 2)
    assert information_interval(X, Y[:, 0], n_resamples=9).low.shape == (3,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"estimator": "ksg"}, "use resampling='halves'"),
        ({"resampling": "jackknife"}, "one of bootstrap, halves, got 'jackknife'"),
        ({"confidence": 1.0}, "confidence must be between 0 and 1"),
        ({"n_resamples": 0}, "n_resamples at least 1"),
        ({"block_length": 0}, "block_length must be an integer from 1 to half"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        information_interval(np.zeros((9, 1)), np.zeros(9), **arguments)
