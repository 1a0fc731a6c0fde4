"""The light on the part is that of a shadow ray for each pixel, and of Blinn and Phong."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest

from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import geometry_of
from servoscope.scene.lighting import Lighting, PointLight
from servoscope.scene.mesh import MACHINED
from servoscope.scene.render import render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene

SIZE = 256
AMBIENT = 0.4
EYE = T_WORLD_REF[:3, 3]


class Seen(NamedTuple):
    """Where the rays of the reference image's pixels meet the part, and its level deck."""

    on_part: np.ndarray
    on_deck: np.ndarray
    points: np.ndarray
    normals: np.ndarray


@pytest.fixture(scope="module")
def seen() -> Seen:
    """A ray through the middle of every pixel, cast by Embree alone."""
    pixels = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1)
    rays = Scene().lens.rays(pixels, SIZE) @ T_WORLD_REF[:3, :3].T
    ways = rays.reshape(-1, 3).astype(np.float32)
    geometry = geometry_of(CylinderHead())
    hit = geometry.tree.run(np.tile(EYE.astype(np.float32), (len(ways), 1)), ways, output=True)
    face = hit["primID"].reshape(SIZE, SIZE)
    depth = np.where(face >= 0, hit["tfar"].reshape(SIZE, SIZE), 1.0)
    triangles = geometry.mesh.triangles[face]
    a, b, c = np.moveaxis(geometry.mesh.vertices[triangles].astype(float), -2, 0)
    across = np.cross(b - a, c - a)
    level = (geometry.mesh.normals[triangles][..., 2] > 1 - 1e-6).all(axis=-1)
    return Seen(
        on_part=face >= 0,
        on_deck=(face >= 0) & level & (np.abs(a[..., 2]) < 1e-6),
        points=EYE + depth[..., None] * rays,
        normals=across / np.linalg.norm(across, axis=-1, keepdims=True),
    )


def _radiance(*lamps: PointLight) -> np.ndarray:
    return render_radiance(
        Scene(lighting=Lighting(lamps, ambient=AMBIENT), image_size=SIZE), T_WORLD_REF
    )


def _inside(mask: np.ndarray) -> np.ndarray:
    """Pixels whose neighbours all belong to the mask: no other light is averaged in."""
    return cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


@pytest.mark.parametrize("position", [(0.5, 0.1, 0.4), (-0.3, 0.6, 0.5), (0.1, -0.6, 0.3)])
def test_a_pixel_is_lit_where_nothing_lies_between_it_and_the_lamp(
    seen: Seen, position: tuple[float, float, float]
) -> None:
    gained = _radiance(PointLight(position, strength=0.5)) - _radiance()
    to_lamp = np.array(position) - seen.points
    origins = (seen.points + 1e-4 * seen.normals)[seen.on_part].astype(np.float32)
    ways = np.array(position, np.float32) - origins
    tree = geometry_of(CylinderHead()).tree
    lit = (to_lamp * seen.normals).sum(axis=-1) > 0
    lit[seen.on_part] &= tree.run(origins, ways, dists=1.0, query="OCCLUDED") < 0
    shaded, sunny = (_inside(seen.on_part & mask) for mask in (~lit, lit))
    assert min(shaded.sum(), sunny.sum()) > 500
    assert np.mean(gained[shaded] == 0) > 0.998
    assert np.mean(gained[sunny] > 0) > 0.998


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.6), (0.3, -0.2, 0.7), (-0.5, 0.5, 0.6)])
def test_the_deck_shines_as_blinn_and_phong_say(
    seen: Seen, position: tuple[float, float, float]
) -> None:
    unlit = _radiance()
    gained = _radiance(PointLight(position, strength=0.5)) - unlit
    deck = _inside(seen.on_deck)
    to_lamp, to_eye = np.array(position) - seen.points[deck], EYE - seen.points[deck]
    distance = np.linalg.norm(to_lamp, axis=1)
    halfway = to_lamp / distance[:, None] + to_eye / np.linalg.norm(to_eye, axis=1)[:, None]
    cosine = halfway[:, 2] / np.linalg.norm(halfway, axis=1)
    expected = MACHINED.specular * cosine**MACHINED.shininess
    falling = 0.5 * to_lamp[:, 2] / distance**3
    shine = gained[deck] / falling - unlit[deck] / AMBIENT
    assert deck.sum() > 5_000
    assert shine.mean() == pytest.approx(expected.mean(), rel=0.02)
    np.testing.assert_allclose(shine, expected, atol=0.01)
