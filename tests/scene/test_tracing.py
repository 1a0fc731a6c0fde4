"""Shadows are those of a ray from every pixel to every lamp, whichever process made the cell."""

from copy import deepcopy
from functools import cache

import numpy as np
import pytest

from servoscope.poses import poses_from_displacements
from servoscope.scene import tracing
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import DARK, IN_PART, geometry_of
from servoscope.scene.render import render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane
from servoscope.scene.tracing import Cell, cell_of, take_over

SCENE = Scene(image_size=128)
DISPLACEMENTS = [[0.02, -0.01, 0.02, 0.2, -0.1, 0.2], [-0.02, 0.02, -0.02, -0.2, 0.2, 3.0]]
POSES = poses_from_displacements(T_WORLD_REF, np.array(DISPLACEMENTS), 0.55)


@pytest.fixture
def cell() -> Cell:
    """The cell of the scene."""
    cell = cell_of(SCENE)
    assert cell is not None
    return cell


@pytest.fixture
def empty_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing was made or taken over before, and nothing stays."""
    monkeypatch.setattr(tracing, "_TAKEN_OVER", {})
    monkeypatch.setattr(tracing, "_cell", cache(tracing._cell.__wrapped__))


def test_shadows_are_those_of_all_shadow_rays(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    images = np.stack([render_radiance(SCENE, pose) for pose in POSES])
    mesh = geometry_of(CylinderHead()).mesh
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    ways = SCENE.lighting.lamp_rows()[:, None, :3] - a
    is_turned_to = (ways * np.cross(b - a, c - a)).sum(axis=-1).T > 0
    unknown = np.where(is_turned_to, IN_PART, DARK).astype(np.uint8)
    doubtful = cell._replace(part=cell.part._replace(states=unknown))
    tree = tracing._cell(SCENE.part, SCENE.lighting)[1]
    monkeypatch.setattr(tracing, "_cell", lambda *_: (doubtful, tree))
    by_rays = np.stack([render_radiance(SCENE, pose) for pose in POSES])
    assert np.mean(cell.part.states == IN_PART) < 0.5 < np.mean(unknown == IN_PART)
    assert np.mean(np.abs(images - by_rays) > 1e-5) < 5e-4


def test_a_cell_that_another_process_made_gives_the_same_images(
    cell: Cell, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    images = [render_radiance(SCENE, pose) for pose in POSES]
    request.getfixturevalue("empty_process")
    handed = deepcopy(cell)
    for array in (handed.part.vertices, handed.part.grain, handed.table.radiance):
        array.flags.writeable = False  # as what processes share is
    monkeypatch.setattr(CylinderHead, "mesh", lambda _: pytest.fail("the part was built again"))
    monkeypatch.setattr(tracing, "geometry_of", lambda _: pytest.fail("the part was built again"))
    n_compiled = len(tracing.shade.signatures)
    take_over(SCENE, handed)
    for pose, image in zip(POSES, images, strict=True):
        np.testing.assert_array_equal(render_radiance(SCENE, pose), image)
    assert len(tracing.shade.signatures) == n_compiled


def test_a_plane_has_no_cell_to_hand_on(empty_process: None) -> None:
    scene = Scene(part=TexturedPlane(), image_size=16)
    assert cell_of(scene) is None
    take_over(scene, None)
    assert tracing._TAKEN_OVER == {}
