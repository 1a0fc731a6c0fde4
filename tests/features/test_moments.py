import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features.moments import DESCRIPTORS, ORDERS, compute_raw_moments, largest_raw_moment

SLICES = ((0, 50), (50, 100), (100, 150), (0, 256))


def opencv_moments(image, lower, upper):
    grey = np.arange(256)
    table = np.where((grey >= lower) & (grey < upper), grey, 0).astype(np.uint8)
    moments = cv2.moments(cv2.LUT(image, table))
    return [moments[f"m{i}{j}"] for i, j in ORDERS]


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 70), st.integers(1, 300), st.integers(0, 2**32 - 1))
def test_raw_moments_equal_opencv_exactly(height, width, seed):
    images = np.random.default_rng(seed).integers(0, 256, (2, height, width), dtype=np.uint8)
    expected = [[opencv_moments(image, *bounds) for bounds in SLICES] for image in images]
    np.testing.assert_array_equal(compute_raw_moments(images, SLICES), expected)


@pytest.mark.parametrize("shape", [(2048, 2048), (1, 2048), (2048, 1), (3, 129)])
def test_raw_moments_of_white_images_are_exact_integers(shape):
    height, width = shape
    x_sums = [sum(x**i for x in range(width)) for i in range(4)]
    y_sums = [sum(y**j for y in range(height)) for j in range(4)]
    moments = compute_raw_moments(np.full((1, *shape), 255, np.uint8), [(0, 256)])
    assert moments[0, 0].tolist() == [255 * x_sums[i] * y_sums[j] for i, j in ORDERS]


def test_largest_raw_moment_is_that_of_a_white_image():
    white = np.full((1, 40, 300), 255, np.uint8)
    assert largest_raw_moment(40, 300) == compute_raw_moments(white, [(0, 256)]).max()


def test_images_whose_moments_might_overflow_are_refused():
    with pytest.raises(InvalidInputError, match=r"3000 x 3000 .* might not fit in 64 bits"):
        compute_raw_moments(np.zeros((1, 3000, 3000), np.uint8), SLICES)


def test_a_grey_level_on_a_bound_belongs_to_the_upper_slice_only():
    images = np.full((1, 2, 2), 50, np.uint8)
    assert compute_raw_moments(images, [(0, 50), (50, 100)])[0, :, 0].tolist() == [0, 200]


def test_views_are_summed_as_their_copies():
    images = np.random.default_rng(0).integers(0, 256, (3, 20, 30), dtype=np.uint8)
    mirrored = images[:, :, ::-1]
    np.testing.assert_array_equal(
        compute_raw_moments(mirrored, SLICES), compute_raw_moments(mirrored.copy(), SLICES)
    )


WHITE = 255


def descriptors(image, bounds=(0, 50)):
    values = sv.GeometricMoments(slices=[bounds]).fit_transform(np.asarray(image)[None])[0]
    return dict(zip(DESCRIPTORS, values, strict=True))


def scene(shape=(60, 80)):
    return np.full(shape, WHITE, np.uint8)


def ellipse(theta, a=30.0, b=12.0, side=121):
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    along, across = (
        x * np.cos(theta) + y * np.sin(theta),
        y * np.cos(theta) - x * np.sin(theta),
    )
    image = scene((side, side))
    image[(along / a) ** 2 + (across / b) ** 2 <= 1] = 40
    return image


def test_names_are_those_of_the_paper_for_each_slice():
    names = sv.GeometricMoments().fit(np.zeros((1, 4, 4), np.uint8)).get_feature_names_out()
    assert list(names[:8]) == [
        f"{name}_50" for name in ("x", "y", "theta", "r1", "r2", "m00", "sx", "sy")
    ]
    assert [name.rsplit("_")[-1] for name in names[8:]] == ["100"] * 8 + ["150"] * 8


def test_rectangle_has_the_closed_form_moments():
    image = scene()
    image[10:16, 20:50] = 40
    found = descriptors(image)
    assert found == pytest.approx(
        {
            "x": 34.5,
            "y": 12.5,
            "theta": 0.0,
            "r1": math.sqrt((30**2 - 1) / 12),
            "r2": math.sqrt((6**2 - 1) / 12),
            "m00": 40 * 6 * 30,
            "sx": 0.0,
            "sy": 0.0,
        },
        abs=1e-12,
    )


def test_upright_rectangle_has_theta_plus_half_pi():
    image = scene()
    image[5:45, 20:27] = 40
    assert descriptors(image)["theta"] == math.pi / 2


@pytest.mark.parametrize("degrees", [-89, -60, -45, -10, 0, 10, 30, 45, 80, 90])
def test_ellipse_has_its_angle_and_half_its_semi_axes(degrees):
    found = descriptors(ellipse(np.radians(degrees)))
    assert np.degrees(found["theta"]) == pytest.approx(degrees, abs=0.5)
    assert found["r1"] == pytest.approx(30 / 2, rel=0.02)
    assert found["r2"] == pytest.approx(12 / 2, rel=0.02)


def test_radii_are_the_eigenvalues_of_the_printed_inertia_matrix():
    image = np.random.default_rng(1).integers(0, 256, (40, 50), dtype=np.uint8)
    f = np.where(image < 50, image, 0).astype(float)
    y, x = np.mgrid[:40, :50]
    x, y = x - (x * f).sum() / f.sum(), y - (y * f).sum() / f.sum()
    m20, m11, m02 = (x * x * f).sum(), (x * y * f).sum(), (y * y * f).sum()
    eigenvalues = np.linalg.eigvalsh([[m20, -m11], [-m11, m02]])[::-1]
    found = descriptors(image)
    np.testing.assert_allclose([found["r1"], found["r2"]], np.sqrt(eigenvalues / f.sum()))
    np.testing.assert_allclose(found["sx"], (x**3 * f).sum() / m20**1.5, rtol=1e-9)
    np.testing.assert_allclose(found["sy"], (y**3 * f).sum() / m02**1.5, rtol=1e-9)


def test_skewness_is_positive_towards_the_long_tail():
    image = scene()
    image[20:40, 10:20] = 40
    image[28:32, 20:60] = 40
    found = descriptors(image)
    assert found["sx"] > 0
    assert found["sy"] == 0


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_mirroring_mirrors_the_centroid_and_the_signs(seed):
    image = np.random.default_rng(seed).integers(0, 256, (23, 31), dtype=np.uint8)
    found, mirrored = descriptors(image), descriptors(image[:, ::-1])
    for name in ("y", "r1", "r2", "m00", "sy"):
        assert mirrored[name] == pytest.approx(found[name], rel=1e-9, abs=1e-12)
    assert mirrored["x"] == pytest.approx(30 - found["x"], rel=1e-12)
    assert mirrored["sx"] == pytest.approx(-found["sx"], rel=1e-9, abs=1e-12)
    assert mirrored["theta"] == pytest.approx(-found["theta"], rel=1e-9)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(0, 60))
def test_translation_moves_the_centroid_and_nothing_else(seed, down, right):
    blob = np.random.default_rng(seed).integers(1, 256, (20, 20), dtype=np.uint8)
    here, there = scene(), scene()
    here[:20, :20] = blob
    there[down : down + 20, right : right + 20] = blob
    before, after = descriptors(here), descriptors(there)
    assert after.pop("x") - before.pop("x") == pytest.approx(right, abs=1e-10)
    assert after.pop("y") - before.pop("y") == pytest.approx(down, abs=1e-10)
    assert after == pytest.approx(before, rel=1e-9, abs=1e-12)


def test_empty_slice_is_at_the_middle_with_nothing_in_it():
    found = descriptors(scene((60, 80)))
    assert (found.pop("x"), found.pop("y")) == (39.5, 29.5)
    assert set(found.values()) == {0.0}


def test_black_pixels_weigh_nothing():
    image = scene()
    image[10:20, 10:20] = 0
    assert descriptors(image)["m00"] == 0


def test_single_pixel_has_a_place_and_a_mass_only():
    image = scene()
    image[7, 11] = 30
    found = descriptors(image)
    assert (found.pop("x"), found.pop("y"), found.pop("m00")) == (11, 7, 30)
    assert set(found.values()) == {0.0}


def test_symmetric_blob_has_no_angle_and_no_skewness():
    image = scene()
    image[10:21, 30:41] = 40
    image[15, 35] = 7
    found = descriptors(image)
    assert (found["theta"], found["sx"], found["sy"]) == (0, 0, 0)
    assert found["r1"] == found["r2"]


@pytest.mark.parametrize("shape", [(20, 9), (1500, 1100)])
def test_upright_blob_of_uneven_grey_has_theta_exactly_half_pi(shape):
    rng = np.random.default_rng(0)
    for _ in range(5):
        rows, columns = (rng.integers(10, 16, side, dtype=np.uint8) for side in shape)
        assert descriptors(np.outer(rows, columns), (0, 256))["theta"] == math.pi / 2


@settings(deadline=None, max_examples=50)
@given(st.integers(1, 12), st.integers(1, 12), st.integers(1, 256), st.integers(0, 2**32 - 1))
def test_descriptors_are_always_finite(height, width, levels, seed):
    images = np.random.default_rng(seed).integers(0, levels, (3, height, width), dtype=np.uint8)
    features = sv.GeometricMoments().fit_transform(images)
    assert np.isfinite(features).all()
    theta = features[:, 2::8]
    assert (theta > -np.pi / 2).all()
    assert (theta <= np.pi / 2).all()


def test_centroid_of_a_far_blob_in_a_large_image_keeps_its_precision():
    image = scene((2048, 2048))
    image[2000:2040, 1990:2047] = 49
    image[2010, 2000:2047] = 20
    near = descriptors(image[1980:, 1980:])
    far = descriptors(image)
    assert far["x"] - 1980 == pytest.approx(near["x"], abs=1e-9)
    for name in ("theta", "r1", "r2", "sx", "sy"):
        assert far[name] == pytest.approx(near[name], rel=1e-10)


def test_floats_are_rounded_and_clipped_to_grey_levels():
    image = np.array([[29.6, 30.4, -5.0], [300.0, 49.4, 0.0]])
    as_grey = np.array([[30, 30, 0], [255, 49, 0]], np.uint8)
    assert descriptors(image) == descriptors(as_grey)


@pytest.mark.parametrize("slices", [[], [(50, 50)], [(0, 257)], [(-1, 50)], 7, [(0, 50, 100)]])
def test_impossible_slices_are_refused(slices):
    with pytest.raises(InvalidInputError, match=r"pairs \(lower, upper\) of grey levels"):
        sv.GeometricMoments(slices=slices).fit(np.zeros((1, 4, 4), np.uint8))


def test_slices_of_one_name_are_refused():
    with pytest.raises(InvalidInputError, match="upper bound of its own"):
        sv.GeometricMoments(slices=[(0, 50), (10, 50)]).fit(np.zeros((1, 4, 4), np.uint8))
