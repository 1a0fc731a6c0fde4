"""Images of the part are told from others by their similarity, and the limit is set by both."""

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from servoscope.errors import ServoscopeWarning
from servoscope.keyframe import CameraModel, Keyframe
from servoscope.poses import displacements_from_poses, poses_from_displacements
from servoscope.positioning import KeyframeModel
from servoscope.positioning.recognition import (
    LEAST_SIMILARITY,
    Recognition,
    chance_similarity,
    least_similarity,
)

SIZE = 96
SEED = 3


def flat_keyframe(shape: tuple[int, int] = (SIZE, SIZE)) -> Keyframe:
    """The plane of `planar_images`, known exactly."""
    image = planar_images(np.zeros((1, 6)), SIZE, SEED)[0][: shape[0], : shape[1]]
    depth = np.full((48, 48), 1 / PIVOT, np.float32)
    return Keyframe(
        image, CameraModel.from_pixels(1.4 * SIZE, (SIZE / 2, SIZE / 2), width=SIZE, height=SIZE),
        np.eye(4), depth, np.ones_like(depth),
        poses_from_displacements(np.eye(4), 0.5 * _drawn(30), PIVOT), np.zeros((20, 20)),
        np.zeros(6), PIVOT, 1.0, 1.0,
    )  # fmt: skip


def _drawn(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES


def test_an_image_is_like_what_is_expected_where_it_was_taken_and_nowhere_else() -> None:
    recognition = Recognition(flat_keyframe())
    for delta_p in 0.6 * _drawn(6, 1):
        (image,) = planar_images(delta_p[None], SIZE, SEED)
        there, elsewhere = poses_from_displacements(np.eye(4), np.stack([delta_p, -delta_p]), PIVOT)
        assert recognition.similarity(image, there) > 0.97
        assert recognition.similarity(image, elsewhere) < 0.85


def test_a_quarter_that_is_covered_hardly_changes_the_similarity() -> None:
    recognition = Recognition(flat_keyframe())
    delta_p = 0.3 * _drawn(1, 2)
    (image,) = planar_images(delta_p, SIZE, SEED)
    image[: SIZE // 2, : SIZE // 2] = np.random.default_rng(0).integers(0, 255, (SIZE // 2,) * 2)
    (there,) = poses_from_displacements(np.eye(4), delta_p, PIVOT)
    assert recognition.similarity(image, there) > 0.9


def test_what_is_hidden_by_a_nearer_surface_does_not_count() -> None:
    """A near plate before a wall, seen from aside: some of the wall is behind the plate."""
    keyframe = flat_keyframe()
    depth = np.full((48, 48), 1.0, np.float32)
    depth[:, :20] = 4.0
    values = {**vars(keyframe), "inverse_depth": depth}
    values = {k: v for k, v in values.items() if k in Keyframe.__dataclass_fields__}
    recognition = Recognition(Keyframe(**values))
    T = np.eye(4)
    assert not recognition._is_hidden(T, keyframe.camera.values).any()
    T[0, 3] = 0.05
    hidden = recognition._is_hidden(T, keyframe.camera.values).reshape(SIZE, SIZE)
    shift = 1.4 * SIZE * 0.05 * (4.0 - 1.0)
    assert hidden[:, :38].sum() == 0
    assert hidden.sum(axis=1).mean() == pytest.approx(shift, abs=3)


def test_what_chance_reaches_is_found_from_turned_images() -> None:
    images = planar_images(0.4 * _drawn(4, 5), SIZE, SEED)
    chance = chance_similarity(flat_keyframe(), images, 1.5 * RANGES)
    assert 0 <= chance < 0.7


@pytest.mark.parametrize(
    ("own", "chance", "limit"),
    [
        (np.full(20, 0.98), 0.2, 0.74),
        (np.full(20, 0.98), 0.7, 0.84),
        (np.empty(0), 0.2, LEAST_SIMILARITY),
    ],
)
def test_the_limit_is_between_chance_and_images_held_out(own, chance, limit) -> None:
    assert least_similarity(own, chance) == pytest.approx(limit)


@pytest.mark.parametrize(("own", "limit"), [(0.6, LEAST_SIMILARITY), (0.88, 0.88)])
def test_where_chance_reaches_as_much_the_limit_is_not_lowered_and_a_warning_is_given(own, limit):
    with pytest.warns(ServoscopeWarning, match="something else"):
        assert least_similarity(np.full(20, own), 0.9) == pytest.approx(limit)


def test_a_model_states_its_own_limit() -> None:
    keyframe = flat_keyframe()
    model = KeyframeModel(keyframe, reach=RANGES, accuracy={"least_similarity": 0.6})
    delta_p = 0.3 * _drawn(1, 4)
    (image,) = planar_images(delta_p, SIZE, SEED)
    estimate = model.estimate(image)
    assert estimate.least_similarity == 0.6
    read = displacements_from_poses(np.eye(4), estimate.displacement[None], PIVOT)
    np.testing.assert_allclose(read, delta_p, atol=2e-3)
    assert estimate.similarity > 0.97
    without = KeyframeModel(keyframe, reach=RANGES).estimate(image)
    assert without.least_similarity == LEAST_SIMILARITY
