"""Which degrees of freedom a data set moves in."""

import json

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_data_set
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.dofs import check_dofs, mask_of, moving_dofs, parse_dofs
from servoscope.errors import DataSetError, InvalidInputError
from servoscope.poses import (
    DOFS,
    displacements_from_poses,
    poses_from_displacements,
)

SETS = {
    "scara": ("tx", "ty", "tz", "rz"),
    "gantry": ("tx", "ty", "rz"),
    "two axes": ("tx", "ty"),
    "mobile": ("tx", "tz", "ry"),
    "one axis": ("tz",),
    "turntable": ("rz",),
    "arm": DOFS,
}


def poses_of(dofs, *, share=1.0, position=0.0, rotation=0.0, pivot=PIVOT, n=30) -> np.ndarray:
    """Poses displaced in some dofs, with noise of the encoders, [m] and [rad], on all axes."""
    rng = np.random.default_rng(1)
    delta_p = share * rng.uniform(-1, 1, (n, 6)) * RANGES * mask_of(dofs)
    noise = rng.normal(size=(n, 6)) * np.repeat([position, rotation], 3)
    return poses_from_displacements(np.eye(4), delta_p, pivot) @ poses_from_displacements(
        np.eye(4), noise, 0.0
    )


def found(poses: np.ndarray, pivot: float = PIVOT) -> tuple[str, ...]:
    return moving_dofs(displacements_from_poses(np.eye(4), poses, pivot), pivot)


@pytest.mark.parametrize("dofs", SETS.values(), ids=SETS)
@pytest.mark.parametrize(
    ("position", "rotation"), [(0.0, 0.0), (1e-5, 2e-5), (1e-4, 5e-4), (2e-4, 1e-3)]
)
def test_the_noise_of_encoders_is_no_motion(dofs, position, rotation):
    assert found(poses_of(dofs, position=position, rotation=rotation)) == dofs


@pytest.mark.parametrize("dofs", [DOFS, ("tx", "ty", "rz")])
@pytest.mark.parametrize("share", [0.03, 0.2, 4.0])
def test_what_moves_little_moves_if_all_do(dofs, share):
    assert found(poses_of(dofs, share=share)) == dofs


def test_a_pan_tilt_unit_turns_about_its_camera():
    poses = poses_of(("rx", "ry"), position=5e-5, rotation=1e-4, pivot=0.0)
    assert found(poses, pivot=0.0) == ("rx", "ry")


def test_of_a_few_images_all_motion_counts():
    assert found(poses_of(DOFS, n=2)) == DOFS
    assert found(poses_of(DOFS, n=1)) == ()


def a_data_set(**fields) -> PoseImageSet:
    poses = poses_of(("tx", "ty"), position=1e-4, rotation=2e-4)
    images = np.random.default_rng(0).integers(0, 255, (len(poses), 8, 8), np.uint8)
    return PoseImageSet(images, poses, np.eye(4), images[0], pivot=PIVOT, **fields)


def test_a_data_set_and_its_parts_know_their_dofs():
    data = a_data_set()
    assert data.dofs == ("tx", "ty")
    assert data.subset(np.arange(12)).dofs == ("tx", "ty")
    np.testing.assert_array_equal(mask_of(data.dofs), mask_of(("tx", "ty")))
    assert planar_data_set(20).dofs == DOFS


def test_what_is_asked_for_overrides_what_is_found_and_is_stored(tmp_path):
    asked = a_data_set(asked_dofs=["rz", "tx"])
    assert asked.dofs == ("tx", "rz")
    assert asked.subset(np.arange(3)).dofs == ("tx", "rz")
    asked.save(tmp_path / "asked")
    assert PoseImageSet.load(tmp_path / "asked").dofs == ("tx", "rz")
    a_data_set().save(tmp_path / "found")
    assert "dofs" not in json.loads((tmp_path / "found" / "meta.json").read_text())
    assert PoseImageSet.load(tmp_path / "found").dofs == ("tx", "ty")


@pytest.mark.parametrize("dofs", [["tq"], 3, ["tx", "tx"], [1], "tx"])
def test_a_data_set_with_other_dofs_in_its_meta_is_refused(tmp_path, dofs):
    a_data_set(asked_dofs=("tx",)).save(tmp_path / "data")
    meta = tmp_path / "data" / "meta.json"
    meta.write_text(json.dumps(json.loads(meta.read_text()) | {"dofs": dofs}))
    with pytest.raises(DataSetError, match="does not hold together") as info:
        PoseImageSet.load(tmp_path / "data")
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("text", ["", "tx,tx", "tx;ty", "x", "tx,,ty"])
def test_dofs_that_cannot_be_are_refused_in_one_line(text):
    with pytest.raises(InvalidInputError, match="dofs must be some of tx, ty") as info:
        parse_dofs(text)
    assert "\n" not in str(info.value)


def test_dofs_are_in_their_order_whatever_they_are_given_in():
    assert parse_dofs(" rz,tx ") == check_dofs({"rz", "tx"}) == ("tx", "rz")


@pytest.mark.parametrize("robot", ["free", "arm"])
def test_an_acquisition_displaces_the_dofs_that_are_asked_for_alone(tmp_path, robot):
    config = AcquisitionConfig(
        n_images=12, image_size=16, part="textured_plane", robot=robot, dofs=("rz", "tx", "ty")
    )
    data = acquire(tmp_path / "cell", config, n_jobs=1)
    assert data.dofs == data.asked_dofs == ("tx", "ty", "rz")
    still = ~mask_of(data.dofs)
    assert np.abs(data.delta_p()[:, still]).max() < 1e-3
    assert (np.ptp(data.delta_p(), axis=0)[~still] > 0.5 * RANGES[~still]).all()
    np.testing.assert_array_equal(data.pivot_ranges > 0, ~still)


def test_the_displacements_of_a_subset_are_those_of_all_six():
    six, three = (AcquisitionConfig(n_images=5, dofs=dofs) for dofs in (DOFS, ("tx", "ty", "rz")))
    expected = six.displacements() * mask_of(three.dofs)
    np.testing.assert_array_equal(three.displacements(), expected)
    assert "dofs" not in six.plan()  # data sets of before go on
    assert three.plan()["dofs"] == ["tx", "ty", "rz"]
