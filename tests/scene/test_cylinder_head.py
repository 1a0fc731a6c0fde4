"""The cylinder head is a closed body of the stated size, in the grey levels of the paper."""

from collections import Counter

import numpy as np
import pytest
from manifold3d import Error
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import rigid_transform
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import geometry_of
from servoscope.scene.mesh import BORED, CAST, MACHINED, MATERIALS, SOOT, VALVE, Mesh
from servoscope.scene.render import render
from servoscope.scene.scene import STANDOFF, T_WORLD_REF, Scene


def test_every_edge_has_one_triangle_on_either_side(head: Mesh) -> None:
    a, b, c = head.welded.T.tolist()
    edges = Counter([*zip(a, b, strict=True), *zip(b, c, strict=True), *zip(c, a, strict=True)])
    assert set(edges.values()) == {1}
    assert all((end, start) in edges for start, end in edges)


def test_solid_is_valid_and_in_one_piece() -> None:
    solid, _ = CylinderHead(variant=3).solid()
    assert solid.status() == Error.NoError
    assert len(solid.decompose()) == 1


def test_triangles_enclose_the_volume_of_the_solid(head: Mesh) -> None:
    a, b, c = head.vertices[head.triangles].astype(float).transpose(1, 0, 2)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert volume == pytest.approx(1e-9 * CylinderHead().solid()[0].volume(), rel=1e-4)
    assert 0.2 < volume / (0.390 * 0.166 * 0.096) < 0.8


def test_head_is_of_the_stated_size_with_its_deck_at_height_zero(head: Mesh) -> None:
    expected = [[-0.195, -0.083, -0.096], [0.195, 0.083, 0.0]]
    np.testing.assert_allclose(head.bounds, expected, atol=5e-4)
    flat = (head.vertices[head.triangles][..., 2] > -1e-6).all(axis=1)
    assert {MATERIALS[i] for i in head.materials[flat]} == {MACHINED}


def test_normals_have_unit_length_and_point_out(head: Mesh) -> None:
    np.testing.assert_allclose(np.linalg.norm(head.normals, axis=1), 1, atol=1e-5)
    a, b, c = head.vertices[head.triangles].astype(float).transpose(1, 0, 2)
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=1)
    agree = np.einsum("ij,ij->i", across, head.normals[head.triangles].mean(axis=1)) / area
    assert np.average(agree > 0.8, weights=area) > 0.999


def test_each_tool_leaves_its_surface(head: Mesh) -> None:
    assert {MATERIALS[i] for i in head.materials} == {CAST, MACHINED, BORED, VALVE, SOOT}


def test_variants_and_bores_give_other_heads(head: Mesh) -> None:
    for other in (CylinderHead(variant=1).mesh(), CylinderHead(bore_mm=70).mesh()):
        assert len(other.vertices) != len(head.vertices) or (other.vertices != head.vertices).any()


def test_same_head_has_the_same_mesh(head: Mesh) -> None:
    again = CylinderHead().mesh()
    np.testing.assert_array_equal(again.vertices, head.vertices)
    np.testing.assert_array_equal(again.triangles, head.triangles)


def test_no_turn_or_mirror_looks_like_the_reference() -> None:
    scene = Scene(image_size=64)
    image = render(scene, T_WORLD_REF).astype(float)
    half_turn = T_WORLD_REF @ rigid_transform(
        Rotation.from_euler("z", 180, degrees=True).as_matrix(), np.zeros(3)
    )
    neighbour = T_WORLD_REF @ rigid_transform(np.eye(3), [0.081, 0, 0])
    for other in (image[::-1], image[:, ::-1], *(render(scene, T) for T in (half_turn, neighbour))):
        assert np.sqrt(np.mean((other - image) ** 2)) > 20


def test_bore_out_of_range_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"bore_mm must lie in 60 to 80 mm, got 90"):
        CylinderHead(bore_mm=90)


SIZE = 192


@pytest.fixture(scope="module")
def regions() -> dict[str, np.ndarray]:
    """Where the reference image shows what, by casting a ray through every pixel."""
    pixels = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1).reshape(-1, 2)
    rays = Scene().lens.rays(pixels, SIZE) @ T_WORLD_REF[:3, :3].T
    origins = np.tile(T_WORLD_REF[:3, 3], (len(rays), 1))
    geometry = geometry_of(CylinderHead())
    hit = geometry.tree.run(origins.astype(np.float32), rays.astype(np.float32), output=True)
    face, height = hit["primID"], STANDOFF + hit["tfar"] * rays[:, 2]
    sky = geometry.sky[geometry.mesh.triangles[face]].mean(axis=1)
    material = np.where(face >= 0, geometry.mesh.materials[face], 0)
    regions = {
        "table": face < 0,
        "top": (face >= 0) & (height > -1e-4),
        "side": (material == MATERIALS.index(CAST)) & (sky > 0.4),
        "hole": (material == MATERIALS.index(BORED)) & (height < -0.02),
    }
    return {name: mask.reshape(SIZE, SIZE) for name, mask in regions.items()}


@pytest.mark.parametrize(
    ("region", "low", "high", "share"),
    [
        ("hole", 0, 50, 0.95),
        ("side", 50, 100, 0.7),
        ("top", 100, 150, 0.9),
        ("table", 151, 255, 0.93),
    ],
)
def test_region_has_the_grey_levels_of_its_slice(
    regions: dict[str, np.ndarray], region: str, low: int, high: int, share: float
) -> None:
    grey = render(Scene(image_size=SIZE), T_WORLD_REF)[regions[region]]
    assert grey.size > 100
    assert np.mean((grey >= low) & (grey <= high)) > share
