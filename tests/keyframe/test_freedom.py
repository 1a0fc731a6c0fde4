"""Keyframes of robots that have some degrees of freedom alone."""

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.keyframe import CameraModel, Keyframe, next_displacements
from servoscope.keyframe.motion import Freedom, exponential
from servoscope.poses import (
    DOFS,
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
)

PLANAR, SCARA, MOBILE, PAN_TILT = (
    ("tx", "ty", "rz"),
    ("tx", "ty", "tz", "rz"),
    ("tx", "tz", "ry"),
    ("rx", "ry"),
)
CAMERA = CameraModel(1.4, 0.5 / SIZE, 0.5 / SIZE)
REFERENCE = planar_images(np.zeros((1, 6)), SIZE, seed=3)[0]


def images_and_poses(dofs, n: int, seed: int, pivot: float = PIVOT, share: float = 0.6):
    """Images of the plane at displacements in some dofs about a pivot, and these."""
    delta_p = share * np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES * mask_of(dofs)
    poses = poses_from_displacements(np.eye(4), delta_p, pivot)
    about_plane = displacements_from_poses(np.eye(4), poses, PIVOT)
    return planar_images(about_plane, SIZE, seed=3), poses, delta_p


def fitted(dofs, n: int = 12, pivot: float = PIVOT) -> Keyframe:
    """With the mount roughly and the lens exactly known, so that the search is short."""
    images, poses, _ = images_and_poses(dofs, n, seed=0, pivot=pivot)
    return Keyframe.fit(
        images, poses, REFERENCE, np.eye(4), pivot=pivot, camera=CAMERA, mount=np.eye(4), dofs=dofs
    )


@pytest.fixture(scope="module")
def planar() -> Keyframe:
    return fitted(PLANAR)


def worst_errors(keyframe: Keyframe, pivot: float = PIVOT) -> np.ndarray:
    """Largest error of each dof in images that were not fitted, [mm] and [deg]."""
    images, _, delta_p = images_and_poses(keyframe.dofs, 5, seed=1, pivot=pivot, share=0.4)
    found = np.array([keyframe.align(image).delta_p for image in images])
    return np.abs(found - delta_p).max(axis=0) * [1e3, 1e3, 1e3, *(np.degrees(1.0),) * 3]


@pytest.mark.parametrize("dofs", [SCARA, MOBILE], ids=["scara", "mobile platform"])
def test_a_keyframe_of_few_dofs_reads_these(dofs):
    keyframe = fitted(dofs)
    errors = worst_errors(keyframe)
    assert errors[:3].max() < 1.0
    assert errors[3:].max() < 0.25
    assert (errors[~mask_of(dofs)] == 0).all()


def test_a_planar_keyframe_reads_nothing_else(planar):
    errors = worst_errors(planar)
    assert errors[:3].max() < 0.5
    assert errors[3:].max() < 0.05
    images, _, _ = images_and_poses(PLANAR, 2, seed=2)
    for image in images:
        found = planar.align(image)
        assert (found.delta_p[2:5] == 0).all()
        assert (found.std[2:5] == 0).all()
        assert (found.std[[0, 1, 5]] > 0).all()
        np.testing.assert_allclose(found.displacement[2], [0, 0, 1, 0], atol=1e-12)


def test_a_pan_tilt_unit_reads_rotations_without_any_depth():
    keyframe = fitted(PAN_TILT, pivot=0.0)
    assert not keyframe.observable["depth"]
    errors = worst_errors(keyframe, pivot=0.0)
    assert errors[3:].max() < 0.1
    assert (errors[:3] == 0).all()


def test_the_limit_is_that_of_the_dofs_that_are_read(planar):
    limit, full = planar.limit(), Keyframe(**vars_of(planar, dofs=DOFS)).limit()
    assert (limit.std[2:5] == 0).all()
    ratio = limit.std[[0, 1, 5]] / full.std[[0, 1, 5]]
    assert (ratio > 0).all()
    assert (ratio <= 1 + 1e-6).all()  # what is known cannot make the rest less sure


def vars_of(keyframe: Keyframe, **changes) -> dict:
    names = keyframe.to_arrays()
    return {name: getattr(keyframe, name) for name in names} | changes


def test_arrays_give_the_dofs_back_and_those_of_before_are_of_all_six(planar):
    arrays = planar.to_arrays()
    assert Keyframe.from_arrays(arrays).dofs == PLANAR
    del arrays["dofs"]
    assert Keyframe.from_arrays(arrays).dofs == DOFS


@pytest.mark.parametrize("dofs", [np.zeros(6, bool), np.ones(5, bool), np.ones(6)])
def test_arrays_of_other_dofs_are_refused(planar, dofs):
    with pytest.raises(InvalidInputError, match="dofs has another type"):
        Keyframe.from_arrays(planar.to_arrays() | {"dofs": dofs})


def test_the_next_images_are_displaced_in_the_dofs_that_are_read(planar):
    chosen = next_displacements(planar, 3, RANGES * mask_of(PLANAR))
    assert (chosen[:, 2:5] == 0).all()
    assert (np.abs(chosen[:, [0, 1, 5]]) > 0).all()
    with pytest.raises(InvalidInputError, match="ranges must be"):
        next_displacements(planar, 3, RANGES * mask_of(("tx",)))


@pytest.mark.parametrize("dofs", [PLANAR, SCARA, MOBILE, PAN_TILT, ("tz",)])
def test_twists_displace_in_one_dof_each(dofs):
    rng = np.random.default_rng(3)
    mount = exponential(rng.uniform(-0.3, 0.3, 6))
    freedom = Freedom(mount, 0.4, dofs)
    T = freedom.nearest(exponential(rng.uniform(-0.2, 0.2, 6)))
    np.testing.assert_allclose(freedom.nearest(T), T, atol=1e-12)
    every = Freedom(mount, 0.4)
    step = 1e-6
    for dof, twist in zip(dofs, freedom.twists(T).T, strict=True):
        moved = every.delta_p(exponential(step * twist) @ T) - every.delta_p(T)
        np.testing.assert_allclose(moved / step, mask_of([dof]), atol=1e-4)


def test_what_a_subset_displaces_is_undone_in_the_subset():
    freedom = Freedom(exponential([0.1, 0.0, 0.2, 0.3, 0.2, 1.0]), 0.4, PLANAR)
    T = exponential([0.02, 0.03, -0.02, 0.1, -0.2, 0.4])
    D = freedom.displacement(T)
    back = inverse_transform(D)
    np.testing.assert_allclose(back[2], [0, 0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(D[2], [0, 0, 1, 0], atol=1e-12)
