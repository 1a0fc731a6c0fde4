"""Points see the share of sky, table and lamps that counting rays gives."""

import sys

import numpy as np
import pytest

from servoscope.errors import ServoscopeError
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import DARK, IN_PART, LIT, face_states, geometry_of, share_of_sky
from servoscope.scene.lighting import Lighting

BOUNCE = 0.5  # radiance of the table relative to the sky's


@pytest.mark.parametrize("tilt_deg", [0, 30, 60, 90, 120, 150, 180])
def test_a_free_surface_sees_sky_and_table_as_the_closed_form_says(tilt_deg: float) -> None:
    tilt = np.radians(tilt_deg)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    up = np.full_like(turn, np.cos(tilt))
    normals = np.c_[np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), up].astype("f4")
    far_from_the_part = np.full((24, 3), 50.0, np.float32)
    share = share_of_sky(geometry_of(CylinderHead()).tree, far_from_the_part, normals)
    expected = (1 + np.cos(tilt)) / 2 + BOUNCE * (1 - np.cos(tilt)) / 2
    np.testing.assert_allclose(share, expected, atol=0.03)


def test_walls_of_the_part_see_what_many_random_rays_see(rng: np.random.Generator) -> None:
    geometry = geometry_of(CylinderHead())
    mesh = geometry.mesh
    walls = rng.choice(np.flatnonzero(np.abs(mesh.normals[:, 2]) < 0.05), 200, replace=False)
    counted = np.empty(len(walls))
    for i, (point, normal) in enumerate(
        zip(mesh.vertices[walls], mesh.normals[walls], strict=True)
    ):
        ball = rng.standard_normal((2_000, 3))
        ways = normal + ball / np.linalg.norm(ball, axis=1, keepdims=True)  # by the cosine law
        origins = np.tile(point + np.float32(2e-4) * normal, (len(ways), 1))
        free = geometry.tree.run(origins, ways.astype(np.float32), query="OCCLUDED") < 0
        counted[i] = np.mean(free * np.where(ways[:, 2] > 0, 1, BOUNCE))
    sky = geometry.sky[walls]
    assert np.ptp(counted) > 0.5
    assert sky.mean() == pytest.approx(counted.mean(), abs=0.01)
    np.testing.assert_allclose(sky, counted, atol=0.12)


def test_points_of_lit_faces_see_the_lamp_and_those_of_dark_faces_do_not(
    rng: np.random.Generator,
) -> None:
    geometry, lamps = geometry_of(CylinderHead()), Lighting().lamp_rows()
    states = face_states(geometry, lamps)
    corners = geometry.mesh.vertices[geometry.mesh.triangles].astype(float)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    faces = rng.choice(len(area), 20_000, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), len(faces))
    points = np.einsum("ij,ijk->ik", weights, corners[faces])
    points += 1e-4 * (across / area[:, None])[faces]
    for lamp, state in zip(lamps, states[faces].T, strict=True):
        ways = (lamp[:3] - points).astype(np.float32)
        blocked = geometry.tree.run(points.astype(np.float32), ways, dists=1.0, query="OCCLUDED")
        lit = (blocked < 0) & (np.einsum("ij,ij->i", ways, across[faces]) > 0)
        assert lit[state == LIT].mean() > 0.998
        assert lit[state == DARK].mean() < 0.002
        assert 0.1 < lit[state == IN_PART].mean() < 0.9
        assert np.mean(state == IN_PART) < 0.5


def test_faces_turned_away_from_a_lamp_are_dark_and_the_deck_is_lit() -> None:
    geometry, lamps = geometry_of(CylinderHead()), Lighting().lamp_rows()
    states = face_states(geometry, lamps)
    corners = geometry.mesh.vertices[geometry.mesh.triangles].astype(float)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    deck = (corners[..., 2] > -1e-6).all(axis=1) & (area > 1e-7)
    assert (states[deck] == LIT).all()
    for k, lamp in enumerate(lamps):
        towards = np.einsum("ij,ij->i", across / area[:, None], lamp[:3] - corners[:, 0])
        assert (states[(towards < -0.05) & (area > 1e-7), k] == DARK).all()


def test_where_there_is_no_ray_caster_one_line_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "embreex.mesh_construction", None)
    with pytest.raises(ServoscopeError, match=r"needs embreex.*--part textured_plane"):
        geometry_of(CylinderHead(variant=7))
