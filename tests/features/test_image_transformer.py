from contextlib import nullcontext

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.utils import estimator_html_repr
from sklearn.utils.estimator_checks import parametrize_with_checks

import servoscope as sv
import servoscope.features as features
from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.features.image_transformer import check_finite, flatten_images

FIXED = [
    sv.TchebichefMoments(),
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
    *FIXED,
]

LEARNED = [
    sv.Eigenfeatures(n_components=5),
    sv.PoseImageCovariance(),
    sv.LocalFeatureAnalysis(n_components=5, n_per_dof=2, window=6),
    sv.LocalFeatureCovariance(n_components=5),
    sv.PoseLeastSquares(n_components=5),
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


def test_flat_images_take_the_shape_they_are_said_to_have():
    flat, shape = flatten_images(np.zeros((2, 12)), (3, 4))
    assert (flat.shape, shape) == ((2, 12), (3, 4))


def test_flat_images_of_unknown_shape_are_one_row_high():
    assert flatten_images(np.zeros((2, 12)), None)[1] == (1, 12)


def test_flattening_makes_no_copy():
    images = np.zeros((7, 20, 33), np.uint8)
    assert np.shares_memory(flatten_images(images, None)[0], images)


@pytest.mark.parametrize(
    ("images", "image_shape", "message"),
    [
        (np.zeros((2, 13)), (3, 4), "3 x 4 .* have 12 pixels, got 13"),
        (np.zeros((2, 4, 3)), (3, 4), "must be 3 x 4 .* got 4 x 3"),
        (np.zeros(12), None, r"got \(12,\)"),
        (np.zeros((1, 3, 4, 3)), None, r"got \(1, 3, 4, 3\)"),
        (np.zeros((2, 12)), (3, -4), "two whole numbers from 1"),
        (np.zeros((2, 12)), 12, "two whole numbers from 1"),
        ([np.zeros((2, 3)), np.zeros((3, 3))], None, "images of different sizes"),
    ],
)
def test_images_of_the_wrong_shape_are_refused(images, image_shape, message):
    with pytest.raises(InvalidInputError, match=message) as error:
        flatten_images(images, image_shape)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_pixels_that_are_not_finite_are_counted_by_image(bad):
    flat = np.ones((5, 4))
    flat[[1, 3], 2] = bad
    with pytest.raises(InvalidInputError, match=r"image 1 holds NaN or infinity \(2 such"):
        check_finite(flat)


CLASSES = [
    getattr(features, name)
    for name in features.__all__
    if isinstance(getattr(features, name), type) and hasattr(getattr(features, name), "transform")
]
IMAGES = np.random.default_rng(0).integers(0, 255, (40, 32, 32)).astype(np.uint8)
POSES = np.random.default_rng(1).normal(size=(40, 6))


@pytest.mark.parametrize("family", CLASSES)
@pytest.mark.parametrize(
    ("images", "poses"),
    [
        (np.full_like(IMAGES, 7), POSES),
        (np.zeros_like(IMAGES), POSES),
        (np.repeat(IMAGES[:1], 40, axis=0), POSES),
        (IMAGES, np.zeros_like(POSES)),
        (IMAGES, 1e200 * POSES),
        (IMAGES, 1e-200 * POSES),
    ],
)
def test_features_are_finite_or_refused(family, images, poses):
    try:
        found = family().fit(images, poses).transform(images)
    except InvalidInputError:
        return
    assert np.isfinite(found).all()


@pytest.mark.parametrize("family", CLASSES)
def test_masked_images_are_refused(family):
    hidden = np.ma.masked_greater(IMAGES, 200)
    with pytest.raises(InvalidInputError, match=r"X hides .* values behind a mask"):
        family().fit(hidden, POSES)


@pytest.mark.parametrize("family", [features.PoseImageCovariance, features.PoseLeastSquares])
def test_masked_poses_are_refused(family):
    with pytest.raises(InvalidInputError, match=r"y hides .* values behind a mask"):
        family().fit(IMAGES, np.ma.masked_greater(POSES, 0.5))
