"""The depth buffer finds the faces that Embree's rays meet first."""

import numpy as np
import pytest

from servoscope.poses import poses_from_displacements, rigid_transform
from servoscope.scene.camera import Lens
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import Geometry, geometry_of
from servoscope.scene.scene import T_WORLD_REF
from servoscope.scene.visibility import Hits, RayGrid, first_hits, outlines, ray_grid

N = 96
EVERYWHERE = np.arange(N * N, dtype=np.int32)


@pytest.fixture(scope="module")
def geometry() -> Geometry:
    """The part, ready for Embree's rays."""
    return geometry_of(CylinderHead())


def _seen(geometry: Geometry, pose: np.ndarray, grid: RayGrid, lens: Lens) -> Hits:
    mesh = geometry.mesh
    found = outlines(mesh.vertices, mesh.triangles, pose.astype(np.float32), lens, N)
    return first_hits(found, grid, EVERYWHERE)


def _met(geometry: Geometry, pose: np.ndarray, grid: RayGrid) -> dict[str, np.ndarray]:
    """What Embree says."""
    rays = np.stack([grid.x, grid.y, np.ones_like(grid.x)], axis=-1).reshape(-1, 3)
    ways = (rays @ pose[:3, :3].T).astype(np.float32)
    centres = np.tile(pose[:3, 3].astype(np.float32), (len(ways), 1))
    return geometry.tree.run(centres, ways, output=True)


def _points(geometry: Geometry, face: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    a, b, c = geometry.mesh.vertices[geometry.mesh.triangles[face]].astype(float).transpose(1, 0, 2)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a)


@pytest.mark.parametrize(
    ("lens", "offset"),
    [
        (Lens(), (0.0, 0.0)),
        (Lens(), (0.5, 0.0)),
        (Lens(), (0.0, 0.5)),
        (Lens(focal_length=0.6, distortion=(-0.2, 0.06)), (0.0, 0.0)),
        (Lens(focal_length=4.0, principal_point=(0.3, 0.8), distortion=(0.8, 2.0)), (0.5, 0.5)),
    ],
)
def test_every_ray_meets_what_embree_meets(
    geometry: Geometry, lens: Lens, offset: tuple[float, float], rng: np.random.Generator
) -> None:
    displacements = rng.uniform(-1, 1, (6, 6)) * [0.05, 0.05, 0.1, 0.4, 0.4, 3.0]
    grid = ray_grid(lens, N, *offset)
    for pose in poses_from_displacements(T_WORLD_REF, displacements, 0.55):
        hits, met = _seen(geometry, pose, grid, lens), _met(geometry, pose, grid)
        same = hits.face == met["primID"]
        assert (~same).sum() <= 2  # rays that pass within a rounding of an edge
        on = same & (hits.face >= 0)
        assert on.sum() > 300
        points = _points(geometry, hits.face[on], hits.u[on], hits.v[on])
        x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
        np.testing.assert_allclose(x / z, grid.x.ravel()[on], atol=2e-6)
        np.testing.assert_allclose(y / z, grid.y.ravel()[on], atol=2e-6)


@pytest.mark.parametrize("height", [-0.2, -0.05, 0.001, 0.02])
@pytest.mark.parametrize("turn", [0.0, 1.6])
def test_cameras_within_the_part_below_it_and_near_it_see_what_embree_meets(
    geometry: Geometry, height: float, turn: float
) -> None:
    for tilt in (np.diag([1.0, -1.0, -1.0]), np.eye(3)):
        about_x = [[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]]
        pose = rigid_transform(tilt @ about_x, [0.0131, 0.0117, height])
        grid = ray_grid(Lens(), N, 0.0, 0.0)
        hits, met = _seen(geometry, pose, grid, Lens()), _met(geometry, pose, grid)
        assert np.mean(hits.face == met["primID"]) > 0.9995


def test_some_pixels_see_what_they_see_among_all(geometry: Geometry) -> None:
    mesh, grid = geometry.mesh, ray_grid(Lens(), N, 0.0, 0.0)
    found = outlines(mesh.vertices, mesh.triangles, T_WORLD_REF.astype(np.float32), Lens(), N)
    whole = first_hits(found, grid, EVERYWHERE)
    some = np.array([0, 1, N - 1, N, 37 * N + 40, 37 * N + 43, 50 * N + 48, N * N - 1], np.int32)
    few = first_hits(found, grid, some)
    hit = few.face >= 0
    assert 2 < hit.sum() < len(some)
    np.testing.assert_array_equal(few.face, whole.face[some])
    np.testing.assert_array_equal(few.u[hit], whole.u[some][hit])
    assert not len(first_hits(found, grid, EVERYWHERE[:0]).face)


def test_rays_of_the_grid_are_those_of_the_lens() -> None:
    for right, down in ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5)):
        grid = ray_grid(Lens(), N, right, down)
        pixels = np.stack(np.meshgrid(np.arange(N) + right, np.arange(N) + down), axis=-1)
        seen = Lens().rays(pixels, N)
        np.testing.assert_allclose(grid.x, seen[..., 0], atol=1e-5)
        np.testing.assert_allclose(grid.y, seen[..., 1], atol=1e-5)
