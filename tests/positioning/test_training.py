"""Training comes to one model for a seed, and asks for images that it can be made from."""

import re
from dataclasses import replace

import numpy as np
import pytest

from planar import planar_images
from planar_cell import SIZE, T_WORLD_REF
from planar_model import RANGES, RINGS, camera_data, camera_model
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import Split
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.poses import DOFS, poses_from_displacements
from servoscope.positioning.training import (
    N_STAGES,
    Assessed,
    check_observable,
    train,
    within_range,
)
from servoscope.storage.model_folder import ARRAYS, MODEL


def subset(data: PoseImageSet, chosen) -> PoseImageSet:
    """Some of the images."""
    return replace(data, images=data.images[chosen], T_world_cam=data.T_world_cam[chosen], names=())


@pytest.mark.slow
def test_a_seed_gives_one_model_whatever_the_number_of_processes(tmp_path) -> None:
    data, told = camera_data(((140, 1.0),)), []
    train(data, method="levels", n_jobs=1).save(tmp_path / "one")
    train(data, method="levels", n_jobs=2, on_progress=told.append).save(tmp_path / "two")
    train(data, method="levels", n_jobs=1, seed=1).save(tmp_path / "other")
    for part in (ARRAYS, MODEL):
        one, two, other = (tmp_path / name / part for name in ("one", "two", "other"))
        assert one.read_bytes() == two.read_bytes() != other.read_bytes()
    assert told == list(range(1, N_STAGES + 1))


def test_a_model_knows_what_it_was_made_for() -> None:
    model, data = camera_model(), camera_data()
    np.testing.assert_array_equal(model.reach, RANGES)
    np.testing.assert_array_equal(model.reference_image, data.reference_image)
    assert model.trained_on == data.source
    assert model.trained_on is not data.source
    assert np.allclose([level.radius for level in model.levels], [1, 0.2, 0.03], rtol=0.3)
    assert sum(n for n, _ in RINGS) == len(data)


def test_what_it_reaches_is_told_by_rings() -> None:
    rings = camera_model().accuracy["rings"]
    assert len(rings) == 3
    clean = [np.mean(list(ring["clean"].values())) for ring in rings]
    assert clean[0] > 3 * clean[1]
    assert clean[0] > 3 * clean[2]


def scattered(n_far: int, n: int = 100) -> PoseImageSet:
    """Images of nothing, some of them far away, whose range is not known."""
    delta_p = np.random.default_rng(0).uniform(-1, 1, (n, 6)) * RANGES
    delta_p[:n_far] = 4 * RANGES
    poses = poses_from_displacements(np.eye(4), delta_p, 0.55)
    images = np.zeros((n, 4, 4), np.uint8)
    return PoseImageSet(images, poses, np.eye(4), images[0], times=np.arange(n) / 7)


def test_outliers_that_are_not_trained_on_are_named_in_a_line() -> None:
    with pytest.warns(
        ServoscopeWarning, match=r"^5 of 100 .* 000000, 000001, 000002, ...;"
    ) as said:
        kept = within_range(scattered(5))
    np.testing.assert_array_equal(kept.ranges(), scattered(5).ranges())
    assert len(said) == 1
    assert "\n" not in str(said[0].message)
    assert list(kept.names) == [f"{i:06d}" for i in range(5, 100)]
    assert kept.times is not None
    assert kept.times[0] == 5 / 7
    with pytest.warns(ServoscopeWarning, match=r"^1 of 100 .* others: 000000;"):
        assert len(within_range(scattered(1))) == 99


def test_no_image_is_left_out_where_many_are_far_or_the_range_was_asked_for() -> None:
    assert len(within_range(scattered(6))) == 100
    assert len(within_range(replace(scattered(5), pivot_ranges=RANGES))) == 100


@pytest.mark.parametrize("dof", [0, 5])
def test_levels_of_a_dof_that_never_moves_are_refused(dof) -> None:
    delta_p = np.random.default_rng(0).uniform(-1, 1, (80, 6)) * RANGES
    delta_p[:, dof] = 0
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), SIZE, seed=3)
    poses = poses_from_displacements(T_WORLD_REF, delta_p, 0.55)
    data = PoseImageSet(images[:-1], poses, T_WORLD_REF, images[-1])
    with pytest.raises(InvalidInputError, match="in all six dofs, but these are for") as info:
        train(data, method="levels", n_jobs=1)
    assert "\n" not in str(info.value)
    with pytest.raises(DataSetError, match=f"{DOFS[dof]} never move") as info:
        train(replace(data, asked_dofs=DOFS), n_jobs=1)
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("chosen", [slice(0, 2), slice(0, 9), slice(0, 40), slice(300, None)])
def test_too_few_images_over_the_range_are_refused(chosen) -> None:
    with pytest.raises(DataSetError, match=r"at least \d+ images displaced by 70%") as info:
        train(subset(camera_data(), chosen), method="levels", n_jobs=1)
    assert "\n" not in str(info.value)


def test_one_image_is_refused() -> None:
    with pytest.raises(DataSetError, match="never move"):
        train(subset(camera_data(), slice(0, 1)), n_jobs=1)


def test_the_fewest_images_that_are_asked_for_are_enough() -> None:
    data = camera_data()
    with pytest.raises(DataSetError) as info:
        train(subset(data, slice(0, 9)), method="levels", n_jobs=1)
    least = int(re.search(r"at least (\d+)", str(info.value))[1])
    far = np.flatnonzero(np.abs(data.delta_p() / RANGES).max(axis=1) > 0.7)
    model = train(subset(data, far[:least]), method="levels", n_jobs=1)
    assert np.isfinite(model.estimate(data.images[far[least]]).displacement).all()


@pytest.mark.slow
def test_images_a_row_behind_their_poses_are_refused_before_a_robot_is_moved() -> None:
    data = camera_data(((200, 1.0), (120, 0.2)))
    late = replace(data, images=np.roll(data.images, 1, axis=0))
    with pytest.raises(DataSetError, match="no robot may be moved by that"):
        train(late, n_jobs=1)


def test_dofs_that_are_predicted_no_better_than_by_their_mean_are_named() -> None:
    shares = dict(zip(DOFS, [0.1, 0.79, 0.85, 0.2, np.nan, 0.3], strict=True))
    with pytest.warns(ServoscopeWarning, match=r"in tz 0.85, ry nan"):
        check_observable(shares)
    check_observable(dict.fromkeys(DOFS, 0.5))
    with pytest.raises(DataSetError, match="no robot may be moved"):
        check_observable({**dict.fromkeys(DOFS, 1.0), "rz": 0.1})


def split_of(n: int, *, test: int) -> Split:
    """The first images test, and the last belongs to no part."""
    return Split(np.arange(test, n - 3), np.arange(n - 3, n - 1), np.arange(test))


def test_levels_are_learned_without_the_test_images_of_an_assessment(monkeypatch) -> None:
    given = {}

    def learn_levels(images, p, reference_image, rng, groups):
        given["groups"] = groups
        raise DataSetError("Enough is known.")

    monkeypatch.setattr("servoscope.positioning.training.learn_levels", learn_levels)
    data = scattered(5, 140)
    found = Assessed(split_of(140, test=35), np.arange(140), {"loop": None})
    with (
        pytest.warns(ServoscopeWarning, match="not trained on"),
        pytest.raises(DataSetError, match="Enough is known"),
    ):
        train(data, method="levels", assessment=found)
    expected = np.repeat([0, 1, -1], [35, 104, 1])[5:]  # the first five are outliers
    np.testing.assert_array_equal(given["groups"], expected)


@pytest.mark.parametrize(
    "split",
    [
        split_of(42, test=10),
        Split(np.arange(30), np.arange(30, 35), np.arange(34, 40)),
        Split(np.arange(30), np.arange(30, 35), np.arange(0)),
        Split(np.arange(-1, 30), np.arange(30, 35), np.arange(35, 40)),
    ],
)
def test_an_assessment_of_other_images_is_refused(split) -> None:
    found = Assessed(split, np.arange(len(split.learned) + len(split.test)), {})
    with pytest.raises(InvalidInputError, match="must be of these 40 images") as info:
        train(scattered(0, 40), assessment=found)
    assert "\n" not in str(info.value)
