"""The parts that can lie in the scene, by name."""

from __future__ import annotations

from collections.abc import Callable

from servoscope.errors import InvalidInputError
from servoscope.scene.part import CylinderHead
from servoscope.scene.textured_plane import TexturedPlane

Part = CylinderHead | TexturedPlane

PARTS: dict[str, Callable[[int], Part]] = {
    "cylinder_head": lambda variant: CylinderHead(variant=variant),
    "textured_plane": lambda variant: TexturedPlane(variant=variant),
}


def make_part(name: str, variant: int = 0) -> Part:
    """The part of a name.

    Parameters
    ----------
    name : str
        One of `PARTS`.
    variant : int
        Another number gives another part of the kind.

    Raises
    ------
    InvalidInputError
        If there is no such part.

    Examples
    --------
    >>> make_part("cylinder_head", 2)
    CylinderHead(bore_mm=75.0, variant=2)
    """
    if name not in PARTS:
        raise InvalidInputError(f"part must be one of {', '.join(sorted(PARTS))}, got {name!r}.")
    return PARTS[name](variant)
