"""Whether an image shows what a keyframe expects, as a part of a graph."""

from __future__ import annotations

import numpy as np

from servoscope.export.graph import Graph, Value, maximum, minimum, where
from servoscope.export.levels import Picture, bilinear, half, locate
from servoscope.keyframe import Keyframe
from servoscope.keyframe.rendering import JUMP
from servoscope.positioning.recognition import Recognition
from servoscope.positioning.reference_view import LEAST_UNCLIPPED, TEXTURED, CellGrid


class RecognitionGraph:
    """What `Recognition` does, in a graph.

    Parameters
    ----------
    graph : Graph
    recognition : Recognition
    keyframe : Keyframe
    """

    def __init__(self, graph: Graph, recognition: Recognition, keyframe: Keyframe) -> None:
        self.graph, self.view, self._camera = graph, recognition.view, keyframe.camera
        rays, depth = recognition.rays.T.astype(float), recognition.depth
        ones = np.ones(len(depth))
        self._rays = graph.field(np.stack([*rays, ones, depth]))
        self._surface = graph.field(np.stack([*rays, ones, recognition.surface]))
        self._inverse_depth = graph.field(recognition.surface)
        grid = CellGrid(self.view.shape)
        self._rows, self._columns = grid.rows, grid.columns

    def similarity(self, image: Value, T: Value) -> Value:
        """The median correlation of the cells, of an image that is prepared, at a motion."""
        view, shape = self.view, self.view.shape
        seen = locate(T, self._rays, self._camera, view.aspect, shape)
        grey, _, _ = bilinear(Picture.of(image, shape), seen, view.aspect)
        shown = seen.ok & ~self._hidden(T)
        weights = shown.cast(np.float64).reshape(*shape)
        a = where(shown, grey, 0.0).reshape(*shape)
        return self._matched(a, self.graph.field(view.grey), weights)

    def _hidden(self, T: Value) -> Value:
        """Whether each point is behind another one, (n,)."""
        (height, width), graph = self.view.shape, self.graph
        at = locate(T, self._surface, self._camera, self.view.aspect, self.view.shape)
        before = at.before
        u, v = (where(before, x, 0.5 * n - 0.5) for x, n in ((at.u, width), (at.v, height)))
        nearness = where(before, self._inverse_depth * at.iz, 0.0)
        columns = (u + 0.5).clip(0.0, width - 1.0).cast(np.int64)
        rows = (v + 0.5).clip(0.0, height - 1.0).cast(np.int64)
        pixel = rows * width + columns
        nearest = nearness.scattered(pixel, graph.constant(np.zeros(height * width)), "max")
        return nearness < (1 - JUMP) * nearest.take(pixel)

    def _sum(self, field: Value) -> Value:
        return self._rows @ field @ self._columns.T

    def _spread(self, values: Value) -> Value:
        return self._rows.T @ values @ self._columns

    def _matched(self, image: Value, expected: Value, weights: Value) -> Value:
        n = self._sum(weights)
        one = maximum(n, 1.0)
        a, b = (x - self._spread(self._sum(weights * x) / one) for x in (image, expected))
        aa, bb, ab = (self._sum(weights * x * y) for x, y in ((a, a), (b, b), (a, b)))
        contrast = (bb / one).sqrt()
        n_cells = len(self._rows) * len(self._columns)
        place = 0.9 * (n_cells - 1)
        low = int(place)
        ranked = contrast.reshape(n_cells).sorted(n_cells)
        high = min(low + 1, n_cells - 1)
        quantile = ranked[low] + (place - low) * (ranked[high] - ranked[low])
        area = np.outer(self._rows.sum(axis=1), self._columns.sum(axis=1))
        enough = maximum(TEXTURED * quantile, 1e-6)
        textured = (contrast >= enough) & (n >= LEAST_UNCLIPPED * area)
        correlation = ab / maximum(aa * bb, 1e-12).sqrt()
        count = textured.cast(np.int64).sum()
        found = where(textured, correlation, 2.0).reshape(n_cells).sorted(n_cells)
        lower, upper = half(maximum(count - 1, 0)), minimum(half(count), n_cells - 1)
        median = 0.5 * (found.take(lower) + found.take(upper))
        return where(count > 0, median, 0.0)
