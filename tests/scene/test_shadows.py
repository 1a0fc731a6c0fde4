"""What is said of faces under a lamp once holds for every point on them."""

import numpy as np

from servoscope.scene.geometry import geometry_of
from servoscope.scene.lights import Lighting
from servoscope.scene.part import CylinderHead
from servoscope.scene.shadows import DARK, IN_PART, LIT, face_states


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
