"""What scikit-learn asks of every family, and what every family promises about images."""

from contextlib import nullcontext

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.utils import estimator_html_repr
from sklearn.utils.estimator_checks import parametrize_with_checks

import servoscope as sv
from servoscope.errors import InvalidInputError, ServoscopeWarning

FIXED = [
    sv.TchebichefMoments(),
    sv.CosineCoefficients(),
    sv.FourierFeatures(),
    sv.ImageProjections(),
    sv.LogPolarFeatures(),
]

# The checks use flat "images" of as few as two pixels, so bases and windows are small here.
CHECKED = [
    sv.GeometricMoments(),
    sv.GradientMoments(),
    sv.IntensityMoments(),
    sv.RobustMoments(),
    sv.Eigenfeatures(n_components=1),
    sv.PoseImageCovariance(),
    sv.LocalFeatureAnalysis(n_components=1, n_per_dof=1, window=2),
    sv.LocalFeatureCovariance(n_components=1),
    sv.PoseLeastSquares(n_components=1),
    sv.WhitenedPoseCovariance(),
    *FIXED,
]

LEARNED = [
    sv.Eigenfeatures(n_components=5),
    sv.PoseImageCovariance(),
    sv.LocalFeatureAnalysis(n_components=5, n_per_dof=2, window=6),
    sv.LocalFeatureCovariance(n_components=5),
    sv.PoseLeastSquares(n_components=5),
    sv.WhitenedPoseCovariance(),
    sv.RobustMoments(n_components=5),
]
FAMILIES = [*LEARNED, sv.GeometricMoments(), sv.GradientMoments(), sv.IntensityMoments(), *FIXED]

each_family = pytest.mark.parametrize("family", FAMILIES, ids=lambda f: type(f).__name__)


# No check is expected to fail. scikit-learn itself skips one, of array API input, unless the
# environment variable SCIPY_ARRAY_API is set; the families take NumPy arrays.
@pytest.mark.filterwarnings("ignore:The images are floats from 0 to 1")
@parametrize_with_checks(CHECKED)
def test_scikit_learn_estimator_checks(estimator, check):
    check(estimator)


@each_family
def test_flat_images_give_the_same_features(family, images, delta_p):
    flat = images.reshape(60, -1)
    of_images = clone(family).fit_transform(images, delta_p)
    of_flat = clone(family).set_params(image_shape=(30, 40)).fit_transform(flat, delta_p)
    np.testing.assert_array_equal(of_flat, of_images)


@each_family
def test_fitted_family_knows_the_size_of_its_images(family, images, delta_p):
    fitted = clone(family).fit(images, delta_p)
    assert fitted.image_shape_ == (30, 40)
    assert fitted.n_features_in_ == 1200


@each_family
def test_pandas_output_has_the_names(family, images, delta_p):
    fitted = clone(family).set_output(transform="pandas").fit(images, delta_p)
    frame = fitted.transform(images)
    assert list(frame.columns) == list(fitted.get_feature_names_out())
    assert len(set(frame.columns)) == frame.shape[1]


@each_family
def test_family_works_in_a_pipeline_on_images(family, images, delta_p):
    pipeline = make_pipeline(clone(family), Ridge()).fit(images, delta_p)
    assert pipeline.predict(images[:3]).shape == (3, 6)
    assert type(family).__name__ in estimator_html_repr(pipeline)


@each_family
def test_features_of_one_image_are_those_it_has_among_others(family, images, delta_p):
    fitted = clone(family).fit(images, delta_p)
    np.testing.assert_allclose(
        fitted.transform(images[3:4]), fitted.transform(images)[3:4], rtol=1e-5, atol=1e-5
    )


@each_family
def test_images_of_another_size_are_refused_with_both_sizes(family, images, delta_p):
    fitted = clone(family).fit(images, delta_p)
    for wrong in (images[:, :20], images.reshape(60, 40, 30)):
        with pytest.raises(InvalidInputError, match=r"those of fit were of 30 x 40") as error:
            fitted.transform(wrong)
        assert "{} x {}".format(*wrong.shape[1:]) in str(error.value)
        assert "\n" not in str(error.value)


@each_family
def test_one_image_that_is_not_in_a_stack_is_refused(family, images, delta_p):
    fitted = clone(family).fit(images, delta_p)
    with pytest.raises(InvalidInputError, match="of 40 pixels, those of fit were of 30 x 40"):
        fitted.transform(images[0])


@each_family
def test_pixels_that_are_not_finite_are_refused(family, images, delta_p):
    broken = images.astype(float)
    broken[7, 2, 3] = np.nan
    with pytest.raises(InvalidInputError, match="image 7 holds NaN"):
        clone(family).fit(broken, delta_p)
    with pytest.raises(InvalidInputError, match="image 7 holds NaN"):
        clone(family).fit(images, delta_p).transform(broken)


@each_family
def test_floats_from_0_to_1_give_the_features_of_grey_levels(family, images, delta_p):
    shares, slices = images / 255.0, isinstance(family, sv.GeometricMoments)
    says = pytest.warns(ServoscopeWarning, match="they are multiplied by 255")
    with says if slices else nullcontext():
        fitted = clone(family).fit(shares, delta_p)
    of_levels = clone(family).fit(255.0 * shares, delta_p)
    for some in (shares, 0.02 * shares[:2]):  # one scale, however dark the images are
        np.testing.assert_allclose(
            fitted.transform(some), of_levels.transform(255.0 * some), rtol=1e-4, atol=1e-6
        )


@each_family
@pytest.mark.filterwarnings("ignore:The images are floats from 0 to 1")
def test_images_on_another_scale_than_those_of_fit_are_refused(family, images, delta_p):
    with pytest.raises(InvalidInputError, match="255, or, if the images are black"):
        clone(family).fit(images, delta_p).transform(images / 255.0)
    with pytest.raises(InvalidInputError, match="divide them by 255"):
        clone(family).fit(images / 255.0, delta_p).transform(images)


@each_family
def test_no_images_are_refused(family, images, delta_p):
    with pytest.raises(InvalidInputError, match="0 sample"):
        clone(family).fit(images[:0], delta_p[:0])


@pytest.mark.parametrize("family", LEARNED, ids=lambda f: type(f).__name__)
def test_one_image_is_too_few_to_vary(family, images, delta_p):
    with pytest.raises(InvalidInputError, match="minimum of 2 is required"):
        clone(family).fit(images[:1], delta_p[:1])


@each_family
def test_images_are_left_as_they_were(family, images, delta_p):
    before = images.copy()
    clone(family).fit(images, delta_p).transform(images)
    np.testing.assert_array_equal(images, before)
