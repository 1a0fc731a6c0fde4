import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.regression import LMRegressor, NetworkJob, train_networks

QUICK = LMRegressor(hidden=30, restarts=2, max_iter=6)
TRAIN, VALIDATION = np.arange(150), np.arange(150, 200)


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(0)
    Y = rng.uniform(-1, 1, (200, 2))
    return np.tanh(Y @ rng.normal(size=(2, 12))) + 0.05 * rng.normal(size=(200, 12)), Y


def _jobs():
    return [
        NetworkJob(np.arange(k), target, seed=10 * k + target)
        for k in (1, 2, 12)
        for target in (0, 1)
    ]


def _train(samples, jobs, **options):
    return list(train_networks(*samples, jobs, TRAIN, VALIDATION, regressor=QUICK, **options))


def test_weights_are_the_same_for_any_number_of_processes(samples):
    one, two = (_train(samples, _jobs(), n_jobs=n) for n in (1, 2))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.network_.weights, b.network_.weights)
        np.testing.assert_array_equal(a.result_.validation_rms, b.result_.validation_rms)


def test_a_network_is_that_of_the_regressor_alone(samples):
    X, Y = samples
    job = NetworkJob(np.array([3, 5, 1]), 1, seed=4)
    net = _train(samples, [job])[0]
    alone = LMRegressor(hidden=30, restarts=2, max_iter=6, random_state=4).fit(
        X[:150, [3, 5, 1]], Y[:150, 1], X[150:, [3, 5, 1]], Y[150:, 1]
    )
    np.testing.assert_array_equal(net.network_.weights, alone.network_.weights)
    np.testing.assert_array_equal(net.predict(X[:, [3, 5, 1]]), alone.predict(X[:, [3, 5, 1]]))


def test_networks_come_in_the_order_of_the_jobs_and_progress_counts_them(samples):
    counts = []
    nets = _train(samples, _jobs(), on_progress=counts.append)
    assert [net.n_features_in_ for net in nets] == [1, 1, 2, 2, 12, 12]
    assert counts == [1, 2, 3, 4, 5, 6]
    assert [net.random_state for net in nets] == [job.seed for job in _jobs()]


def test_networks_are_handed_over_as_they_are_ready(samples):
    counts = []
    nets = train_networks(
        *samples, _jobs(), TRAIN, VALIDATION, regressor=QUICK, on_progress=counts.append
    )
    next(nets)
    assert counts == [1]
    nets.close()


def test_without_validation_the_training_error_decides(samples):
    net = next(train_networks(*samples, _jobs(), TRAIN, regressor=QUICK))
    assert net.result_.best_rms == net.result_.training_rms[-1]


def test_jobs_that_name_no_column_are_refused(samples):
    for job, message in [
        (NetworkJob(np.array([12]), 0), r"columns from 0 to 11, got \[12\]"),
        (NetworkJob(np.array([], dtype=int), 0), r"columns from 0 to 11, got \[\]"),
        (NetworkJob(np.array([-1]), 0), r"columns from 0 to 11, got \[-1\]"),
        (NetworkJob(np.array([0.5]), 0), r"columns from 0 to 11, got \[0.5\]"),
        (NetworkJob(np.array([0]), 2), "target must be from 0 to 1, got 2"),
    ]:
        with pytest.raises(InvalidInputError, match=message):
            train_networks(*samples, [job], TRAIN, VALIDATION)


def test_bad_samples_are_refused(samples):
    X, Y = samples
    with pytest.raises(InvalidInputError, match="must be finite"):
        train_networks(X, np.full_like(Y, np.nan), _jobs(), TRAIN, VALIDATION)
    with pytest.raises(InvalidInputError, match=r"got \(200, 12\) and \(200,\)"):
        train_networks(X, Y[:, 0], _jobs(), TRAIN, VALIDATION)
    with pytest.raises(InvalidInputError, match="The rows that train"):
        train_networks(X, Y, _jobs(), np.arange(0), VALIDATION)
    with pytest.raises(InvalidInputError, match="The rows that train"):
        train_networks(X, Y, _jobs(), np.array([200]), VALIDATION)
    with pytest.raises(InvalidInputError, match="The rows that train"):
        train_networks(X, Y, _jobs(), TRAIN < 5, VALIDATION)


@pytest.mark.parametrize("validation", [VALIDATION, None])
def test_at_least_two_rows_train(samples, validation):
    with pytest.raises(InvalidInputError, match="At least two rows must train, got 1"):
        train_networks(*samples, _jobs(), [0], validation)
    assert len(list(train_networks(*samples, _jobs(), [0, 1], validation, regressor=QUICK))) == 6


@pytest.mark.parametrize("factor", [1e200, 1e-200])
def test_values_whose_squares_are_no_numbers_are_refused(samples, factor):
    X, Y = samples
    with pytest.raises(InvalidInputError, match="X must be at most"):
        train_networks(factor * X, Y, _jobs(), TRAIN, VALIDATION)
    with pytest.raises(InvalidInputError, match="Y must be at most"):
        train_networks(X, factor * Y, _jobs(), TRAIN, VALIDATION)
