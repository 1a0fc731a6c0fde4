"""Families of image features as parts of a graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.data.image_motion import shrunk_shape
from servoscope.errors import ModelError
from servoscope.export.graph import Value, concatenate, maximum, stack, where
from servoscope.export.resizing import reduced
from servoscope.export.rigid import angle
from servoscope.features.cell_moments import (
    BLUR,
    LEVELS,
    N_DIRECTIONS,
    WHITE_QUANTILE,
    CellMoments,
    GradientMoments,
    IntensityMoments,
    cell_weights,
)
from servoscope.features.fixed_projection import TchebichefMoments
from servoscope.features.image_transformer import LinearProjection
from servoscope.features.moments import GeometricMoments

Array = NDArray[np.float64]


def features_of(transformer: Any, name: str, grey: Value) -> Value:
    """What a fitted transformer computes of an image, (n_features,).

    Parameters
    ----------
    transformer : ImageTransformer
    name : str
        What its family is called.
    grey : Value of shape (height, width), float64

    Raises
    ------
    ModelError
        If the family has no ONNX form.
    """
    makers: dict[type, Callable[[Any, Value], Value]] = {
        GeometricMoments: _moments,
        GradientMoments: _gradients,
        IntensityMoments: _intensities,
    }
    if type(transformer) in makers:
        return makers[type(transformer)](transformer, grey)
    if isinstance(transformer, LinearProjection) and not isinstance(transformer, TchebichefMoments):
        return _projections(transformer, grey)
    raise ModelError(
        f"The features {name} have no ONNX form; train without them (--families), or use "
        "servoscope serve."
    )


def _projections(family: LinearProjection, grey: Value) -> Value:
    components = np.asarray(family.components_, np.float32)
    length = maximum(grey.norm(), 1e-300)
    at = grey.reshape(1, -1) @ grey.graph.field(components.T)
    shift = np.asarray(family.mean_) @ components.T
    return at.reshape(len(components)) / length - shift


def _moments(family: GeometricMoments, grey: Value) -> Value:
    return concatenate([_slice(family.image_shape_, grey, *bounds) for bounds in family.slices])


def _slice(shape: tuple[int, int], grey: Value, lower: int, upper: int) -> Value:
    """The eight descriptors of one slice, about its centroid."""
    height, width = shape
    f = where((grey >= float(lower)) & (grey < float(upper)), grey, 0.0)
    m00, columns, rows = f.sum(), f.sum(0), f.sum(1)
    mass, empty = maximum(m00, 1.0), m00 < 0.5
    x, y = (
        (line * np.arange(n, dtype=float)).sum() / mass
        for line, n in ((columns, width), (rows, height))
    )
    dx, dy = np.arange(width, dtype=float) - x, np.arange(height, dtype=float) - y
    xx, yy = columns * dx * dx, rows * dy * dy
    xy = ((f @ dx.reshape(width, 1)).reshape(height) * dy).sum()
    mu20, mu02 = xx.sum(), yy.sum()
    difference, middle = 0.5 * (mu20 - mu02), 0.5 * (mu20 + mu02)
    spread = (difference * difference + xy * xy).sqrt()
    skews = []
    for third, second in (((xx * dx).sum(), mu20), ((yy * dy).sum(), mu02)):
        flat = second <= 1e-9 * mass
        root = where(flat, 1.0, second).sqrt()
        skews.append(where(flat, 0.0, third / (root * root * root)))
    return stack(
        [
            where(empty, 0.5 * (width - 1), x),
            where(empty, 0.5 * (height - 1), y),
            0.5 * angle(2.0 * xy, 2.0 * difference),
            ((middle + spread) / mass).sqrt(),
            (maximum(middle - spread, 0.0) / mass).sqrt(),
            m00,
            *skews,
        ],
        8,
    )


def _small(family: CellMoments, grey: Value) -> tuple[Value, tuple[int, int]]:
    """The image as cells take it, and its shape."""
    shape = family.image_shape_
    to = shrunk_shape(shape, family.size)
    return reduced(grey, shape, to, BLUR, cv2.BORDER_DEFAULT), to


def _in_cells(family: CellMoments, layers: Value, shape: tuple[int, int]) -> Value:
    rows, columns = (cell_weights(side, family.n_cells).astype(float) for side in shape)
    return rows @ layers @ columns.T


def _gradients(family: GradientMoments, grey: Value) -> Value:
    small, shape = _small(family, grey)
    (smooth_rows, steep_rows), (smooth_columns, steep_columns) = (_sobel(side) for side in shape)
    right, down = smooth_rows @ small @ steep_columns.T, steep_rows @ small @ smooth_columns.T
    magnitude = (right * right + down * down).sqrt()
    scale = magnitude + 2.0 * (magnitude.sum() / float(np.prod(shape)))
    seen = scale > 0.0
    scale = where(seen, scale, 1.0)
    right, down = where(seen, right / scale, 0.0), where(seen, down / scale, 0.0)
    magnitude = maximum((right * right + down * down).sqrt(), 1e-6)
    layers = []
    for turn in 2 * np.pi * np.arange(N_DIRECTIONS) / N_DIRECTIONS:
        along = maximum(float(np.cos(turn)) * right + float(np.sin(turn)) * down, 0.0)
        layers.append((along * along / magnitude).reshape(1, *shape))
    pooled = maximum(_in_cells(family, concatenate(layers), shape), 0.0)
    total = pooled.sum()
    return where(total > 0.0, (pooled / maximum(total, 1e-300)).sqrt(), pooled).reshape(-1)


def _sobel(side: int) -> tuple[Array, Array]:
    """The matrices that smooth a line of pixels, and that take its slope, as ``cv2.Sobel``."""
    units, one = np.eye(side), np.ones(1)
    smooth = cv2.sepFilter2D(units, cv2.CV_64F, one, np.array([1.0, 2.0, 1.0]))
    steep = cv2.sepFilter2D(units, cv2.CV_64F, one, np.array([-1.0, 0.0, 1.0]))
    return np.asarray(smooth, float), np.asarray(steep, float)


def _intensities(family: IntensityMoments, grey: Value) -> Value:
    small, shape = _small(family, grey)
    n = int(np.prod(shape))
    ranked = small.reshape(n).sorted(n)
    place = WHITE_QUANTILE * (n - 1)
    low = int(place)
    white = ranked[low] + (place - low) * (ranked[min(low + 1, n - 1)] - ranked[low])
    scaled = where(white > 0.0, small / maximum(white, 1e-300), 0.0)
    levels = LEVELS.astype(float)
    scaled, step = scaled.clip(float(levels[0]), float(levels[-1])), float(levels[1] - levels[0])
    layers = []
    for level in levels.tolist():
        away = small.graph.apply("Abs", scaled - level)
        layers.append(maximum(1.0 - away / step, 0.0).reshape(1, *shape))
    return _in_cells(family, concatenate(layers), shape).sqrt().reshape(-1)
