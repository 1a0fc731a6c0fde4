"""The plan of an acquisition in space, in the axes of the reference camera, [m]."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition.plan import Plan
from servoscope.poses import inverse_transform
from servoscope.positioning.interfaces import Array

COLOURS = {"planned": (150, 160, 170), "taken": (30, 130, 60), "refused": (200, 50, 40)}
"""Of the cameras of a plan."""

_BEYOND = 0.2
"""Where there is no limit the box is drawn so far beyond the way, as a share of its extent."""


class Way:
    """Where a robot will go, as lines.

    The camera is drawn at the frame that the robot reports: how it is mounted is not known before
    a model is trained.

    Parameters
    ----------
    plan : Plan
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._to_reference = inverse_transform(plan.T_world_ref)

    def camera_at(self, T_world: Array) -> Array:
        """Poses (..., 4, 4) of the robot in the axes of the reference."""
        return np.asarray(self._to_reference @ T_world)

    def path(self) -> Array:
        """The way from the reference through all poses and back, (n_moves, 2, 3)."""
        at = self.camera_at(np.concatenate([self.plan.T_world_ref[None], self.plan.path]))
        return np.stack([at[:-1, :3, 3], at[1:, :3, 3]], axis=1)

    def cameras(self, field_of_view: float, aspect: float, size: float) -> Array:
        """The cameras of all images as wires of 8 segments, (n_images, 8, 2, 3).

        Parameters
        ----------
        field_of_view : float
            From the top to the bottom of the image, [rad].
        aspect : float
            Width of the image over its height.
        size : float
            From the centre of a camera to its image, [m].
        """
        half = size * np.tan(field_of_view / 2)
        x, y = half * aspect, half
        corners = np.array([[-x, -y, size], [x, -y, size], [x, y, size], [-x, y, size]])
        wires = [(np.zeros(3), corner) for corner in corners]
        wires += list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
        at = self.camera_at(self.plan.poses)
        turned = np.einsum("nij,wej->nwei", at[:, :3, :3], np.array(wires))
        return np.asarray(turned + at[:, None, None, :3, 3])

    def colours(self, taken: tuple[int, ...], refused: tuple[int, ...]) -> NDArray[np.uint8]:
        """Colours of the wires of the cameras, (n_images, 8, 2, 3)."""
        colours = np.full((len(self.plan.poses), 8, 2, 3), COLOURS["planned"], np.uint8)
        colours[list(taken)] = COLOURS["taken"]
        colours[list(refused)] = COLOURS["refused"]
        return colours

    def box(self) -> Array:
        """Edges of the workspace, (n, 2, 3); none between sides that have no limit."""
        space = self.plan.workspace
        way = np.concatenate([self.plan.T_world_ref[None], self.plan.path])[:, :3, 3]
        beyond = _BEYOND * np.ptp(way, axis=0).max()
        low, high = np.array(space.low), np.array(space.high)
        limits = np.array(
            [
                np.where(np.isfinite(low), low, way.min(axis=0) - beyond),
                np.where(np.isfinite(high), high, way.max(axis=0) + beyond),
            ]
        )
        is_limit = np.isfinite([low, high])
        edges = []
        for a, b in combinations(product((0, 1), repeat=3), 2):
            same = [k for k in range(3) if a[k] == b[k]]
            if len(same) == 2 and any(is_limit[a[k], k] for k in same):
                edges.append([[limits[corner[k], k] for k in range(3)] for corner in (a, b)])
        ends = np.array(edges).reshape(-1, 2, 3)
        R, t = self._to_reference[:3, :3], self._to_reference[:3, 3]
        return np.asarray(ends @ R.T + t)

    def after(self, taken: tuple[int, ...], refused: tuple[int, ...]) -> Array | None:
        """Where the image that is taken next is, (4, 4), or None if there is none."""
        done = {*taken, *refused}
        k = next((i for i in self.plan.order if i not in done), None)
        return None if k is None else self.camera_at(self.plan.poses[k])
