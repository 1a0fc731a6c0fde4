"""Images taken anew, and first order against closed forms and against them."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import BaseEstimator, TransformerMixin

from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.errors import InvalidInputError
from servoscope.pipeline import Recipe
from servoscope.scene.disturbances import DISTURBANCES, Disturbance
from servoscope.sensitivity import (
    fit_pose_model,
    measure,
    predict_rms,
    take_images,
)
from servoscope.sensitivity.measurement import n_sets

CONFIG = AcquisitionConfig(n_images=12, image_size=32, seed=3, part="textured_plane")
NUMBERS = range(4, 12)


def test_undisturbed_images_are_those_of_the_acquisition(tmp_path):
    data = acquire(tmp_path / "data", CONFIG, n_jobs=1)
    assert np.array_equal(take_images(CONFIG, [4, 1]), data.images[[4, 1]])


@pytest.mark.parametrize("name", DISTURBANCES)
def test_a_disturbance_leaves_images_as_they_are_at_strength_0_alone(name):
    disturbance = DISTURBANCES[name]
    config = replace(CONFIG, image_size=128)
    clean = take_images(config, [2])
    assert np.array_equal(take_images(config, [2], disturbance, 0.0), clean)
    for strength in (min(disturbance.strengths), max(disturbance.strengths)):
        assert not np.array_equal(take_images(config, [2], disturbance, strength), clean)


def test_draws_differ_and_each_goes_one_way_at_every_strength():
    noise = DISTURBANCES["noise"]
    clean = take_images(CONFIG, [0]).astype(float)
    weak, strong, other = (
        take_images(CONFIG, [0], noise, strength, draw) - clean
        for strength, draw in ((5.0, 0), (10.0, 0), (5.0, 1))
    )
    assert np.corrcoef(weak.ravel(), strong.ravel())[0, 1] > 0.99
    assert abs(np.corrcoef(weak.ravel(), other.ravel())[0, 1]) < 0.1
    assert strong.std() == pytest.approx(10.0, rel=0.05)


def test_another_robot_or_image_is_refused():
    with pytest.raises(InvalidInputError, match="robot free only"):
        take_images(AcquisitionConfig(n_images=5, robot="arm"), [0])
    with pytest.raises(InvalidInputError, match="of the 12 images"):
        take_images(CONFIG, [12])


class PixelSums(TransformerMixin, BaseEstimator):
    """Weighted sums of pixels: features that are linear in the image."""

    def fit(self, X, y=None):
        self.weights_ = np.random.default_rng(0).standard_normal((X[0].size, 7)) / 64
        return self

    def transform(self, X):
        return X.reshape(len(X), -1) @ self.weights_


class Linear(BaseEstimator):
    """A linear map that is not fitted, with the gradient that it has."""

    def fit(self, X, y):
        self.weights_ = np.linspace(-1, 1, X.shape[1])
        return self

    def predict(self, X):
        return X @ self.weights_

    def gradient(self, X):
        return np.tile(self.weights_, (len(X), 1))


class LinearWithoutGradient(Linear):
    gradient = property()


def linear_model(regressor=None):
    images = take_images(CONFIG, range(4))
    delta_p = CONFIG.displacements()[:4]
    recipe = Recipe(PixelSums(), regressor=regressor or Linear())
    return fit_pose_model(images, delta_p, np.full(6, 1e-3), recipe)


def pixel_weights(model):
    """What the prediction of tx, in mm, changes by for one grey level of each pixel."""
    pixels = model.pipeline.fitted_["PixelSums"].transformer.weights_
    return pixels @ model.pipeline.regressors_["tx"].regressor.weights_


def test_noise_through_a_linear_model_is_the_sum_of_the_squared_derivatives():
    model = linear_model()
    noise = replace(DISTURBANCES["noise"], strengths=(2.0, 4.0, 8.0))
    growth = measure(noise, {"m": model}, CONFIG, NUMBERS, n_draws=20, n_jobs=1)["m"]["tx"]
    variance = (pixel_weights(model) ** 2).sum()
    wanted = np.sqrt(growth.clean_rms**2 + np.square(growth.strengths) * variance)
    assert growth.predicted_rms == pytest.approx(wanted, rel=0.08)
    assert growth.simulated_rms == pytest.approx(growth.predicted_rms, rel=0.02)
    assert growth.parts_at is None


def test_first_order_of_a_linear_model_and_change_is_exact():
    """Brighter by a grey level for each unit: rounding leaves it exact at whole strengths."""

    def brighter(look, grey, rng):
        size = look.scene.image_size
        return replace(look, added_noise=np.full((size, size), grey))

    disturbance = Disturbance(brighter, "grey levels", (-4.0, -1.0, 1.0, 2.0, 4.0))
    model = linear_model()
    growth = measure(disturbance, {"m": model}, CONFIG, NUMBERS, n_jobs=1)["m"]["tx"]
    assert growth.simulated_rms == pytest.approx(growth.predicted_rms, rel=1e-9)
    known = 1e3 * CONFIG.displacements()[list(NUMBERS), 0]
    images = take_images(CONFIG, NUMBERS).reshape(len(NUMBERS), -1)
    clean = images @ pixel_weights(model) - known
    assert growth.clean_rms == pytest.approx(np.sqrt((clean**2).mean()))
    shift = pixel_weights(model).sum()
    assert growth.simulated_bias == pytest.approx(clean.mean() + shift * np.array(growth.strengths))


def test_a_disturbance_by_its_square_is_predicted_by_its_square():
    def brighter(look, strength, rng):
        size = look.scene.image_size
        return replace(look, added_noise=np.full((size, size), strength**2))

    disturbance = Disturbance(brighter, "1", (1.0, 2.0, 3.0), power=2)
    growth = measure(disturbance, {"m": linear_model()}, CONFIG, NUMBERS, n_jobs=1)["m"]["rz"]
    assert growth.simulated_rms == pytest.approx(growth.predicted_rms, rel=1e-9)


def test_regressors_without_a_gradient_are_differenced():
    rng = np.random.default_rng(1)
    X, direction = rng.standard_normal((2, 5, 7))
    closed, differenced = (linear_model(r) for r in (Linear(), LinearWithoutGradient()))
    assert not hasattr(differenced.pipeline.regressors_["tx"].regressor, "gradient")
    assert differenced.slope(X, direction) == pytest.approx(closed.slope(X, direction), rel=1e-6)
    assert not differenced.slope(X, np.zeros((5, 7))).any()


def test_the_slope_is_that_of_the_prediction():
    class Cubic(Linear):
        def predict(self, X):
            return (X @ self.weights_) ** 3

        def gradient(self, X):
            return 3 * ((X @ self.weights_) ** 2)[:, None] * self.weights_

    images = take_images(CONFIG, range(4))
    ranges = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    model = fit_pose_model(images, np.zeros((4, 6)), ranges, Recipe(PixelSums(), regressor=Cubic()))
    X, direction = np.random.default_rng(1).standard_normal((2, 5, 7))
    h = 1e-5
    wanted = (model.predict(X + h * direction) - model.predict(X - h * direction)) / (2 * h)
    assert model.slope(X, direction) == pytest.approx(wanted, rel=1e-6)


def test_leaps_of_features_do_not_add_up_in_the_prediction():
    """Two derivatives that agree but for noise of their own; the closed form without the noise."""
    rng = np.random.default_rng(0)
    clean, slope = rng.standard_normal((2, 4000, 1))
    noise = 10 * rng.standard_normal((2, 1, 4000, 1))
    (got,) = predict_rms(clean, (slope + noise[0], slope + noise[1]), [2.0])
    assert got == pytest.approx(np.sqrt(1 + 4), rel=0.5)
    squared_up = np.sqrt(((clean + 2 * (slope + noise[0])) ** 2).mean())
    assert squared_up > 15


def test_progress_is_reported_after_every_set_of_images():
    noise = replace(DISTURBANCES["noise"], strengths=(2.0, 8.0))
    done = []
    measure(noise, {"m": linear_model()}, CONFIG, NUMBERS, n_jobs=1, on_progress=done.append)
    assert done == list(range(1, n_sets(noise) + 1))


def test_strengths_that_cannot_be_are_refused():
    for strengths in ((), (1.0,), (-1.0, 1.0), (0.0, 1.0), (1.0, np.inf)):
        with pytest.raises(InvalidInputError, match="strengths must be"):
            Disturbance(lambda look, s, rng: look, "px", strengths)
    with pytest.raises(InvalidInputError, match="power must be"):
        Disturbance(lambda look, s, rng: look, "px", (1.0, 2.0), power=3)
