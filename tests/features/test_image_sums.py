"""Families fitted to images on disk: as those fitted in memory, whatever the blocks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from planar import planar_data_set
from servoscope.errors import InvalidInputError
from servoscope.features import (
    Eigenfeatures,
    GeometricMoments,
    ImageProjections,
    LocalFeatureAnalysis,
    PoseImageCovariance,
    PoseLeastSquares,
    RobustMoments,
)
from servoscope.features.image_sums import ImageSums, leading_eigenvectors
from servoscope.features.image_transformer import LearnedProjection
from servoscope.features.normalised_images import brightness_norms
from servoscope.storage import stacks
from servoscope.storage.stacks import Stack, create_stack, write_stack


@pytest.fixture(scope="module")
def data():
    return planar_data_set(n_images=120)


@pytest.fixture(scope="module")
def on_disk(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("stack") / "images.zarr"
    return written(path, data.images)


def written(path, images):
    create_stack(path, images.shape, "uint8")
    write_stack(path, 0, images)
    return Stack(path, images.shape, "uint8")


def normalised(images):
    flat = images.reshape(len(images), -1).astype(float)
    return flat / np.linalg.norm(flat, axis=1, keepdims=True)


@given(cuts=st.lists(st.integers(1, 119), max_size=6, unique=True), seed=st.integers(0, 9))
@settings(max_examples=25, deadline=None)
def test_sums_do_not_depend_on_blocks_or_their_order(data, cuts, seed) -> None:
    rng = np.random.default_rng(seed)
    flat, targets = data.images.reshape(len(data), -1), data.delta_p()
    directions = np.random.default_rng(0).normal(size=(flat.shape[1], 3))
    sums = ImageSums(flat.shape[1], 6, directions)
    parts = np.split(np.arange(len(data)), sorted(cuts))
    for i in rng.permutation(len(parts)):
        part = parts[i]
        own = ImageSums(flat.shape[1], 6, directions).update(flat[part], targets[part])
        sums = sums.merge(own) if rng.random() < 0.5 else own.merge(sums)
    found = sums.finalize()
    X = normalised(data.images)
    centred = X - X.mean(axis=0)
    for value, truth in (
        (found.mean, X.mean(axis=0)),
        (found.target_products, targets.T @ centred),
        (found.products, centred.T @ (centred @ directions)),
    ):
        assert_allclose(value, truth, rtol=0, atol=1e-9 * np.abs(truth).max())


def test_statistics_of_no_images_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="none was added"):
        ImageSums(4).finalize()


@pytest.mark.parametrize("arguments", [(0,), (4, -1), (4, 0, [["a"]] * 4), (4, 0, [[np.nan]] * 4)])
def test_sums_over_nothing_or_along_no_directions_are_refused(arguments) -> None:
    with pytest.raises(InvalidInputError, match=r"pixel|directions"):
        ImageSums(*arguments)


def sums(n_pixels=576, n_targets=1, directions=0):
    found = ImageSums(n_pixels, n_targets, np.eye(n_pixels, directions))
    images = np.random.default_rng(0).integers(0, 256, (5, n_pixels))
    return found.update(images, np.ones((5, n_targets)))


@pytest.mark.parametrize("other", [sums(1), sums(575), sums(n_targets=2), sums(directions=1)])
def test_sums_over_others_are_not_merged(other) -> None:
    with pytest.raises(InvalidInputError, match="as many pixels and targets"):
        sums().merge(other)


@pytest.mark.parametrize(
    ("images", "targets", "words"),
    [
        (np.ones((5, 575)), np.ones((5, 1)), r"shape \(n, 576\).*got \(5, 575\)"),
        (np.ones((5, 24, 24)), np.ones((5, 1)), r"got \(5, 24, 24\)"),
        (np.full((5, 576), np.nan), np.ones((5, 1)), "must be finite"),
        (np.full((5, 576), 1e200), np.ones((5, 1)), "finite sum"),
        (np.ones((5, 576)), np.ones((4, 1)), r"\(5, 1\), one row an image, got \(4, 1\)"),
        (np.ones((5, 576)), np.ones(5), r"got \(5,\)"),
        (np.ones((5, 576)), np.full((5, 1), np.inf), "targets must be finite"),
        (np.ones((5, 576)), None, r"got \(5, 0\)"),
        (np.ones((5, 576), complex), np.ones((5, 1)), "arrays of numbers, got complex128"),
        (np.ones((5, 576), object), np.ones((5, 1)), "arrays of numbers, got object"),
    ],
)
def test_a_block_that_is_refused_adds_nothing(images, targets, words) -> None:
    found, same = sums(), sums()
    with pytest.raises(InvalidInputError, match=words):
        found.update(images, targets)
    for value, before in zip(found.finalize(), same.finalize(), strict=True):
        np.testing.assert_array_equal(value, before)


def test_an_empty_block_adds_nothing() -> None:
    found = sums().update(np.empty((0, 576), np.uint8), np.empty((0, 1)))
    np.testing.assert_array_equal(found.finalize().mean, sums().finalize().mean)
    assert found.n_images == 5


def test_eigenvectors_of_noisy_images_are_found_though_their_eigenvalues_lie_close(
    data, tmp_path
) -> None:
    noisy = data.images + np.random.default_rng(0).normal(scale=3, size=data.images.shape)
    images = noisy.clip(0, 255).astype(np.uint8)
    X = normalised(images)
    lengths = np.linalg.svd(X - X.mean(axis=0), compute_uv=False)
    found = leading_eigenvectors(written(tmp_path / "noisy", images).flat(), 85)[1]
    truth = lengths[:85] ** 2
    assert_allclose(found, truth, rtol=0, atol=1e-9 * truth[0])


def test_images_that_are_all_alike_have_no_eigenvectors(data, tmp_path) -> None:
    alike = written(tmp_path / "alike", np.repeat(data.images[:1], 30, axis=0))
    with pytest.raises(InvalidInputError, match="vary in 0 directions"):
        leading_eigenvectors(alike.flat(), 3)


def test_eigenvectors_are_those_of_a_singular_value_decomposition(data, on_disk) -> None:
    X = normalised(data.images)
    _, lengths, vectors = np.linalg.svd(X - X.mean(axis=0), full_matrices=False)
    mean, eigenvalues, components = leading_eigenvectors(on_disk.flat(), 10)
    assert_allclose(mean, X.mean(axis=0), atol=1e-12)
    assert_allclose(eigenvalues, lengths[:10] ** 2, rtol=0, atol=1e-9 * lengths[0] ** 2)
    overlap = np.abs(np.einsum("ij,ij->i", components, vectors[:10]))
    assert_allclose(overlap, 1, atol=1e-5)


def test_more_eigenvectors_than_the_images_have_are_refused(tmp_path) -> None:
    images = np.zeros((30, 4, 4), np.uint8)
    images[:, 0, 0], images[:, 1, 1] = 100, np.arange(30)
    stack = written(tmp_path / "few", images)
    with pytest.raises(InvalidInputError, match=r"5 eigenvectors .* vary in 2"):
        Eigenfeatures(5).fit(stack)
    with pytest.raises(InvalidInputError, match=r"one row for each of 30 images, got .*\(29, 6\)"):
        PoseImageCovariance().fit(stack, np.zeros((29, 6)))


def test_more_eigenvectors_than_pixels_are_refused(tmp_path) -> None:
    images = np.random.default_rng(0).integers(0, 256, (40, 3, 4), dtype=np.uint8)
    with pytest.raises(InvalidInputError, match=r"20 eigenvectors .* vary in 12"):
        Eigenfeatures(20).fit(written(tmp_path / "small", images))


@pytest.mark.parametrize(
    "family",
    [
        GeometricMoments(),
        ImageProjections(),
        RobustMoments(),
        Eigenfeatures(10),
        PoseImageCovariance(),
        PoseLeastSquares(8),
        LocalFeatureAnalysis(10, n_per_dof=4, window=4),
    ],
    ids=lambda family: type(family).__name__,
)
def test_features_of_images_on_disk_are_those_in_memory(family, data, on_disk, monkeypatch) -> None:
    monkeypatch.setattr(stacks, "BLOCK_BYTES", 30 * 24 * 24)
    targets = data.delta_p() / data.ranges()
    is_sum = isinstance(family, LearnedProjection)  # which is in float32 of uint8 images
    images = data.images.astype(float) if is_sum else data.images
    in_memory = family.fit(images, targets).transform(images)
    from_disk = family.fit(on_disk, targets).transform(on_disk)
    names = family.get_feature_names_out()
    assert from_disk.shape == (len(data), len(names))
    scale = np.abs(in_memory).max(axis=0)
    single = 1e-5 if isinstance(family, ImageProjections) else 1e-6  # projections are in float32
    assert_allclose(from_disk / scale, in_memory / scale, rtol=0, atol=single)


def test_lengths_are_those_of_the_images(data) -> None:
    flat = data.images.reshape(len(data), -1)
    assert_allclose(brightness_norms(flat), np.linalg.norm(flat.astype(float), axis=1))
