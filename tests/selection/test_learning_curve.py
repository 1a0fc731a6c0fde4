import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.kernels import fit_kernel
from servoscope.selection.kernel_prediction import predict_samples
from servoscope.selection.learning_curve import learning_curve


def samples(n, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 4))
    return X, np.sin(2 * X[:, 0]) * X[:, 1] + X[:, 2] ** 2 + rng.normal(0, noise, n)


def reached(X, y, X_new, y_new):
    return np.sqrt(np.mean((predict_samples(fit_kernel(X, y), X, y, X_new) - y_new) ** 2))


def test_it_says_what_twice_and_five_times_the_images_reach():
    X, y = samples(160, noise=0.05)
    curve = learning_curve(X, y)
    X_new, y_new = samples(1000, seed=7, noise=0.05)
    for n in (320, 800):
        X_more, y_more = samples(n, seed=3, noise=0.05)
        rms, interval = curve.rms_at(n)
        truth = reached(X_more, y_more, X_new, y_new)
        assert rms[0] == pytest.approx(truth, rel=0.25)
        assert interval[0, 0] <= truth <= interval[1, 0]


def test_the_sizes_are_shares_of_the_samples_and_errors_fall_with_them():
    X, y = samples(160)
    curve = learning_curve(X, np.column_stack([y, X[:, 0]]))
    assert curve.n_images.tolist() == [20, 40, 80, 120, 160]
    assert curve.rms.shape == (5, 2)
    assert (curve.rms[0] > curve.rms[-1]).all()
    np.testing.assert_array_equal(curve.rms[-1], curve.forecast.rms)


def test_few_samples_are_cut_into_quarters():
    X, y = samples(40)
    assert learning_curve(X, y).n_images.tolist() == [10, 20, 30, 40]


def test_groups_stay_together():
    X, y = samples(160)
    curve = learning_curve(X, y, groups=np.arange(160) // 32)
    assert curve.n_images.tolist() == [40, 80, 120, 160]


def test_the_images_for_a_wished_error_are_those_at_which_it_is_reached():
    X, y = samples(80, noise=0.02)
    curve = learning_curve(X, y)
    wished = 0.8 * curve.rms_at(80).rms[0]
    (n,) = curve.images_for(wished)
    assert curve.rms_at(n).rms[0] <= wished < curve.rms_at(n - 1).rms[0]


def test_no_number_of_images_takes_noise_away():
    X, y = samples(160, noise=0.3)
    assert learning_curve(X, y).images_for([0.03]) == [None]


def test_a_target_that_never_changes_needs_no_images():
    X, y = samples(80)
    curve = learning_curve(X, np.column_stack([np.full(80, 0.3), y]))
    assert curve.rms_at(160).rms[0] == 0
    assert curve.images_for([0.001, 1.0]) == [20, 20]


@pytest.mark.parametrize(
    ("n", "groups", "message"),
    [(39, None, "at least 40 samples, got 39"), (40, np.zeros(40), "at least 4 groups")],
)
def test_too_little_is_named_in_one_line(n, groups, message):
    with pytest.raises(InvalidInputError, match=message):
        learning_curve(*samples(n), groups=groups)


@pytest.mark.parametrize("n_images", [9, 4001, float("nan")])
def test_numbers_of_images_out_of_reach_are_refused(n_images):
    curve = learning_curve(*samples(40))
    with pytest.raises(InvalidInputError, match="n_images must be from 10 to 4000"):
        curve.rms_at(n_images)
