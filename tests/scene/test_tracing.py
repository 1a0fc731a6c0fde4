"""Shadows are those of a ray from every pixel to every lamp."""

import numpy as np
import pytest

from servoscope.poses import poses_from_displacements
from servoscope.scene import tracing
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import DARK, IN_PART, geometry_of
from servoscope.scene.render import render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene

SCENE = Scene(image_size=128)
DISPLACEMENTS = [[0.02, -0.01, 0.02, 0.2, -0.1, 0.2], [-0.02, 0.02, -0.02, -0.2, 0.2, 3.0]]
POSES = poses_from_displacements(T_WORLD_REF, np.array(DISPLACEMENTS), 0.55)


def test_shadows_are_those_of_all_shadow_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = tracing._cell(SCENE.part, SCENE.lighting)
    images = np.stack([render_radiance(SCENE, pose) for pose in POSES])
    mesh = geometry_of(CylinderHead()).mesh
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    ways = SCENE.lighting.lamp_rows()[:, None, :3] - a
    is_turned_to = (ways * np.cross(b - a, c - a)).sum(axis=-1).T > 0
    unknown = np.where(is_turned_to, IN_PART, DARK).astype(np.uint8)
    doubtful = cell._replace(part=cell.part._replace(states=unknown))
    monkeypatch.setattr(tracing, "_cell", lambda *_: doubtful)
    by_rays = np.stack([render_radiance(SCENE, pose) for pose in POSES])
    assert np.mean(cell.part.states == IN_PART) < 0.5 < np.mean(unknown == IN_PART)
    assert np.mean(np.abs(images - by_rays) > 1e-5) < 5e-4
