"""A coarse stage that gets no nearer is stopped, and the camera brought back to its best view."""

from dataclasses import replace

import numpy as np

from planar import RANGES
from planar_cell import Cell, Oracle
from servoscope.positioning import LoopSettings, Positioner


class Lost(Oracle):
    """Believes now this, now that, and never by its finest stage."""

    def estimate(self, image, previous):
        told = super().estimate(image, previous)
        return replace(told, is_finest=False, stage="coarse")


def test_the_camera_is_brought_back_to_the_best_view() -> None:
    cell = Cell(0.3 * RANGES)
    turns = iter(range(100))

    def astray(delta_p: np.ndarray) -> np.ndarray:
        return delta_p + 0.5 * RANGES * (-1) ** next(turns)

    settings = LoopSettings(patience=3, workspace_margin=5, growth=2)
    result = Positioner(Lost(cell, astray), settings).run(cell, cell)
    assert result.status == "diverged"
    assert "no nearer for 3 moves" in result.message
    errors = [step.image_error for step in result.steps]
    assert result.returned_to == int(np.argmin(errors))
    np.testing.assert_allclose(cell.pose, result.steps[result.returned_to].pose, atol=1e-9)
