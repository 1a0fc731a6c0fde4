"""The cylinder head is a closed body of the stated size, unlike itself turned or mirrored."""

from collections import Counter

import numpy as np
import pytest
from manifold3d import Error
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import rigid_transform
from servoscope.scene.materials import BORED, CAST, MACHINED, MATERIALS, SOOT, VALVE
from servoscope.scene.mesh import Mesh
from servoscope.scene.part import CylinderHead
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene


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
