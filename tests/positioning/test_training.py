"""What images a model is trained on, and which it refuses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from planar import planar_images
from planar_cell import SIZE, T_WORLD_REF
from planar_flange import RANGES, camera_data
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import Split
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.pipeline import PosePipeline
from servoscope.poses import DOFS, poses_from_displacements
from servoscope.positioning.accuracy import check_observable
from servoscope.positioning.training import Assessed, train, within_range


def subset(data: PoseImageSet, chosen) -> PoseImageSet:
    """Some of the images."""
    return replace(data, images=data.images[chosen], T_world_cam=data.T_world_cam[chosen], names=())


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
def test_a_dof_that_was_asked_for_and_never_moves_is_refused(dof) -> None:
    delta_p = np.random.default_rng(0).uniform(-1, 1, (80, 6)) * RANGES
    delta_p[:, dof] = 0
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), SIZE, seed=3)
    poses = poses_from_displacements(T_WORLD_REF, delta_p, 0.55)
    data = PoseImageSet(images[:-1], poses, T_WORLD_REF, images[-1])
    with pytest.raises(DataSetError, match=f"{DOFS[dof]} never move") as info:
        train(replace(data, asked_dofs=DOFS), n_jobs=1)
    assert "\n" not in str(info.value)


def test_one_image_is_refused() -> None:
    with pytest.raises(DataSetError, match="never move"):
        train(subset(camera_data(), slice(0, 1)), n_jobs=1)


def test_dofs_that_are_predicted_no_better_than_by_their_mean_are_named() -> None:
    shares = dict(zip(DOFS, [0.1, 0.79, 0.85, 0.2, np.nan, 0.3], strict=True))
    with pytest.warns(ServoscopeWarning, match=r"in tz 0.85, ry nan"):
        check_observable(shares)
    check_observable(dict.fromkeys(DOFS, 0.5))
    with pytest.raises(DataSetError, match="no robot may be moved"):
        check_observable({**dict.fromkeys(DOFS, 1.0), "rz": 0.1})


def pipeline_of(split: Split) -> PosePipeline:
    """A pipeline that nothing is asked of but its split."""
    pipeline = PosePipeline()
    pipeline.split_ = split
    return pipeline


@pytest.mark.parametrize(
    "split",
    [
        Split(np.arange(10, 39), np.arange(39, 41), np.arange(10)),
        Split(np.arange(30), np.arange(30, 35), np.arange(34, 40)),
        Split(np.arange(30), np.arange(30, 35), np.arange(0)),
        Split(np.arange(-1, 30), np.arange(30, 35), np.arange(35, 40)),
    ],
)
def test_an_assessment_of_other_images_is_refused(split) -> None:
    groups = np.arange(len(split.learned) + len(split.test))
    found = Assessed(pipeline_of(split), groups, {})
    with pytest.raises(InvalidInputError, match="must be of these 40 images") as info:
        train(scattered(0, 40), assessment=found)
    assert "\n" not in str(info.value)


@pytest.mark.slow
def test_images_of_other_poses_are_refused_before_a_model_is_fitted(monkeypatch) -> None:
    def fit(*_, **__):
        raise AssertionError("a model is fitted")

    data = camera_data(((80, 0.5),))
    for kind in ("KeyframeModel", "FeatureModel"):
        monkeypatch.setattr(f"servoscope.positioning.training.{kind}.train", fit)
    with pytest.raises(AssertionError, match="a model is fitted"):
        train(data, n_jobs=1)
    other = np.random.default_rng(0).permutation(len(data))
    with pytest.raises(DataSetError, match=r"say nothing of their poses.* reads none of 6 others"):
        train(replace(data, T_world_cam=data.T_world_cam[other]), n_jobs=1)


@pytest.mark.parametrize("error", [0.0, 9.0])
def test_what_features_cannot_read_is_refused_only_if_a_keyframe_cannot_either(
    monkeypatch, error
) -> None:
    def fit(*_, **__):
        raise AssertionError("a model is fitted")

    names = {
        "_forecast_shares": lambda *_: {"tx": 1.0, "rz": 0.99},
        "fit_and_read": lambda *_: (None, SimpleNamespace(errors=np.full((6, 6), error))),
        "KeyframeModel.train": fit,
    }
    for name, stand_in in names.items():
        monkeypatch.setattr(f"servoscope.positioning.training.{name}", stand_in)
    with pytest.raises(
        DataSetError if error else AssertionError,
        match="say nothing of their poses" if error else "a model is fitted",
    ):
        train(camera_data(((80, 0.5),)), n_jobs=1)
