"""A data set in one line, and as a small table for notebooks."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING

import cv2

from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS

if TYPE_CHECKING:
    from servoscope.data.images import PoseImageSet

_THUMBNAIL = 128


def as_text(data: PoseImageSet) -> str:
    """How many images of which size, what moves, and how far."""
    height, width = data.image_shape
    moves, ranges = data.moves(), data.ranges() * DISPLAY_FACTORS
    n = int(moves.sum())
    parts = [
        f"{len(data)} image{'s' * (len(data) != 1)} of {width} x {height}",
        f"{n or 'no'} dof{'s' * (n > 1)} move{'s' * (n < 2)}",
    ]
    spans = [
        f"{ranges[kind][moves[kind]].max():.3g} {unit}"
        for kind, unit in ((slice(0, 3), "mm"), (slice(3, 6), "deg"))
        if moves[kind].any()
    ]
    if spans:
        parts.append(f"range {', '.join(spans)}")
    return f"PoseImageSet({', '.join(parts)})"


def as_html(data: PoseImageSet) -> str:
    """A table of what a data set holds beside its reference image; all text is escaped."""
    height, width = data.image_shape
    rows = {
        "images": f"{len(data)} of {width} x {height} px",
        "names": f"{data.names[0]} ... {data.names[-1]}",
        "pivot": f"{1e3 * data.pivot:g} mm",
        "split": data.split,
    }
    for dof, moves, value, unit in zip(
        DOFS, data.moves(), data.ranges() * DISPLAY_FACTORS, DISPLAY_UNITS, strict=True
    ):
        rows[dof] = f"{value:.3g} {unit}" if moves else "does not move"
    cells = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items()
    )
    scale = min(1.0, _THUMBNAIL / max(height, width))
    size = max(1, round(scale * width)), max(1, round(scale * height))
    small = cv2.resize(data.reference_image, size, interpolation=cv2.INTER_AREA)
    png = base64.b64encode(cv2.imencode(".png", small)[1].tobytes()).decode()
    picture = f'<img alt="reference image" src="data:image/png;base64,{png}">'
    return f"<table>{cells}<tr><th>reference</th><td>{picture}</td></tr></table>"
