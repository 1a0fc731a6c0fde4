"""The cell: a part on a table, lights over it, and the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from servoscope.errors import InvalidInputError
from servoscope.poses import rigid_transform
from servoscope.scene.camera import Covering, Lens, Sensor
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.lighting import Falloff, Lighting
from servoscope.scene.textured_plane import TexturedPlane

STANDOFF = 0.55
"""Height of the reference camera over the deck of the part, [m]."""

T_WORLD_REF = rigid_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, STANDOFF])
"""Reference pose of the camera: over the part, looking straight down, x to the world's x."""
T_WORLD_REF.setflags(write=False)

SIZE_LIMITS = (16, 2048)


@dataclass(frozen=True)
class Scene:
    """All that an image depends on but the pose of the camera and the noise.

    Parameters
    ----------
    part : CylinderHead or TexturedPlane
        Its deck lies in the plane z = 0. A head stands on a white table; a plane fills the view.
    lighting : Lighting
    lens : Lens
    sensor : Sensor
    image_size : int
        Height and width of the images, 16 to 2048, [px].
    covering : Covering, optional
        What hangs before the lens.
    falloff : Falloff, optional
        How the light falls off across the view.
    """

    part: CylinderHead | TexturedPlane = field(default_factory=CylinderHead)
    lighting: Lighting = field(default_factory=Lighting)
    lens: Lens = field(default_factory=Lens)
    sensor: Sensor = field(default_factory=Sensor)
    image_size: int = 256
    covering: Covering | None = None
    falloff: Falloff | None = None

    def __post_init__(self) -> None:
        low, high = SIZE_LIMITS
        if not (isinstance(self.image_size, int) and low <= self.image_size <= high):
            raise InvalidInputError(
                f"image_size must be a whole number from {low} to {high}, got {self.image_size!r}."
            )


Part = CylinderHead | TexturedPlane

PARTS: dict[str, Callable[[int], Part]] = {
    "cylinder_head": lambda variant: CylinderHead(variant=variant),
    "textured_plane": lambda variant: TexturedPlane(variant=variant),
}


def make_part(name: str, variant: int = 0) -> Part:
    """The part of a name in `PARTS`; another variant is another part of the kind.

    Examples
    --------
    >>> make_part("cylinder_head", 2)
    CylinderHead(bore_mm=75.0, variant=2)
    """
    if name not in PARTS:
        raise InvalidInputError(f"part must be one of {', '.join(sorted(PARTS))}, got {name!r}.")
    return PARTS[name](variant)
