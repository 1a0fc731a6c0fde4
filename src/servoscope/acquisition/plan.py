"""Where a robot will go for its images: poses drawn around the reference, and the way through."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from servoscope.compiled import compiled
from servoscope.data.schedule import Schedule
from servoscope.errors import InvalidInputError
from servoscope.poses import (
    inverse_transform,
    pose_error,
    poses_from_displacements,
    rigid_transform,
)
from servoscope.positioning.workspace import UNLIMITED, Workspace
from servoscope.storage.folders import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MOST_DRAWS = 10_000
"""How many poses are drawn for one image before the workspace is said to be too small."""

_POSES, _REPLACEMENTS = 0, 3
"""What random numbers are drawn for: each has streams of its own."""


class Draws(NamedTuple):
    """Displacements that are drawn evenly in rings around the reference.

    Parameters
    ----------
    rings : sequence of (n_images, factor)
    ranges : ndarray of shape (6,)
        Largest displacement of each dof at factor 1, about the pivot, [m] and [rad].
    seed : int
    """

    rings: Schedule
    ranges: Array
    seed: int

    def displacements(self) -> Array:
        """The displacements that are drawn first, (n_images, 6), [m] and [rad].

        More images in a ring begin with the same ones, and other rings do not change.
        """
        return np.concatenate(
            [
                self.stream(_POSES, r).uniform(-1.0, 1.0, (ring.n_images, 6))
                * (ring.factor * self.ranges)
                for r, ring in enumerate(self.rings)
            ]
        )

    def replacements(self, i: int) -> Iterator[Array]:
        """What is drawn for image `i`, one after the other, where a robot cannot go, (6,)."""
        rng, factor = self.stream_of_image(_REPLACEMENTS, i), self.rings[self._place(i)[0]].factor
        while True:
            yield rng.uniform(-1.0, 1.0, 6) * (factor * self.ranges)

    def stream_of_image(self, purpose: int, i: int) -> np.random.Generator:
        """Random numbers of image `i` for a purpose."""
        return self.stream(purpose, *self._place(i))

    def stream(self, purpose: int, r: int, *k: int) -> np.random.Generator:
        """Random numbers of ring `r` for a purpose."""
        # The first ring goes without its number: zeros at the end of short seeds change nothing.
        return np.random.default_rng([self.seed, purpose, *k, *([r] if r else [])])

    def _place(self, i: int) -> tuple[int, int]:
        """The ring of image `i`, and its number in there."""
        for r, ring in enumerate(self.rings):
            if i < ring.n_images:
                return r, i
            i -= ring.n_images
        raise IndexError(i)


@compiled()
def _shortened(distances: NDArray[Any], order: NDArray[Any]) -> None:
    """Shorten a closed way by turning parts of it round, until none helps (2-opt; Croes, 1958)."""
    n = order.shape[0]
    improved = True
    while improved:
        improved = False
        for i in range(n - 2):
            for j in range(i + 2, n if i else n - 1):
                a, b, c, d = order[i], order[i + 1], order[j], order[(j + 1) % n]
                before = distances[a, b] + distances[c, d]
                if distances[a, c] + distances[b, d] < before - 1e-12:
                    order[i + 1 : j + 1] = order[i + 1 : j + 1][::-1].copy()
                    improved = True


def travel_order(T: Array, T_start: Array, pivot: float) -> NDArray[np.intp]:
    """An order of poses in which a robot travels little, from a start and back to it.

    Parameters
    ----------
    T : ndarray of shape (n, 4, 4)
    T_start : ndarray of shape (4, 4)
    pivot : float
        A turn by an angle counts as a way of so many metres per radian.

    Returns
    -------
    ndarray of shape (n,)
        Nearest neighbours, improved by turning parts of the way round.
    """
    every = np.concatenate([T_start[None], T])
    t, R = every[:, :3, 3], every[:, :3, :3].reshape(-1, 9)
    cosine = (R @ R.T - 1) / 2
    way = np.linalg.norm(t[:, None] - t[None], axis=2)
    distances = np.hypot(way, pivot * np.arccos(cosine.clip(-1, 1)))
    order = np.zeros(len(every), dtype=np.intp)
    left = np.ones(len(every), dtype=bool)
    left[0] = False
    for k in range(1, len(every)):
        order[k] = np.argmin(np.where(left, distances[order[k - 1]], np.inf))
        left[order[k]] = False
    if len(every) > 3:
        _shortened(distances, order)
    return order[1:] - 1


def waypoints(T_from: Array, T_to: Array, most_m: float, most_rad: float) -> Array:
    """Poses on the straight way between two, none farther than so much from the one before.

    Parameters
    ----------
    T_from, T_to : ndarrays of shape (4, 4)
    most_m, most_rad : float
        Longest step, [m] and [rad].

    Returns
    -------
    ndarray of shape (n, 4, 4)
        Without the first, with the last; the origin goes straight, the rotation evenly.

    Examples
    --------
    >>> far = rigid_transform(np.eye(3), [0.1, 0, 0])
    >>> waypoints(np.eye(4), far, 0.04, 1.0)[:, 0, 3].round(3)
    array([0.033, 0.067, 0.1  ])
    """
    distance, angle = pose_error(T_from, T_to)
    n = max(1, int(np.ceil(max(distance / most_m, angle / most_rad) - 1e-9)))
    shares = np.arange(1, n + 1) / n
    t = T_from[:3, 3] + shares[:, None] * (T_to[:3, 3] - T_from[:3, 3])
    turn = Slerp([0, 1], Rotation.from_matrix(np.stack([T_from[:3, :3], T_to[:3, :3]])))
    way = rigid_transform(turn(shares).as_matrix(), t)
    way[-1] = T_to
    return way


@dataclass(frozen=True, eq=False)
class Plan:
    """Where a robot will go, before it does.

    Parameters
    ----------
    T_world_ref : ndarray of shape (4, 4)
        Where it stands at the reference, [m].
    displacements : ndarray of shape (n_images, 6)
        Of the images from the reference, about the pivot, [m] and [rad].
    pivot : float
        [m].
    workspace : Workspace
    n_outside : int
        Draws that were replaced since they were outside the workspace.
    check_every : int
        After so many images the robot goes back to the reference to look at it again.
    most_m, most_rad : float
        Longest step, [m] and [rad].
    """

    T_world_ref: Array
    displacements: Array
    pivot: float
    workspace: Workspace
    n_outside: int
    check_every: int
    most_m: float
    most_rad: float

    @classmethod
    def draw(
        cls,
        draws: Draws,
        T_world_ref: Array,
        *,
        pivot: float,
        workspace: Workspace = UNLIMITED,
        check_every: int = 50,
        most_m: float = 0.05,
        most_rad: float = 0.2,
    ) -> Plan:
        """A plan whose poses are all within the workspace.

        Raises
        ------
        InvalidInputError
            If the reference is outside the workspace, or so is nearly all around it.
        """
        if not workspace.holds(T_world_ref):
            x, y, z = 1e3 * T_world_ref[:3, 3]
            raise InvalidInputError(
                f"The robot must stand within its workspace ({workspace}), but reports to be at "
                f"{x:.1f}, {y:.1f}, {z:.1f} mm; move it to the reference, or widen the workspace."
            )
        chosen, n_outside = [], 0
        for i, first in enumerate(draws.displacements()):
            for delta_p in islice(chain([first], draws.replacements(i)), MOST_DRAWS):
                if workspace.holds(poses_from_displacements(T_world_ref, delta_p, pivot)):
                    chosen.append(delta_p)
                    break
                n_outside += 1
            else:
                raise InvalidInputError(
                    f"None of {MOST_DRAWS} poses drawn for image {i} is within the workspace "
                    f"({workspace}); widen it, or take smaller ranges."
                )
        return cls(
            T_world_ref, np.array(chosen), pivot, workspace, n_outside, check_every, most_m,
            most_rad,
        )  # fmt: skip

    @cached_property
    def poses(self) -> Array:
        """Where the images are taken, (n_images, 4, 4), [m]."""
        return poses_from_displacements(self.T_world_ref, self.displacements, self.pivot)

    @cached_property
    def order(self) -> NDArray[np.intp]:
        """The order in which the images are taken, (n_images,)."""
        return travel_order(self.poses, self.T_world_ref, self.pivot)

    def stops(self) -> list[int | None]:
        """The images in their order, with None where the reference is looked at again."""
        stops: list[int | None] = []
        for k, i in enumerate(self.order, 1):
            stops.append(int(i))
            if k % self.check_every == 0:
                stops.append(None)
        return stops if stops[-1] is None else [*stops, None]

    def way(self, T_from: Array, T_to: Array) -> Array:
        """The poses that the robot is sent to one after the other, (n, 4, 4), [m]."""
        return waypoints(T_from, T_to, self.most_m, self.most_rad)

    @cached_property
    def path(self) -> Array:
        """All poses that it is sent to, (n_moves, 4, 4), [m]."""
        path, at = [], self.T_world_ref
        for stop in self.stops():
            to = self.T_world_ref if stop is None else self.poses[stop]
            path.append(self.way(at, to))
            at = to
        return np.concatenate(path)

    def facts(self, mm_per_s: float = 50.0, deg_per_s: float = 15.0) -> dict[str, Any]:
        """What the robot will do, as plain numbers.

        Parameters
        ----------
        mm_per_s, deg_per_s : float
            What its speed is taken for; how fast it goes is left to its driver.

        Returns
        -------
        dict
            ``images``, ``moves``; ``farthest_mm`` and ``farthest_deg`` of the frame that it
            reports, from the reference; ``view_mm``, by how much the point at the pivot moves as
            the camera sees it; ``longest_step_mm`` and ``_deg``; ``travel_m``, ``travel_deg``;
            ``minutes``; ``outside_workspace``, draws that were replaced.
        """
        path = np.concatenate([self.T_world_ref[None], self.path])
        far, tilt = pose_error(self.T_world_ref, self.poses)
        steps, turns = pose_error(path[:-1], path[1:])
        D = inverse_transform(inverse_transform(self.T_world_ref) @ self.poses)
        pivot = np.array([0.0, 0.0, self.pivot, 1.0])
        seconds = np.maximum(1e3 * steps / mm_per_s, np.degrees(turns) / deg_per_s).sum()
        return {
            "images": len(self.poses),
            "moves": len(self.path),
            "farthest_mm": 1e3 * float(far.max()),
            "farthest_deg": float(np.degrees(tilt.max())),
            "view_mm": 1e3 * float(np.linalg.norm((D @ pivot - pivot)[:, :3], axis=1).max()),
            "longest_step_mm": 1e3 * float(steps.max()),
            "longest_step_deg": float(np.degrees(turns.max())),
            "travel_m": float(steps.sum()),
            "travel_deg": float(np.degrees(turns.sum())),
            "minutes": float(seconds + len(self.poses)) / 60,
            "outside_workspace": self.n_outside,
        }

    def __str__(self) -> str:
        f = self.facts()
        x, y, z = 1e3 * self.T_world_ref[:3, 3]
        lines = [
            f"reference: where the robot stands, at {x:.1f}, {y:.1f}, {z:.1f} mm",
            f"{f['images']} images, {f['moves']} moves, about {f['minutes']:.0f} min at 50 mm/s, "
            "15 deg/s and one second an image; the speed is the driver's",
            f"farthest from the reference: {f['farthest_mm']:.0f} mm and {f['farthest_deg']:.0f} "
            f"deg of the reported frame; the part moves by up to {f['view_mm']:.0f} mm in view",
            f"longest step {f['longest_step_mm']:.0f} mm, {f['longest_step_deg']:.0f} deg; "
            f"{f['travel_m']:.1f} m and {f['travel_deg']:.0f} deg in all",
        ]
        if not self.workspace.is_limited:
            lines.append(
                "no workspace is given: --workspace x=300:700,z=100:600 is a box it never leaves"
            )
        else:
            lines.append(
                f"workspace: {self.workspace}; {self.n_outside} poses outside were drawn anew"
            )
        return "\n".join(lines)

    def draw_picture(self) -> Figure:
        """The way from above and from the side, in the robot's coordinates."""
        from matplotlib.figure import Figure

        from servoscope.report.figure import ACCENT, INK, MUTED, SMALL, dress

        figure = Figure(figsize=(7.2, 3.8), layout="constrained", facecolor="white")
        path = 1e3 * np.concatenate([self.T_world_ref[None], self.path])[:, :3, 3]
        at, reference = 1e3 * self.poses[:, :3, 3], 1e3 * self.T_world_ref[:3, 3]
        corners = 1e3 * np.array([self.workspace.low, self.workspace.high])
        panels = zip(figure.subplots(1, 2), ((0, 1), (0, 2)), ("above", "the side"), strict=True)
        for axes, (i, j), side in panels:
            axes.plot(path[:, i], path[:, j], color=MUTED, linewidth=0.5)
            axes.plot(at[:, i], at[:, j], "o", color=INK, markersize=3, label="image")
            axes.plot(*reference[[i, j]], "x", color=ACCENT, markersize=9, label="reference")
            for k, line in ((i, axes.axvline), (j, axes.axhline)):
                for limit in corners[:, k][np.isfinite(corners[:, k])]:
                    line(limit, color=ACCENT, linestyle="--", linewidth=0.8)
            axes.set_aspect("equal", adjustable="datalim")
            x, y = (f"{'xyz'[k]} [mm]" for k in (i, j))
            dress(axes, title=f"from {side}", xlabel=x, ylabel=y)
        axes.legend(fontsize=SMALL, frameon=False)
        return figure

    def save_picture(self, path: Path) -> None:
        """Write the picture as PNG."""
        from servoscope.report.figure import DPI

        figure = self.draw_picture()
        write_atomically(path, lambda out: figure.savefig(out, format="png", dpi=DPI))
