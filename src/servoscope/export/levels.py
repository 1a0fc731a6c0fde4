"""The keyframe at one resolution, and the descent on the grey levels, as parts of a graph."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.export.graph import Graph, Value, concatenate, maximum, minimum, where
from servoscope.export.rigid import Motions, exponential, solve
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import (
    FAR,
    LEAST_DEVIATION,
    LEAST_SCALE,
    LONGEST_STEP,
    MOST_RELAXED,
    N_BLOCKS,
    PRIOR,
    RELAXED,
    Level,
)
from servoscope.keyframe.lighting import Light
from servoscope.keyframe.robust import BEND, MOST_RANKED
from servoscope.keyframe.warping import NEAREST, SATURATED, UNSEEN

Array = NDArray[np.float64]

_LARGE = 1e9


class Seen(NamedTuple):
    """Where points are seen, each of shape (..., n).

    `ok` are those within the image, `before` those before the camera where its distortion does
    not fold.
    """

    ok: Value
    before: Value
    X: Value
    Y: Value
    Z: Value
    iz: Value
    px: Value
    py: Value
    r2: Value
    d: Value
    u: Value
    v: Value


class Picture(NamedTuple):
    """An image at one resolution: its pixels, row by row, and its height and width."""

    pixels: Value
    shape: tuple[int, int]

    @classmethod
    def of(cls, image: Value, shape: tuple[int, int]) -> Picture:
        """Of an image."""
        return cls(image.reshape(-1), shape)


def locate(
    T: Value, rays: Value, camera: CameraModel, aspect: float, shape: tuple[int, int]
) -> Seen:
    """Where points are seen by a camera.

    Parameters
    ----------
    T : Value of shape (..., 4, 4)
        Reference camera to this camera.
    rays : Value of shape (4, n)
        x, y, 1 and the inverse depth of each point.
    camera : CameraModel
    aspect : float
    shape : (height, width)
        Of the image.
    """
    height, width = shape
    f, cx, cy, k1, k2 = (float(x) for x in camera.values)
    Q = T @ rays
    X, Y, Z = (Q.take(k, axis=-2) for k in range(3))
    ahead = Z > NEAREST
    iz = where(ahead, 1.0 / Z, 1.0)
    px, py = X * iz, Y * iz
    r2 = px * px + py * py
    d = 1.0 + r2 * (k1 + k2 * r2)
    u = (f * d * px + (cx + 0.5)) * width - 0.5
    v = ((f * d * py + cy) / aspect + 0.5) * height - 0.5
    before = ahead & (1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2) > 0.0)
    ok = before & (u >= 0.0) & (v >= 0.0) & (u < width - 1.0) & (v < height - 1.0)
    return Seen(ok, before, X, Y, Z, iz, px, py, r2, d, u, v)


def bilinear(picture: Picture, seen: Seen, aspect: float) -> tuple[Value, Value, Value]:
    """Grey levels between pixels, and their slopes to the right and down."""
    (height, width), pixels = picture.shape, picture.pixels
    u, v = where(seen.ok, seen.u, 0.0), where(seen.ok, seen.v, 0.0)
    column, row = u.cast(np.int64), v.cast(np.int64)
    a, b = u - column.cast(np.float64), v - row.cast(np.float64)
    at = row * width + column
    i00, i01, i10, i11 = (pixels.take(at + k) for k in (0, 1, width, width + 1))
    top, bottom = i00 + a * (i01 - i00), i10 + a * (i11 - i10)
    gx = ((i01 - i00) * (1.0 - b) + (i11 - i10) * b) * width
    gy = (bottom - top) * (height / aspect)
    return top + b * (bottom - top), gx, gy


def cubic(picture: Picture, seen: Seen) -> Value:
    """Grey levels between pixels by the cubic convolution of Keys (a = -1/2)."""
    (height, width), pixels = picture.shape, picture.pixels
    u, v = where(seen.ok, seen.u, 0.0), where(seen.ok, seen.v, 0.0)
    column, row = u.cast(np.int64), v.cast(np.int64)
    shares = []
    for x in (u - column.cast(np.float64), v - row.cast(np.float64)):
        shares.append(
            (
                x * (x * (1.0 - 0.5 * x) - 0.5),
                1.0 + x * x * (1.5 * x - 2.5),
                x * (0.5 + x * (2.0 - 1.5 * x)),
                x * x * (0.5 * x - 0.5),
            )
        )
    columns = [maximum(column - 1, 0), column, column + 1, minimum(column + 2, width - 1)]
    parts = []
    for k in range(4):
        line = minimum(maximum(row + (k - 1), 0), height - 1) * width
        along = [a * pixels.take(line + at) for a, at in zip(shares[0], columns, strict=True)]
        parts.append(shares[1][k] * (along[0] + along[1] + along[2] + along[3]))
    return parts[0] + parts[1] + parts[2] + parts[3]


class Linear(NamedTuple):
    """Residuals of an image and their derivatives, over the points of a level, each (n,).

    `J` is of shape (6, n); `w` are the robust inverse variances, `scale` that of the residuals.
    """

    J: Value
    r: Value
    w: Value
    scale: Value

    def curvature_ratio(self) -> Value:
        """As `servoscope.keyframe.robust.curvature_ratio`."""
        ratio = self.r / (BEND * self.scale)
        u = ratio * ratio
        changed = (self.w * (1.0 - 3.0 * u) / (1.0 + u)).sum()
        return changed / maximum(self.w.sum(), 1e-12)


class Descent(NamedTuple):
    """Where an image may have been taken, in what light, and whether that is settled.

    `light` is of defocus, gains and offsets.
    """

    T: Value
    light: Value
    settled: Value


class LevelGraph:
    """A level of the keyframe in a graph.

    Its points stand cell by cell of the light's grid, each cell filled up with points that are
    never seen, so that the cells are of one size.

    Parameters
    ----------
    graph : Graph
    level : Level
    motions : Motions
        What the camera can have done.
    """

    def __init__(self, graph: Graph, level: Level, motions: Motions) -> None:
        self.graph, self.level, self.motions, self.k = graph, level, motions, level.grid.k
        view, grid = level.view, level.grid
        counts = np.diff(grid.starts)
        self.n_cells, self.n_each = len(counts), int(counts.max())
        within = np.arange(self.n_each) < counts[:, None]
        self._taken = np.flatnonzero(within)
        self.n = within.size
        self.real = graph.constant(within.ravel())
        ones = np.ones(len(level.used))
        self.rays = graph.field(self.filled(np.stack([*level.rays.T, ones, level.depth])))
        self.grey, self.trust = (graph.field(self.filled(x)) for x in (level.grey, level.trust))
        self.laplacian = graph.field(self.filled(level.laplacian))
        self.blocks = self.filled(level.blocks)
        self.shares = self.filled(grid.shares.T).T.reshape(self.n_cells, self.n_each, 4)
        some = self._taken[:: max(1, len(level.used) // MOST_RANKED)]
        self._some, self._n_some = some.astype(np.int64), len(some)
        self.n_light = 1 + 2 * self.k**2
        self.even = np.concatenate([[0.0], Light.even(self.k).nodes.ravel()])
        self.depth = float(np.median(level.depth))
        self.width, self.aspect, self.shape = view.width, view.aspect, view.shape

    def filled(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Values (..., n_used) at the places of the points; 0 at others."""
        out = np.zeros((*values.shape[:-1], self.n), values.dtype)
        out[..., self._taken] = values
        return out

    def start(self, T: Value) -> Descent:
        """A guess in the light of the reference."""
        return Descent(T, self.graph.constant(self.even), self.graph.constant(False))

    def light_at(self, nodes: Value) -> Value:
        """A field (n,) of numbers at the nodes."""
        own = nodes.take(self.level.grid.nodes).reshape(self.n_cells, 4, 1)
        return (self.graph.field(self.shares) @ own).reshape(self.n)

    def linearise(self, picture: Picture, T: Value, light: Value) -> Linear:
        """As `Level.linearise`."""
        level, k2 = self.level, self.k**2
        seen = locate(T, self.rays, level.camera, self.aspect, self.shape)
        ok = seen.ok & self.real
        gain, offset = self.light_at(light[1 : 1 + k2]), self.light_at(light[1 + k2 :])
        expected = gain * self.grey + offset + light[0] * self.laplacian
        if level.finest:
            grey = cubic(picture, seen)
            gx, gy = self._carried(T, seen)
            gx, gy = gain * gx, gain * gy
        else:
            grey, gx, gy = bilinear(picture, seen, self.aspect)
        r = grey - expected
        saturated = (grey > SATURATED) & (r < 0.0)
        r = where(ok, where(saturated, 0.0, r), float(UNSEEN))
        counts = (ok & ~saturated).cast(np.float64)
        f, q = float(level.camera.f), self.rays[3]
        bent = self._bent(seen)
        along = gx * seen.px + gy * seen.py
        hx = counts * (f * (seen.d * gx + bent * along * seen.px) * seen.iz)
        hy = counts * (f * (seen.d * gy + bent * along * seen.py) * seen.iz)
        hz = -(hx * seen.px + hy * seen.py)
        columns = [q * hx, q * hy, q * hz]
        columns += [seen.Y * hz - seen.Z * hy, seen.Z * hx - seen.X * hz, seen.X * hy - seen.Y * hx]
        J = concatenate([column.reshape(1, self.n) for column in columns])
        scale = self._scale(r)
        ratio = r / (BEND * scale)
        share = 1.0 / (1.0 + ratio * ratio)
        w = where(ok, share * share, 0.0) * self.trust / (scale * scale)
        return Linear(J, r, w, scale)

    def _bent(self, seen: Seen) -> Value:
        k1, k2 = float(self.level.camera.k1), float(self.level.camera.k2)
        return 2.0 * (k1 + 2.0 * k2 * seen.r2)

    def _carried(self, T: Value, seen: Seen) -> tuple[Value, Value]:
        """Slopes of the reference image, carried to where its points are seen."""
        level, f = self.level, float(self.level.camera.f)
        slopes = self.graph.field(self.filled(level.slopes.T))
        by_point = self.graph.field(self.filled(-level.by_camera[:, :, 1:3].reshape(-1, 4).T))
        a, b, c, e = (by_point[k] for k in range(4))
        px, py, iz, d = seen.px, seen.py, seen.iz, seen.d
        bent = self._bent(seen)
        ways = []
        for j in (0, 1):
            x, y = (T[0, j] - px * T[2, j]) * iz, (T[1, j] - py * T[2, j]) * iz
            along = bent * (px * x + py * y)
            ways.append((f * (d * x + along * px), f * (d * y + along * py)))
        (u0, v0), (u1, v1) = ways
        ux, uy = u0 * a + u1 * c, u0 * b + u1 * e
        vx, vy = v0 * a + v1 * c, v0 * b + v1 * e
        determinant = ux * vy - uy * vx
        determinant = where(seen.ok & self.real, determinant, 1.0)
        right, down = slopes[0], slopes[1]
        return (vy * right - vx * down) / determinant, (ux * down - uy * right) / determinant

    def _scale(self, r: Value) -> Value:
        """As `robust_scale`."""
        some = r.take(self._some)
        seen = some > float(UNSEEN)
        n_seen = seen.cast(np.int64).sum()
        ranked = where(seen, self.graph.apply("Abs", some), _LARGE).sorted(self._n_some)
        last = maximum(n_seen - 1, 0)
        middle = 0.5 * (
            ranked.take(half(last)) + ranked.take(minimum(half(n_seen), self._n_some - 1))
        )
        scale = maximum(1.4826 * middle, LEAST_SCALE)
        return where(4 * n_seen < self._n_some, 255.0, scale)

    def normal_equations(self, found: Linear, light: Value) -> tuple[Value, Value]:
        """Of a twist, defocus and light, (n, n) and (n,), from residuals and derivatives."""
        size, cells, k2 = 6 + self.n_light, (self.n_cells, self.n_each), self.k**2
        shares = self.graph.field(np.moveaxis(self.shares, 2, 0).reshape(4, self.n))
        rows = concatenate(
            [found.J, -self.laplacian.reshape(1, self.n), -self.grey * shares, -shares]
        )
        A = rows.reshape(15, *cells).transpose(1, 0, 2)
        weighted = A * found.w.reshape(self.n_cells, 1, self.n_each)
        own = weighted @ A.transpose(0, 2, 1)
        slope = -(weighted @ found.r.reshape(*cells, 1))
        nodes = self.level.grid.nodes
        pose = np.tile(np.arange(7), (self.n_cells, 1))
        at = np.concatenate([pose, 7 + nodes, 7 + k2 + nodes], axis=1)
        pairs = at[:, :, None] * size + at[:, None, :]
        H = own.reshape(-1).scattered(pairs.ravel(), self._zeros(size * size), "add")
        g = slope.reshape(-1).scattered(at.ravel(), self._zeros(size), "add")
        prior = self.level.grid.prior.copy()
        prior[range(6), range(6)] = 1 / PRIOR**2
        off = (light - self.even).reshape(self.n_light, 1)
        pulled = (prior[6:, 6:].astype(float) @ off).reshape(self.n_light)
        H = H.reshape(size, size) + prior
        return H, g - concatenate([np.zeros(6), pulled])

    def _zeros(self, *shape: int) -> Value:
        return self.graph.constant(np.zeros(shape))

    def resized(self, light: Value, k: int) -> Value:
        """Light at k by k nodes at the nodes of this level."""
        if k == self.k:
            return light
        units = np.eye(1 + 2 * k**2)
        made = [Light(e[1:].reshape(2, k, k), float(e[0])).resized(self.k) for e in units]
        matrix = np.stack([[x.defocus, *x.nodes.ravel()] for x in made], axis=1)
        return (matrix @ light.reshape(len(units), 1)).reshape(self.n_light)

    def descend(
        self, picture: Picture, guess: Descent, k: int, n_steps: int, tolerance: float
    ) -> Descent:
        """As `Level.descend`, of a guess whose light is at k by k nodes.

        Where the light is not known yet it comes first, in a step that leaves the pose as it is.
        """
        graph, size = self.graph, 6 + self.n_light
        poses, translations = ((np.arange(size) < n).astype(float) for n in (6, 3))
        held = translations if self.depth < FAR else np.zeros(size)
        reach = self.width * float(self.level.camera.f)

        def step_once(number: Value, state: list[Value]) -> tuple[Value, list[Value], list[Value]]:
            T, light, lit, begun = state
            found = self.linearise(picture, T, light)
            H, g = self.normal_equations(found, light)
            left_out = where(lit, held, graph.constant(poses))
            taken = 1.0 - left_out
            H = H * (taken.reshape(size, 1) * taken) + graph.constant(np.eye(size)) * left_out
            step = self._step(H, (g * taken).reshape(size, 1), T)
            relaxed = minimum(RELAXED / maximum(found.curvature_ratio(), 1e-9), MOST_RELAXED)
            step = step * where(begun, relaxed, 1.0)
            flow = reach * maximum(self.depth * step[:3].norm(), step[3:6].norm())
            step = step * minimum(LONGEST_STEP * self.width / maximum(flow, 1e-9), 1.0)
            T = self.motions.nearest(exponential(step[:6]) @ T)
            settled = lit & (flow < tolerance)
            state = [T, light + step[6:], graph.constant(True), lit]
            return ~settled, state, [settled]

        n_most = where(guess.settled, np.int64(n_steps), graph.constant(np.int64(n_steps + 1)))
        start = [guess.T, self.resized(guess.light, k), guess.settled, graph.constant(False)]
        (T, light, *_), (settled,) = graph.loop(n_most, start, step_once)
        return Descent(T, light, settled.cast(np.int64).max() > 0)

    def _step(self, H: Value, g: Value, T: Value) -> Value:
        size, n_light = 6 + self.n_light, self.n_light
        if self.motions.is_full:
            return solve(H, g, size).reshape(size)
        n_dofs = self.motions.n_dofs
        upper = concatenate([self.motions.twists(T), np.zeros((6, n_light))], axis=1)
        lower = np.hstack([np.zeros((n_light, n_dofs)), np.eye(n_light)])
        B = concatenate([upper, lower])
        turned = B.transpose(1, 0)
        return (B @ solve(turned @ H @ B, turned @ g, n_dofs + n_light)).reshape(size)

    def compare(self, picture: Picture, T: Value) -> Value:
        """The mean correlation of blocks, as `Level.compare`."""
        seen = locate(T, self.rays, self.level.camera, self.aspect, self.shape)
        grey, _, _ = bilinear(picture, seen, self.aspect)
        ok = (seen.ok & self.real).cast(np.float64)
        a, b = ok * grey, ok * self.grey
        fields = [ok, a, b, a * a, b * b, a * b]
        sums = block_sums(
            concatenate([x.reshape(1, self.n) for x in fields]), len(fields), self.blocks
        )
        n_seen = sums[0]
        count = maximum(n_seen, 1.0)
        mean_a, mean_b, aa, bb, ab = (sums[k] / count for k in range(1, 6))
        variance_a = maximum(aa - mean_a * mean_a, 0.0) + LEAST_DEVIATION**2
        variance_b = maximum(bb - mean_b * mean_b, 0.0) + LEAST_DEVIATION**2
        z = maximum(ab - mean_a * mean_b, 0.0) / (variance_a * variance_b).sqrt()
        whole = np.bincount(self.level.blocks, minlength=N_BLOCKS**2).astype(float)
        weight = where(2.0 * n_seen > whole, variance_b.sqrt(), 0.0)
        return (z * weight).sum() / maximum(weight.sum(), 1e-9)

    def correlations(self, picture: Picture, T: Array) -> Value:
        """As `Level.correlation`, of each of many known motions, (m, 4, 4)."""
        seen = locate(self.graph.constant(T), self.rays, self.level.camera, self.aspect, self.shape)
        grey, _, _ = bilinear(picture, seen, self.aspect)
        ok = (seen.ok & self.real).cast(np.float64)
        a, b = ok * grey, ok * self.grey
        n = maximum(ok.sum(1), 1.0)
        sa, sb, aa, bb, ab = (x.sum(1) for x in (a, b, a * a, b * b, a * b))
        found = (ab - sa * sb / n) / ((aa - sa * sa / n) * (bb - sb * sb / n) + 1e-6).sqrt()
        return where(4.0 * n < float(len(self.level.used)), 0.0, found)


def half(n: Value) -> Value:
    """Half of a whole number, the lower one."""
    return n.graph.apply("Div", n, n.graph.constant(np.int64(2)))


def block_sums(rows: Value, n_rows: int, blocks: NDArray[np.generic]) -> Value:
    """Sums over the blocks of a level, (n_rows, n_blocks), of rows (n_rows, n)."""
    graph, n = rows.graph, blocks.size
    shape = graph.constant(np.array([n_rows, n], np.int64))
    one = graph.constant(blocks.astype(np.int64).reshape(1, n))
    indices = graph.apply("Expand", one, shape)
    return rows.scattered(indices, graph.constant(np.zeros((n_rows, N_BLOCKS**2))), "add", axis=1)
