"""The surface of a part: its triangles, what they are made of, and its grain.

Solids have lengths in mm, angles in degrees, z up.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType
from numpy.typing import NDArray


@dataclass(frozen=True)
class Material:
    """How a surface answers light.

    Parameters
    ----------
    albedo : float
        Share of the light that is scattered evenly (Lambert), 0 to 1.
    specular : float
        Strength of the highlight (Blinn-Phong), relative to white.
    shininess : int
        Exponent of the highlight, an even number; the larger, the narrower.
    mottle : float
        Standard deviation of the albedo over the surface, relative to it.
    roughness : float
        Standard deviation of the slope of the surface, [rad].
    milled : bool
        Whether mottle follows the arcs of a face mill instead of lying at random.
    """

    albedo: float
    specular: float = 0.0
    shininess: int = 2
    mottle: float = 0.0
    roughness: float = 0.0
    milled: bool = False


TABLE = Material(albedo=0.90)
CAST = Material(albedo=0.30, specular=0.03, shininess=8, mottle=0.10, roughness=0.10)
MACHINED = Material(
    albedo=0.41, specular=0.06, shininess=12, mottle=0.025, roughness=0.004, milled=True
)
BORED = Material(albedo=0.22, specular=0.05, shininess=20, mottle=0.02)
VALVE = Material(albedo=0.32, specular=0.12, shininess=30, mottle=0.05, roughness=0.01)
SOOT = Material(albedo=0.26, specular=0.02, shininess=6, mottle=0.14, roughness=0.06)

MATERIALS = (TABLE, CAST, MACHINED, BORED, VALVE, SOOT)
"""Every material; a mesh names them by their place here."""


def material_table() -> NDArray[np.float32]:
    """`MATERIALS` as rows of numbers, in the order of `Material`'s fields."""
    rows = [(m.albedo, m.specular, m.shininess, m.mottle, m.roughness, m.milled) for m in MATERIALS]
    return np.array(rows, dtype=np.float32)


N_TEXELS = 512
"""Texels a side of the tile; one is a millimetre, so that no part shows a tile twice."""

_SCALES = ((1.3, 1.0), (3.0, 0.8), (11.0, 0.7))
"""Size [mm] and weight of the lumps that a cast surface is made of."""


@lru_cache(maxsize=1)
def grain_tile() -> NDArray[np.float32]:
    """Unevenness of a surface and its slopes along both axes, each of mean 0 and variance 1.

    Returns
    -------
    ndarray of shape (512, 512, 3), float32
        A tile that fits to itself on all sides.
    """
    noise = np.fft.rfft2(np.random.default_rng(512).standard_normal((N_TEXELS, N_TEXELS)))
    fy = 2 * np.pi * np.fft.fftfreq(N_TEXELS)[:, None]
    fx = 2 * np.pi * np.fft.rfftfreq(N_TEXELS)
    spectrum = sum(w * s * np.exp(-0.5 * s**2 * (fx**2 + fy**2)) for s, w in _SCALES)
    spectrum = np.where(fx**2 + fy**2 > 0, spectrum, 0.0)
    channels = [noise * spectrum * factor for factor in (1.0, 1j * fx, 1j * fy)]
    tile = np.stack([np.fft.irfft2(c, s=(N_TEXELS, N_TEXELS)) for c in channels], axis=-1)
    return np.ascontiguousarray(tile / tile.std(axis=(0, 1)), dtype=np.float32)


CREASE_DEG = 32.0
"""Faces that meet at a sharper angle than this keep their own normals."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed triangle mesh with a normal at each vertex and a material for each triangle.

    Parameters
    ----------
    vertices : ndarray of shape (n_vertices, 3)
        [m]. A vertex on a crease stands once for each of its normals.
    normals : ndarray of shape (n_vertices, 3)
        Unit length, pointing out.
    triangles : ndarray of shape (n_triangles, 3), int32
        Indices of vertices, counter-clockwise seen from outside.
    welded : ndarray of shape (n_triangles, 3), int32
        The same triangles with the vertices of a crease joined again: the closed surface.
    materials : ndarray of shape (n_triangles,), uint8
        Indices into `MATERIALS`.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    welded: NDArray[np.int32]
    materials: NDArray[np.uint8]

    @property
    def bounds(self) -> NDArray[np.float32]:
        """Lowest and highest corner, of shape (2, 3), [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])


def mesh_from_solid(solid: Manifold, material_of: dict[int, Material]) -> Mesh:
    """The surface, [m], of a solid, [mm], smooth but for its creases.

    `material_of` says which material each original solid, by its `original_id`, left on the
    surface.
    """
    raw = solid.calculate_normals(0, CREASE_DEG).to_mesh()
    values = np.asarray(raw.vert_properties)
    triangles = np.asarray(raw.tri_verts).astype(np.int32)
    joined = np.arange(len(values), dtype=np.int32)
    joined[np.asarray(raw.merge_from_vert)] = np.asarray(raw.merge_to_vert)
    materials = np.empty(len(triangles), np.uint8)
    ends = np.asarray(raw.run_index) // 3
    for original, start, end in zip(raw.run_original_id, ends[:-1], ends[1:], strict=True):
        materials[start:end] = MATERIALS.index(material_of[int(original)])
    return Mesh(
        vertices=np.ascontiguousarray(values[:, :3] * 1e-3, dtype=np.float32),
        normals=np.ascontiguousarray(values[:, 3:6], dtype=np.float32),
        triangles=triangles,
        welded=joined[triangles],
        materials=materials,
    )


_SAGITTA = 0.05
"""How far a facet may stand off the round surface that it stands for, [mm]."""

Range = tuple[float, float]


def union(solids: Iterable[Manifold]) -> Manifold:
    """All the solids in one."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def box(x: Range, y: Range, z: Range) -> Manifold:
    """A block between the given coordinates."""
    low, high = np.array([x, y, z]).T
    return Manifold.cube(high - low).translate(low)


def rod(x: float, y: float, z: Range, radius: float, top_radius: float | None = None) -> Manifold:
    """A cylinder, or cone, standing upright."""
    top = radius if top_radius is None else top_radius
    return Manifold.cylinder(z[1] - z[0], radius, top, _sides(max(radius, top))).translate(
        [x, y, z[0]]
    )


def bar(x: float, y: Range, z: float, radius: float, squash: float = 1.0) -> Manifold:
    """A cylinder along y, its height scaled by `squash`."""
    lying = Manifold.cylinder(y[1] - y[0], radius, radius, _sides(radius)).rotate([-90, 0, 0])
    return lying.scale([1, 1, squash]).translate([x, y[0], z])


def plate(outline: CrossSection, z: Range) -> Manifold:
    """An outline in the xy plane, extruded."""
    return outline.extrude(z[1] - z[0]).translate([0, 0, z[0]])


def rectangle(x: Range, y: Range, corner: float = 0.0) -> CrossSection:
    """A rectangle with rounded corners."""
    sharp = CrossSection.square([x[1] - x[0] - 2 * corner, y[1] - y[0] - 2 * corner])
    return _grown(sharp, corner).translate([x[0] + corner, y[0] + corner])


def disc(x: float, y: float, radius: float) -> CrossSection:
    """A full circle."""
    return CrossSection.circle(radius, _sides(radius)).translate([x, y])


def slot(x: float, y: float, length: float, width: float, angle: float) -> CrossSection:
    """A slot with round ends, its long side at `angle` from x."""
    core = CrossSection.square([length - width, 1e-2], True)
    return _grown(core, width / 2).rotate(angle).translate([x, y])


def kidney(x: float, y: float, radius: float, width: float, angles: Range) -> CrossSection:
    """A curved slot along an arc about (x, y)."""
    a = np.radians(np.linspace(*angles, 13))
    inner, outer = radius - 5e-3, radius + 5e-3
    arc = np.concatenate(
        [np.c_[np.cos(a), np.sin(a)] * outer, np.c_[np.cos(a), np.sin(a)][::-1] * inner]
    )
    return _grown(CrossSection([arc]), width / 2).translate([x, y])


def filleted(outline: CrossSection, radius: float) -> CrossSection:
    """The outline with its inner corners filled to a radius."""
    return _grown(_grown(outline, radius), -radius)


def _grown(outline: CrossSection, by: float) -> CrossSection:
    return outline.offset(by, JoinType.Round, 2.0, _sides(abs(by))) if by else outline


def _sides(radius: float) -> int:
    """Sides of a full circle."""
    return max(16, 4 * int(np.ceil(np.pi / np.arccos(1 - _SAGITTA / radius) / 4)))
