"""A pipeline of features drives the robot, or says that it should not."""

from typing import ClassVar

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE, T_WORLD_REF, Cell
from planar_flange import camera_data
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import split_images
from servoscope.errors import DataSetError, InvalidInputError, ModelError, ServoscopeWarning
from servoscope.pipeline import PosePipeline, Recipe
from servoscope.poses import (
    DISPLAY_FACTORS,
    DOFS,
    displacements_from_poses,
    pose_error,
    poses_from_displacements,
)
from servoscope.positioning import FeatureModel, Positioner, PositioningModel, train
from servoscope.positioning.feature_model import ExpectedFeatures
from servoscope.positioning.training import Assessed
from servoscope.storage.model_folder import read_model, write_model

FAMILIES = ("intensity", "log_polar")


@pytest.fixture(scope="module")
def data() -> PoseImageSet:
    return camera_data(((160, 0.5),))


@pytest.fixture(scope="module")
def model(data) -> FeatureModel:
    return train(data, families=FAMILIES, regressor="kernel_ridge", n_jobs=1)


@pytest.fixture
def folder(model, tmp_path):
    model.save(tmp_path / "model")
    return tmp_path / "model"


def images_at(share: float, n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    delta_p = share * np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES
    return planar_images(delta_p, SIZE, seed=3), delta_p


def read(model, images) -> np.ndarray:
    found = np.stack([model.estimate(image).displacement for image in images])
    return displacements_from_poses(np.eye(4), found, PIVOT)


def test_what_it_reaches_on_new_images_is_what_it_says(model) -> None:
    images, delta_p = images_at(0.5, 60)
    errors = read(model, images) - delta_p
    rms = np.sqrt(np.mean(errors**2, axis=0)) * DISPLAY_FACTORS
    said = np.array(list(model.accuracy["rms"].values()))
    assert 0.6 < np.exp(np.mean(np.log(rms / said))) < 1.6
    assert model.accuracy["held_out"] == {"images": 40, "groups": 40, "share_right": 1.0}
    std = np.stack([model.estimate(image).std for image in images])
    assert 0.85 < np.mean(np.abs(errors) < 2 * std) <= 1


def test_features_that_were_computed_for_training_are_not_computed_again(
    data, model, monkeypatch
) -> None:
    seen, compute = [], PosePipeline.compute_features

    def counted(self, images):
        seen.append(len(images))
        return compute(self, images)

    monkeypatch.setattr(PosePipeline, "compute_features", counted)
    again = train(data, families=FAMILIES, regressor="kernel_ridge", n_jobs=1)
    assert sum(seen) <= 2 * 40  # of something else, to tell it from the part
    assert again.accuracy["rms"] == model.accuracy["rms"]


def test_its_recipes_are_of_the_families_that_were_named(model) -> None:
    dofs = model.accuracy["pipeline"]["dofs"]
    assert list(dofs) == list(model.dofs)
    assert {one["recipe"]["features"] for one in dofs.values()} <= set(FAMILIES)
    assert {one["recipe"]["regressor"] for one in dofs.values()} == {"kernel_ridge"}
    forecast = np.array(list(model.accuracy["forecast"].values()))
    assert 0.5 < np.median(np.array(list(model.accuracy["rms"].values())) / forecast) < 2


def test_at_the_reference_it_reads_no_displacement(model) -> None:
    assert np.abs(read(model, [model.reference_image])).max() < 1e-9


def test_it_brings_the_camera_back_about_as_near_as_it_believes(model) -> None:
    _, starts = images_at(0.45, 6, seed=7)
    for delta_p in starts:
        cell = Cell(delta_p)
        result = Positioner(model).run(cell, cell)
        assert result.status == "converged", result.message
        assert np.sqrt(np.mean((cell.delta_p / result.predicted_error) ** 2)) < 2.5
        assert pose_error(T_WORLD_REF, cell.pose)[0] < 0.2 * np.linalg.norm(delta_p)


@pytest.mark.parametrize("seed", range(20, 24))
def test_another_part_is_refused_before_a_move_is_made(model, seed) -> None:
    cell = Cell(0.2 * RANGES)
    foreign = planar_images(np.zeros((1, 6)), SIZE, seed)[0]
    cell.read = lambda: foreign
    result = Positioner(model).run(cell, cell)
    assert (result.status, result.moves) == ("abstained", 0), result.message


def test_a_saved_model_reads_the_same_and_is_saved_as_the_same_bytes(model, folder, tmp_path):
    again = PositioningModel.load(folder)
    image = images_at(0.3, 1)[0][0]
    one, other = model.estimate(image), again.estimate(image)
    np.testing.assert_array_equal(one.displacement, other.displacement)
    np.testing.assert_array_equal(one.std, other.std)
    assert one.novelty == other.novelty
    again.save(tmp_path / "again")
    for part in folder.iterdir():
        assert (tmp_path / "again" / part.name).read_bytes() == part.read_bytes()


@pytest.mark.parametrize(
    ("header", "arrays"),
    [
        ({"kind": "levels"}, {}),
        ({"reach": [0.1] * 5}, {}),
        ({"reach": [0.1] * 5 + [-0.1]}, {}),
        ({"dofs": ["tx"]}, {}),
        ({"image_size": [3, 3]}, {}),
        ({"accuracy": 3}, {}),
        ({}, {"view": np.zeros((SIZE, SIZE))}),
        ({}, {"view": np.zeros((3, 3), np.uint8)}),
        ({}, {"std_factor": np.zeros(6)}),
        ({}, {"std_factor": np.ones(5)}),
        ({}, {"expected/coefficients": np.zeros((3, 3))}),
        ({}, {"expected/limit": np.array(0.0)}),
        ({}, {"pipeline/ranges": np.zeros(2)}),
        ({}, {"other/array": np.zeros(2)}),
    ],
)
def test_models_that_do_not_hold_together_are_refused_in_a_line(folder, header, arrays) -> None:
    known, own = read_model(folder)
    write_model(folder, {**known, **header}, {**own, **arrays}, force=True)
    with pytest.raises(ModelError, match="is not a model for positioning") as caught:
        PositioningModel.load(folder)
    assert "\n" not in str(caught.value)


def test_every_number_of_processes_gives_the_same_model(model, data, tmp_path) -> None:
    model.save(tmp_path / "one")
    two = train(data, families=FAMILIES, regressor="kernel_ridge", n_jobs=2)
    two.save(tmp_path / "two")
    for part in (tmp_path / "one").iterdir():
        assert (tmp_path / "two" / part.name).read_bytes() == part.read_bytes()


class Corners:
    """A transformer of one's own: grey levels of 4 x 4 blocks."""

    def fit(self, images, targets):
        return self

    def transform(self, images):
        n, height, width = images.shape
        blocks = images.reshape(n, 4, height // 4, 4, width // 4)
        return blocks.mean(axis=(2, 4)).reshape(n, -1)


def test_features_of_one_s_own_are_trained_on_but_not_saved_without_a_name(data, tmp_path) -> None:
    own = train(data, families=[Corners()], regressor="kernel_ridge", n_jobs=1)
    assert np.isfinite(own.estimate(data.reference_image).displacement).all()
    with pytest.raises(InvalidInputError, match="entry points of a package"):
        own.save(tmp_path / "model")
    assert not (tmp_path / "model").exists()


def test_a_model_of_an_assessment_is_the_pipeline_that_was_assessed(data) -> None:
    recipe = Recipe("intensity", regressor="kernel_ridge")
    groups = np.arange(len(data))
    split = split_images(len(data))
    pipeline = PosePipeline(recipe).fit(data.images, data.delta_p(), split)
    pipeline.record_["pivot"] = data.pivot
    found = Assessed(pipeline, groups, {"loop": None, "note": "kept"})
    model = train(data, assessment=found)
    assert isinstance(model, FeatureModel)
    assert model.pipeline is pipeline
    assert model.accuracy["assessment"]["note"] == "kept"
    shown = np.array(list(pipeline.record_["measured"].values())) * DISPLAY_FACTORS
    np.testing.assert_allclose(list(model.accuracy["rms"].values()), shown, rtol=1e-6)


def test_where_no_keyframe_explains_the_view_features_are_trained_on(data, monkeypatch) -> None:
    def no_keyframe(*_, **__):
        raise DataSetError("No keyframe can be fitted.")

    monkeypatch.setattr("servoscope.positioning.training.KeyframeModel.train", no_keyframe)
    monkeypatch.setattr(
        "servoscope.positioning.feature_model.default_families", lambda: ["intensity"]
    )
    assert isinstance(train(data, n_jobs=1), FeatureModel)
    few = data.subset(np.arange(50))
    with pytest.raises(DataSetError, match="No keyframe"):
        train(few, n_jobs=1)
    with pytest.raises(DataSetError, match="at least 60 images"):
        train(few, families=FAMILIES, n_jobs=1)


def test_a_keyframe_of_no_use_is_refused_with_its_reason_if_no_features_can_be_had(
    data, monkeypatch
) -> None:
    class OfNoUse:
        accuracy: ClassVar = {"error_shares": dict.fromkeys(DOFS, 1.0)}

    def no_features(*_, **__):
        raise DataSetError("No features can be chosen.")

    training = "servoscope.positioning.training"
    monkeypatch.setattr(f"{training}.KeyframeModel.train", lambda *_, **__: OfNoUse())
    monkeypatch.setattr(f"{training}.FeatureModel.train", no_features)
    with pytest.raises(DataSetError, match="no robot may be moved by that"):
        train(data, n_jobs=1)


def test_a_keyframe_takes_no_families(data) -> None:
    with pytest.raises(InvalidInputError, match="no families"):
        train(data, method="keyframe", families=FAMILIES)


def test_features_that_no_displacement_explains_are_beyond_the_limit() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(3, 9))

    def drawn(n):
        shares = rng.uniform(-1, 1, (n, 3))
        return shares, shares @ A + 0.3 * shares**2 @ A + 0.05 * rng.normal(size=(n, 9))

    foreign = rng.uniform(-1, 1, (20, 3)), rng.normal(size=(20, 9))
    expected = ExpectedFeatures.fit(*drawn(200), drawn(100), foreign)
    own = expected.differences(*drawn(1000))
    assert np.sqrt(np.mean(own**2)) == pytest.approx(1, abs=0.1)
    assert np.mean(own < expected.limit) > 0.99
    assert expected.differences(*foreign).min() > expected.limit
    with pytest.warns(ServoscopeWarning, match="something else may be taken for this part"):
        ExpectedFeatures.fit(*drawn(200), foreign, drawn(10))


def test_robots_that_move_in_some_dofs_are_moved_in_these_alone() -> None:
    delta_p = np.random.default_rng(0).uniform(-0.4, 0.4, (120, 6)) * RANGES
    delta_p[:, 2:5] = 0
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), SIZE, seed=3)
    poses = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
    planar = PoseImageSet(images[:-1], poses, T_WORLD_REF, images[-1], pivot=PIVOT)
    model = train(planar, families=("intensity",), regressor="kernel_ridge", n_jobs=1)
    assert model.dofs == ("tx", "ty", "rz")
    estimate = model.estimate(images[0])
    found = displacements_from_poses(np.eye(4), estimate.displacement[None], PIVOT)[0]
    np.testing.assert_allclose(found[2:5], 0, atol=1e-12)
    assert np.isnan(estimate.std[2:5]).all()
    assert np.isfinite(model.estimate(images[1]).std[[0, 1, 5]]).all()
