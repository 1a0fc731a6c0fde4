"""Which pixels inform which degree of freedom, and how well each pixel is explained."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.features import PoseImageCovariance
from servoscope.keyframe import Keyframe, ViewLimit
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.report.figure import DPI, INK, NORMAL, SMALL, new_axes, to_svg
from servoscope.storage.folders import write_atomically

Array = NDArray[Any]

_SMOOTH = 0.008
"""Blur of the shares, [image widths]: single pixels could not be seen."""

_PAPER = 0.75
_BAR: dict[str, Any] = {"orientation": "vertical", "fraction": 0.05, "pad": 0.02}


def plot_shares(
    shares: Array, reference_image: Array, *, title: str = "", ax: Axes | None = None
) -> Axes:
    """Where a dof is read: the darker, the more a pixel contributes, on a pale reference image.

    Parameters
    ----------
    shares : ndarray of shape (rows, columns)
        What each pixel contributes, of any resolution; they need not sum to 1.
    reference_image : ndarray of shape (height, width), uint8
    """
    ax = new_axes() if ax is None else ax
    relative = shares / max(float(shares.mean()), 1e-300)
    smooth = cv2.GaussianBlur(relative.astype(np.float32), (0, 0), _SMOOTH * shares.shape[1])
    top = max(float(np.quantile(smooth, 0.995)), 1e-6)
    pale = _PAPER + (1 - _PAPER) * reference_image / 255
    height, width = reference_image.shape
    extent = (0, width, height, 0)
    ax.imshow(pale, cmap="gray", vmin=0, vmax=1, extent=extent)
    alpha = np.clip(smooth / top, 0, 1)
    drawn = ax.imshow(smooth, cmap="Greys", vmin=0, vmax=top, alpha=alpha, extent=extent)
    return _finish(ax, drawn, title, "times an average pixel")


def plot_map(
    values: Array,
    *,
    title: str,
    unit: str,
    cmap: str = "gray",
    ax: Axes | None = None,
    **limits: Any,
) -> Axes:
    """Values over the reference image, of any resolution; white where there is none."""
    ax = new_axes() if ax is None else ax
    height, width = values.shape
    drawn = ax.imshow(values, cmap=cmap, extent=(0, width, height, 0), **limits)
    return _finish(ax, drawn, title, unit)


def _finish(ax: Axes, drawn: Any, title: str, unit: str) -> Axes:
    ax.set_title(title, fontsize=NORMAL, color=INK, pad=3)
    ax.set_xticks([])
    ax.set_yticks([])
    if unit:
        bar = ax.figure.colorbar(drawn, ax=ax, **_BAR)
        bar.set_label(unit, fontsize=SMALL, color=INK)
        bar.ax.tick_params(labelsize=SMALL - 1, length=2)
    return ax


def draw_keyframe(
    keyframe: Keyframe,
    *,
    residual: Array | None = None,
    covariance_images: Array | None = None,
) -> Figure:
    """A keyframe as a figure: its view, what explains it, and which pixels inform which dof.

    Parameters
    ----------
    keyframe : Keyframe
    residual : ndarray of shape (rows, columns), optional
        Of images that were held out, in multiples of the noise.
    covariance_images : ndarray of shape (6, height, width), optional
        Pose-image covariance of the data set, to be shown below.

    Returns
    -------
    matplotlib.figure.Figure
        The upper row shows the reference image, distance, trust and residual; the next ones what
        each pixel contributes to the limit of each dof, and the square of its covariance.
    """
    limit, is_read = keyframe.limit(), mask_of(keyframe.dofs)
    height, width = keyframe.reference_image.shape
    rows = 2 if covariance_images is None else 3
    figure = Figure(
        figsize=(14, rows * (2.1 * height / width + 0.35)), facecolor="white", layout="constrained"
    )
    parts: Any = figure.subfigures(rows, 1, height_ratios=[1.1] + [1.0] * (rows - 1))
    _draw_view(parts[0], keyframe, residual)
    titles = [title for title in _limit_titles(limit) if title[:2] in keyframe.dofs]
    _draw_dofs(parts[1], limit.shares[is_read], keyframe.reference_image, titles)
    parts[1].suptitle(
        "Where each dof is read, and its limit in one image (standard deviation)",
        fontsize=NORMAL + 1,
        color=INK,
    )
    if covariance_images is not None:
        squares = covariance_images[is_read] ** 2
        _draw_dofs(parts[2], squares, keyframe.reference_image, list(keyframe.dofs))
        parts[2].suptitle(
            "Pose-image covariance of the data set, squared", fontsize=NORMAL + 1, color=INK
        )
    return figure


def _limit_titles(limit: ViewLimit) -> list[str]:
    values = zip(DOFS, limit.std * DISPLAY_FACTORS, DISPLAY_UNITS, strict=True)
    return [f"{dof}: {value:.2g} {unit}" for dof, value, unit in values]


def _draw_view(figure: Any, keyframe: Keyframe, residual: Array | None) -> None:
    axes = figure.subplots(1, 3 if residual is None else 4)
    plot_map(
        keyframe.reference_image, title="reference image", unit="grey level", vmin=0, vmax=255,
        ax=axes[0],
    )  # fmt: skip
    if keyframe.observable["depth"]:
        distance = 1 / keyframe.inverse_depth
        low, high = np.quantile(distance, [0.01, 0.99])
        plot_map(distance, title="distance", unit="m", vmin=low, vmax=high, ax=axes[1])
    else:
        plot_map(
            np.full((2, 2), np.nan), title="distance: not observable", unit="", ax=axes[1]
        )  # nothing is known
    plot_map(
        keyframe.trust, title="agreement of the images", unit="mean weight", vmin=0, vmax=1,
        ax=axes[2],
    )  # fmt: skip
    if residual is not None:
        residual = np.where(residual < 0, np.nan, residual)
        seen = residual[np.isfinite(residual)]
        top = float(np.quantile(seen, 0.99)) if seen.size else 1.0
        plot_map(
            residual, title="residual of held-out images", unit="times the noise", cmap="Greys",
            vmin=0, vmax=top, ax=axes[3],
        )  # fmt: skip


def _draw_dofs(figure: Any, shares: Array, reference_image: Array, titles: list[str]) -> None:
    axes = figure.subplots(1, len(titles), squeeze=False)[0]
    for ax, part, title in zip(axes, shares, titles, strict=True):
        plot_shares(part, reference_image, title=title, ax=ax)


def write_keyframe(
    file: Path,
    keyframe: Keyframe,
    *,
    residual: Array | None = None,
    data: PoseImageSet | None = None,
) -> None:
    """Write `draw_keyframe` as a PNG or an SVG file, whole or not at all.

    Raises
    ------
    InvalidInputError
        If the file is named neither ``.png`` nor ``.svg``, or the images of the data set are of
        another size.
    """
    if file.suffix.lower() not in (".png", ".svg"):
        raise InvalidInputError(
            f"A figure is a PNG or SVG file, got {file}; name it {file.stem}.png."
        )
    pictures = None
    if data is not None:
        if data.image_shape != keyframe.reference_image.shape:
            raise InvalidInputError(
                f"The images of the data set must be as large as those of the model, got "
                f"{data.image_shape} and {keyframe.reference_image.shape}; name its own data set."
            )
        components = PoseImageCovariance().fit(data.images, data.delta_p()).components_
        pictures = components.reshape(-1, *data.image_shape)
    figure = draw_keyframe(keyframe, residual=residual, covariance_images=pictures)
    FigureCanvasAgg(figure)
    if file.suffix.lower() == ".svg":
        write_atomically(file, lambda out: out.write(to_svg(figure)))
        return
    write_atomically(file, lambda out: figure.savefig(out, format="png", dpi=DPI))
