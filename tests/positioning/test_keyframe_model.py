"""Thirty images of the widest range make a model that brings the camera back."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE, T_WORLD_REF, Cell
from planar_flange import T_FLANGE_CAM, FlangeCell
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import Split
from servoscope.errors import DataSetError, ModelError, ServoscopeWarning
from servoscope.keyframe import CameraModel, Keyframe
from servoscope.pipeline import PosePipeline, Recipe
from servoscope.poses import (
    DISPLAY_FACTORS,
    displacements_from_poses,
    pose_error,
    rigid_transform,
)
from servoscope.positioning import (
    Estimate,
    KeyframeModel,
    LoopSettings,
    Positioner,
    PositioningModel,
    train,
)
from servoscope.positioning.calibration import Calibration
from servoscope.positioning.guard import novelty_fault
from servoscope.positioning.keyframe_model import NOT_SEEN
from servoscope.positioning.training import Assessed
from servoscope.scene.disturbances import Disturbances
from servoscope.storage.model_folder import read_model, write_model
from small_keyframe import quick_fits

N_IMAGES = 30


def draw(n: int, seed: int, share: float = 1.0) -> np.ndarray:
    return share * np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES


@pytest.fixture(scope="module")
def data() -> PoseImageSet:
    """Images with the poses of a flange, whose mount nothing is said of, and an outlier."""
    cells = [FlangeCell(p, noise=1.0) for p in [*(0.6 * draw(N_IMAGES, 0)), 3 * RANGES]]
    return PoseImageSet(
        np.stack([cell.read() for cell in cells]),
        np.stack([cell.pose for cell in cells]),
        FlangeCell.T_WORLD_REF,
        FlangeCell(np.zeros(6)).read(),
        pivot=PIVOT,
    )


@pytest.fixture(scope="module")
def model(data) -> KeyframeModel:
    with pytest.warns(ServoscopeWarning, match=rf"^1 of {N_IMAGES + 1} images are not trained on"):
        return train(data, n_jobs=1)


@pytest.fixture
def quick():
    with quick_fits():
        yield


@pytest.mark.slow
def test_few_images_make_a_keyframe_that_reads_those_held_out(model) -> None:
    assert isinstance(model, KeyframeModel)
    assert max(model.accuracy["error_shares"].values()) < 0.2
    assert model.accuracy["n_images"] == N_IMAGES


@pytest.mark.slow
def test_one_outlier_is_neither_learned_from_nor_the_range(model) -> None:
    np.testing.assert_array_less(model.reach, 0.75 * RANGES)
    np.testing.assert_array_less(0.4 * RANGES, model.reach)


@pytest.mark.slow
def test_the_limit_of_similarity_lies_between_own_and_turned_images(model) -> None:
    accuracy = model.accuracy
    assert accuracy["chance_similarity"] < accuracy["least_similarity"] < accuracy["similarity"]


@pytest.mark.slow
def test_the_camera_arrives_from_the_range_with_its_mount_unknown(model) -> None:
    for p in 0.6 * draw(6, 7):
        cell = FlangeCell(p, noise=1.0)
        result = Positioner(model).run(cell, cell)
        distance, angle = pose_error(T_WORLD_REF, cell.pose @ T_FLANGE_CAM)
        assert result.status == "converged", result.message
        assert distance < 1e-3
        assert angle < np.radians(0.1)
        assert result.moves <= 6
        assert is_as_believed(cell, result)


@pytest.mark.slow
def test_first_guesses_bear_covering_noise_and_another_light(model) -> None:
    rng = np.random.default_rng(5)
    starts = 0.4 * draw(20, 11)
    truth = np.concatenate(
        [
            displacements_from_poses(FlangeCell.T_WORLD_REF, FlangeCell(p).pose[None], model.pivot)
            for p in starts
        ]
    )
    for disturbances in (
        Disturbances.only(covering=0.2),
        Disturbances.only(light=0.3),
        Disturbances.only(noise=10.0, gain=0.8),
    ):
        images = [disturbances.disturb(FlangeCell(p, noise=1.0).read(), rng) for p in starts]
        guesses = [
            displacements_from_poses(np.eye(4), model.first_guess(image), model.pivot).mean(axis=0)
            for image in images
        ]
        errors = np.array(guesses) - truth
        assert (errors.std(axis=0) / truth.std(axis=0)).mean() < 0.8


def cover(image: np.ndarray, seed: int) -> np.ndarray:
    return Disturbances.only(covering=0.2).disturb(image, np.random.default_rng(seed))


@pytest.mark.slow
def test_the_camera_arrives_with_a_fifth_of_the_view_covered(model) -> None:
    for k, p in enumerate(0.6 * draw(5, 8)):
        cell = FlangeCell(p, noise=1.0)
        read = cell.read
        cell.read = lambda k=k, read=read: cover(read(), k)
        result = Positioner(model).run(cell, cell)
        distance, angle = pose_error(T_WORLD_REF, cell.pose @ T_FLANGE_CAM)
        assert result.status in ("converged", "limited"), result.message
        assert distance < 2e-3
        assert angle < np.radians(0.2)


@pytest.mark.slow
def test_another_part_is_refused_before_a_move_is_made(model) -> None:
    for seed in range(20, 25):
        cell = Cell(0.3 * RANGES)
        foreign = planar_images(draw(1, seed, 0.5), SIZE, seed)[0]
        cell.read = lambda foreign=foreign: foreign
        result = Positioner(model).run(cell, cell)
        assert (result.status, result.moves) == ("abstained", 0)


class DisturbedCamera:
    """Sees what a cell sees through disturbances."""

    def __init__(self, cell: Cell, disturbances: Disturbances) -> None:
        self.cell, self.disturbances = cell, disturbances
        self.rng = np.random.default_rng(0)

    def read(self) -> np.ndarray:
        return self.disturbances.disturb(self.cell.read(), self.rng)


@pytest.mark.slow
@pytest.mark.parametrize("disturbances", [{"gain": 0.8}, {"noise": 2.0}])
def test_in_disturbed_images_it_arrives(model, disturbances) -> None:
    for p in 0.4 * draw(4, 7):
        cell = FlangeCell(p)
        camera = DisturbedCamera(cell, Disturbances.only(**disturbances))
        result = Positioner(model).run(cell, camera)
        distance, angle = pose_error(T_WORLD_REF, cell.pose @ T_FLANGE_CAM)
        assert result.status == "converged"
        assert distance < 4e-3
        assert angle < np.radians(0.4)


@pytest.mark.slow
def test_in_noise_that_hides_the_reference_it_does_not_claim_to_have_arrived(model) -> None:
    for p in 0.4 * draw(4, 7):
        cell = FlangeCell(p)
        result = Positioner(model).run(cell, DisturbedCamera(cell, Disturbances.only(noise=25.0)))
        assert result.status != "converged" or is_as_believed(cell, result)


def is_as_believed(cell, result) -> bool:
    """Whether a flange is as far from its reference as is believed, in each dof."""
    delta_p = displacements_from_poses(FlangeCell.T_WORLD_REF, cell.pose[None], PIVOT)[0]
    return bool(np.sqrt(np.mean((delta_p / result.predicted_error) ** 2)) < 3)


@pytest.mark.slow
def test_given_the_poses_of_another_frame_than_that_of_training_it_is_stopped_or_fails(model):
    """What the mount test would be if the mount did not matter anyway."""
    for p in 0.5 * draw(4, 7):
        cell = Cell(p)
        moves = Positioner(model).run(cell, cell).moves
        distance, angle = pose_error(T_WORLD_REF, cell.pose)
        assert moves > 6 or distance > 1e-3 or angle > np.radians(0.1)


def turned(image: np.ndarray, degrees: float) -> np.ndarray:
    turn = cv2.getRotationMatrix2D(((SIZE - 1) / 2, (SIZE - 1) / 2), degrees, 1)
    return cv2.warpAffine(image, turn, (SIZE, SIZE), borderMode=cv2.BORDER_REFLECT)


@pytest.mark.slow
def test_images_of_the_part_are_recognised_and_turned_ones_are_not(model) -> None:
    own = [FlangeCell(p, noise=2.0).read() for p in 0.6 * draw(12, 7)]
    others = [turned(image, degrees) for image in own[:6] for degrees in (60, 180)]

    def n_refused(images) -> int:
        faults = [novelty_fault(model.estimate(image), LoopSettings()) for image in images]
        return sum(fault is not None for fault in faults)

    assert n_refused(own) == 0
    assert n_refused(others) >= len(others) - 1


class Overexposed(FlangeCell):
    """A cell whose camera clips what is bright."""

    gain = 1.0

    def read(self) -> np.ndarray:
        return np.clip(self.gain * super().read(), 0, 255).astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [1.3, 1.5, 1.8, 2.2])
def test_an_overexposed_camera_does_not_claim_to_have_arrived_where_it_has_not(model, gain) -> None:
    for p in 0.4 * draw(3, 7):
        cell = Overexposed(p, noise=1.0)
        cell.gain = gain
        result = Positioner(model).run(cell, cell)
        assert result.status != "converged" or is_as_believed(cell, result)


@pytest.mark.slow
def test_the_reference_image_has_arrived_whatever_the_estimate(model, monkeypatch) -> None:
    away = Estimate(
        rigid_transform(np.eye(3), [0.042, 0, 0]), RANGES, 0.5, "coarse", is_finest=False
    )
    monkeypatch.setattr(KeyframeModel, "estimate", lambda self, image, previous=None: away)
    cell = FlangeCell(np.zeros(6), noise=2.0)
    result = Positioner(model).run(cell, cell)
    assert (result.status, result.moves) == ("converged", 0)
    assert "equals the reference" in result.message


@pytest.mark.slow
def test_tolerances_of_single_dofs_are_met_or_said_to_be_missed(model) -> None:
    cell = FlangeCell(0.4 * draw(1, 7)[0])
    settings = LoopSettings(tolerances={"tz": 0.5, "rz": 0.05})
    result = Positioner(model, settings).run(cell, cell)
    assert result.status == "converged"
    delta_p = displacements_from_poses(FlangeCell.T_WORLD_REF, cell.pose[None], PIVOT)[0]
    assert abs(delta_p[2]) < 0.5e-3
    assert abs(delta_p[5]) < np.radians(0.05)
    noisy = FlangeCell(0.4 * draw(1, 7)[0], noise=1.0)
    strict = LoopSettings(tolerances={"tz": 1e-4})
    result = Positioner(model, strict).run(noisy, noisy)
    assert result.status == "limited"
    assert "of tz, 0.0001 mm asked for" in result.message


@pytest.mark.slow
def test_a_saved_model_reads_the_same(model, tmp_path) -> None:
    model.save(tmp_path / "model")
    loaded = PositioningModel.load(tmp_path / "model")
    image = FlangeCell(0.3 * RANGES, noise=1.0).read()
    one, other = model.estimate(image), loaded.estimate(image)
    np.testing.assert_array_equal(one.displacement, other.displacement)
    np.testing.assert_array_equal(one.std, other.std)
    header, arrays = read_model(tmp_path / "model")
    for broken in ({**header, "reach": [1.0]}, {**header, "image_size": [3, 3]}):
        write_model(tmp_path / "model", broken, arrays, force=True)
        with pytest.raises(ModelError):
            PositioningModel.load(tmp_path / "model")
    del arrays["keyframe/mount"]
    write_model(tmp_path / "model", header, arrays, force=True)
    with pytest.raises(ModelError):
        PositioningModel.load(tmp_path / "model")


@pytest.mark.slow
def test_a_view_that_informs_rotations_alone_ends_limited_and_not_converged(model) -> None:
    far = np.full_like(model.keyframe.inverse_depth, 1e-6)
    blind = replace(model, keyframe=replace(model.keyframe, inverse_depth=far), first_guess=None)
    for p in 0.2 * draw(3, 9):
        cell = FlangeCell(p, noise=1.0)
        result = Positioner(blind).run(cell, cell)
        assert result.status != "converged", result.message


@pytest.mark.slow
def test_pixels_that_no_image_held_out_shows_are_saved_as_not_seen(model, tmp_path) -> None:
    unseen = np.full_like(model.residual, NOT_SEEN)
    replace(model, residual=unseen).save(tmp_path / "model")
    loaded = PositioningModel.load(tmp_path / "model")
    np.testing.assert_array_equal(loaded.residual, unseen)
    assert (model.residual[model.residual != NOT_SEEN] >= 0).all()


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_images_of_other_poses_are_refused_before_a_model_is_made(data, monkeypatch) -> None:
    few = data.subset(np.arange(16))
    shuffled = replace(few, images=few.images[np.random.default_rng(0).permutation(16)])
    known = Calibration(camera=CameraModel(1.4, 0.5 / SIZE, 0.5 / SIZE))
    monkeypatch.setattr(KeyframeModel, "of_readings", lambda *_: pytest.fail("a model is made"))
    with pytest.raises(DataSetError, match="no robot may be moved"):
        train(shuffled, calibration=known, n_jobs=1)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_its_accuracy_is_that_of_the_test_images_of_an_assessment(data, monkeypatch) -> None:
    given = {}

    def train_model(data, held_out, **_):
        given.update(data=data, held_out=held_out)
        raise DataSetError("Enough is known.")

    monkeypatch.setattr(KeyframeModel, "train", train_model)
    groups = np.arange(len(data)) // 2
    split = Split(np.arange(2, 18), np.arange(18, 24), np.arange(24, 30))
    recipe = Recipe("intensity", regressor="kernel_ridge")
    pipeline = PosePipeline(recipe).fit(data.images, data.delta_p(), split)
    with (
        pytest.warns(ServoscopeWarning, match="not trained on"),
        pytest.raises(DataSetError, match="Enough is known"),
    ):
        train(data, assessment=Assessed(pipeline, groups, {"loop": {}}))
    keyframe = Keyframe.fit(
        data.images[2:24], data.T_world_cam[2:24], data.reference_image, data.T_world_ref,
        pivot=data.pivot,
    )  # fmt: skip
    errors = np.stack([keyframe.align(image).delta_p for image in data.images[split.test]])
    errors -= data.delta_p()[split.test]
    assert (np.abs(errors) < 0.25 * data.ranges()).all()
    fitted = data.subset(np.arange(2, 24))
    found = KeyframeModel.of_readings(keyframe, data, fitted, *given["held_out"]).accuracy
    rms = np.sqrt(np.mean(errors**2, axis=0)) * DISPLAY_FACTORS
    np.testing.assert_allclose(list(found["rms"].values()), rms, rtol=1e-6)
    assert found["held_out"] == {"images": 6, "groups": 3, "share_right": 1.0}
    assert len(given["data"]) == N_IMAGES  # the keyframe itself is of all but the outlier


def test_too_few_images_are_refused_in_words_that_hold_without_the_simulator(data) -> None:
    few = replace(data, images=data.images[:9], T_world_cam=data.T_world_cam[:9], names=())
    with pytest.raises(DataSetError, match="at least 15 images, got 9") as caught:
        train(few)
    assert "schedule" not in str(caught.value)
