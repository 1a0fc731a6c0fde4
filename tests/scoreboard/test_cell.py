"""A cell is ready once it is made."""

import pytest

from servoscope.scene import tracing
from servoscope.scene.geometry import geometry_of
from servoscope.scene.render import prepare
from servoscope.scene.textured_plane import pyramid_of
from servoscope.scene.visibility import ray_grid
from servoscope.scoreboard.cell import robot_in_cell

BUILT_ONCE = (geometry_of, tracing._cell, ray_grid, pyramid_of)


@pytest.mark.parametrize("part", ["cylinder_head", "textured_plane"])
def test_nothing_is_built_when_the_first_image_is_read(part: str) -> None:
    """A watch that waits seconds for an image is not to wait for the scene as well."""
    for built in (tracing._cell, pyramid_of, prepare):
        built.cache_clear()
    robot = robot_in_cell(part, 0, "free", "range_1.0", 32, seed=1)
    before = [built.cache_info().misses for built in BUILT_ONCE]
    assert sum(before)
    robot.read()
    assert [built.cache_info().misses for built in BUILT_ONCE] == before
