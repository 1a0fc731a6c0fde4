"""The paper's slices of grey levels fall on holes, sides and top faces; the table is above them."""

import numpy as np
import pytest

from servoscope.scene.geometry import geometry_of
from servoscope.scene.materials import BORED, CAST, MATERIALS
from servoscope.scene.part import CylinderHead
from servoscope.scene.render import render
from servoscope.scene.scene import STANDOFF, T_WORLD_REF, Scene

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
