"""What cannot be right in a data set, or cannot be learned from it, and what to do about it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from servoscope.data.clock import ImagePairs, unexplained
from servoscope.data.image_motion import (
    camera_motions,
    explained_by_camera,
    image_shifts,
    nearest_pairs,
    parabola_vertex,
    shrink_all,
)
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import IndependentGroups, independent_groups
from servoscope.data.pixel_noise import estimate_pixel_noise
from servoscope.data.trajectory import Trajectory
from servoscope.dofs import mask_of
from servoscope.kernels.repeats import find_repeats
from servoscope.poses import DOFS, inverse_transform, pose_error
from servoscope.storage.stacks import blocks_of

IMAGE_FAULTS = ("black", "saturated", "flat", "repeated")
"""Why an image is of no use: nearly black, nearly all white, one grey, or the same as another that
was taken elsewhere, as of a camera that froze."""

BLACK_LEVEL, WHITE_LEVEL = 8, 254
"""Grey levels up to which an image is black, and from which pixels are saturated."""

MOST_SATURATED = 0.95
"""Share of saturated pixels above which an image is of no use."""

LEAST_CONTRAST = 1.0
"""Standard deviation of the grey levels, averaged over blocks, below which an image is flat."""

FAR_IN_PIVOTS, MEDIAN_FAR_IN_PIVOTS = 4.0, 2.0
"""How far from the reference cameras can be, the farthest and half of them, in distances of the
part."""

DEPENDENT = 0.99
"""Share of a dof's variance that is linear in the others, from which it does not move by itself."""

MOST_ROWS, MOST_SECONDS = 3, 0.3
"""Lags between images and poses that are tried."""

_PIXELS_LOOKED_AT = 2**18
_IMAGES_PER_BLOCK = 64
_MOST_VIEWED, _N_STRETCHES = 2000, 8
_NAMES_SHOWN = 3
_THUMBNAIL, _SMALLER, _TINY = 64, 32, 16
_HARDLY_VARIES = 1e-3  # of a variance of 1
_LEAST_PAIRS, _LEAST_ROWS = 40, 24
_MOST_LOOKED_AT = 400
_MOST_LAGS = 40
_STRIDES, _LEAST_SHIFT = (1, 2, 4), 0.7  # rows, pixels of a thumbnail

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a data set:

    its name, what it is and what to do in a sentence, what it was found by, as plain JSON values,
    and the images that it is about, if it is about some.
    """

    name: str
    text: str
    numbers: dict[str, Any] = field(default_factory=dict)
    images: tuple[str, ...] = ()


def check_data(
    data: PoseImageSet, faults: dict[str, NDArray[np.bool_]] | None = None
) -> list[Finding]:
    """What is wrong with a data set; an empty list if nothing is.

    Images that are of no use; poses that no part allows; dofs that only move together; images
    that differ though their poses are equal; shots of one pose; images behind their poses; poses
    that are inverted.

    Parameters
    ----------
    data : PoseImageSet
    faults : dict of ndarray, optional
        What `image_faults` finds in it, if that is known.

    Examples
    --------
    >>> images, poses = np.zeros((2, 8, 8), np.uint8), np.tile(np.eye(4), (2, 1, 1))
    >>> images[1, :4] = 200
    >>> data = PoseImageSet(images, poses, np.eye(4), images[0])
    >>> [finding.name for finding in check_data(data)]
    ['black', 'one_pose']
    """
    if faults is None:
        faults = image_faults(data.images, data.T_world_cam)
    found = [*_unusable(data, faults), *check_poses(data)]
    sound = np.flatnonzero(~np.any(list(faults.values()), axis=0))
    if len(sound) < 2 or not data.moves().any():
        return found
    view = _View(data.subset(sound))
    for check in (_dependent_dofs, _unlike_images, _repeated_shots, _late_images, _inverted_poses):
        found.extend(check(view))
    return found


def image_faults(
    images: NDArray[np.uint8], T_world_cam: NDArray[np.float64]
) -> dict[str, NDArray[np.bool_]]:
    """Which images are of no use, by reason of `IMAGE_FAULTS`; each image has one at most.

    The first of images that repeat is sound.

    Examples
    --------
    >>> images = np.zeros((2, 8, 8), np.uint8)
    >>> images[1, :, 4:] = 100
    >>> image_faults(images, np.stack([np.eye(4)] * 2))["black"]
    array([ True, False])
    """
    step = max(1, round(np.sqrt(math.prod(images.shape[1:]) / _PIXELS_LOOKED_AT)))
    parts, digests = [], []
    for block in blocks_of(images):
        for start in range(0, len(block), _IMAGES_PER_BLOCK):
            parts.append(_grey_levels(block[start : start + _IMAGES_PER_BLOCK, ::step, ::step]))
        digests += [blake2b(image.tobytes(), digest_size=16).digest() for image in block]
    bright, saturated, contrast = (np.concatenate(part) for part in zip(*parts, strict=True))
    black = bright <= BLACK_LEVEL
    white = ~black & (saturated > MOST_SATURATED)
    usual = np.median(contrast[~black & ~white]) if (~black & ~white).any() else 0.0
    flat = ~black & ~white & (contrast < min(LEAST_CONTRAST, max(0.25 * usual, 1e-9)))
    repeated = _repeated(digests, T_world_cam, ~(black | white | flat))
    return dict(zip(IMAGE_FAULTS, (black, white, flat, repeated), strict=True))


def fault_words(faults: dict[str, NDArray[np.bool_]], names: Iterable[str]) -> str:
    """How many images have which fault, with some of their names; empty if none has.

    Examples
    --------
    >>> fault_words({"black": np.array([True, False])}, ["a.png", "b.png"])
    '1 black (a.png)'
    """
    names = np.array(list(names), dtype=object)
    parts = []
    for reason, is_bad in faults.items():
        if is_bad.any():
            shown = names[is_bad].tolist()
            if len(shown) > _NAMES_SHOWN:
                shown = [*shown[: _NAMES_SHOWN - 1], "..."]
            parts.append(f"{is_bad.sum()} {reason} ({', '.join(shown)})")
    return ", ".join(parts)


def _unusable(data: PoseImageSet, faults: dict[str, NDArray[np.bool_]]) -> Iterator[Finding]:
    """Images of no use: the first finding speaks of all, by kind."""
    if not (words := fault_words(faults, data.names)):
        return
    advice = "take them anew, or leave them out by their names (PoseImageSet.without)"
    if _is_imported(data):
        advice = "import with --skip-bad leaves them out"
    counts = {reason: int(bad.sum()) for reason, bad in faults.items() if bad.any()}
    is_bad = np.any(list(faults.values()), axis=0)
    named = tuple(name for name, bad in zip(data.names, is_bad, strict=True) if bad)
    name = next(iter(counts)) if len(counts) == 1 else "unusable"
    text = f"Of {len(data)} images some are of no use: {words}; {advice}."
    yield Finding(name, text, counts, named)


def check_poses(data: PoseImageSet) -> list[Finding]:
    """What is wrong with the displacements of a data set.

    Cameras farther from the reference than the part lies before it do not see the part: usually the
    unit is wrong. Euler angles jump from 180 to -180 degrees, and about x and z where that about y
    comes near 90 degrees: such targets cannot be learned.
    """
    found, units, to_mm, to_deg = [], "", "", ""
    if _is_imported(data):
        units, to_mm, to_deg = " (--units mm?)", " with --max-mm", " with --max-deg"
    if len(data) > 1 and not data.moves().any():
        text = "All images have one pose: nothing can be learned from them; take them at others."
        found.append(Finding("one_pose", text))
    mm = 1e3 * pose_error(data.T_world_ref, data.T_world_cam)[0]
    part_mm = 1e3 * max(abs(data.pivot), 0.25)
    if mm.max() > FAR_IN_PIVOTS * part_mm or np.median(mm) > MEDIAN_FAR_IN_PIVOTS * part_mm:
        part = f", though the part is taken to be {1e3 * abs(data.pivot):.6g} mm before it"
        text = (
            f"Cameras are up to {mm.max():.6g} mm from the reference (half of them beyond "
            f"{np.median(mm):.6g} mm){part if data.pivot else ''}: check the units of the "
            f"positions{units}, or keep the near ones{to_mm}."
        )
        farthest = {"largest_mm": float(mm.max()), "median_mm": float(np.median(mm))}
        found.append(Finding("far_cameras", text, farthest))
    angles = np.degrees(data.delta_p()[:, 3:])
    for dof, values in zip(("rx", "rz"), angles[:, [0, 2]].T, strict=True):
        if values.max() > 135 and values.min() < -135:
            text = (
                f"Angles of {dof} wrap at 180 deg ({values.min():.1f} to {values.max():.1f} deg): "
                f"equal views get targets 360 deg apart; keep the near ones{to_deg}."
            )
            found.append(Finding("wrapped_angles", text, {"dof": dof}))
    if (steep := float(np.abs(angles[:, 1]).max())) > 80:
        text = (
            f"Angles of ry come to {steep:.1f} deg: near 90 deg rx and rz are not separable; "
            f"keep the near ones{to_deg}."
        )
        found.append(Finding("steep_angles", text, {"largest_deg": steep}))
    return found


def _is_imported(data: PoseImageSet) -> bool:
    """Whether a data set was made by `import`, whose options then help."""
    return "format" in data.source


class _View:
    """What several checks look at, each found once: sound images in the order of their times.

    Of very many these are stretches of neighbours, evenly spread in time.
    """

    def __init__(self, data: PoseImageSet) -> None:
        self.n_sound = len(data)
        order = (
            np.arange(len(data)) if data.times is None else np.argsort(data.times, kind="stable")
        )
        if len(order) > _MOST_VIEWED:
            each = _MOST_VIEWED // _N_STRETCHES
            starts = np.linspace(0, len(order) - each, _N_STRETCHES).round().astype(np.intp)
            order = order[(starts[:, None] + np.arange(each)).ravel()]
        self.data = data.subset(order)

    @cached_property
    def groups(self) -> IndependentGroups:
        return independent_groups(self.data)

    @property
    def is_sequence(self) -> bool:
        return self.groups.kind == "sequence"

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        return mask_of(self.data.dofs)

    @cached_property
    def p(self) -> Array:
        """Displacements of the dofs that move, in units of their spread."""
        delta_p = self.data.delta_p()[:, self.moving]
        return np.asarray((delta_p - delta_p.mean(axis=0)) / delta_p.std(axis=0))

    @cached_property
    def small(self) -> NDArray[np.float32]:
        return shrink_all(self.data.images, _THUMBNAIL)

    @cached_property
    def seconds(self) -> Array:
        """Times, or the number of each image."""
        times = self.data.times
        return np.arange(len(self.data), dtype=float) if times is None else times

    @cached_property
    def runs(self) -> Indices:
        """Number of the run of images at the usual rate that each image belongs to."""
        intervals = np.diff(self.seconds)
        usual = np.median(intervals)
        is_break = (intervals <= 0.5 * usual) | (intervals > 1.5 * usual)
        return np.concatenate([[0], np.cumsum(is_break)])

    def pairs_in_time(self) -> tuple[Indices, Indices, Array]:
        """Images, those a few rows later, and shifts between them that are large enough to read."""
        found = np.empty(0, np.intp), np.empty(0, np.intp), np.empty((0, 2))
        for stride in _STRIDES:
            first = np.flatnonzero(self.runs[:-stride] == self.runs[stride:])
            if len(first) < _LEAST_PAIRS:
                break
            shifts = image_shifts(self.small[first], self.small[first + stride])
            found = first, first + stride, shifts
            if np.median(np.abs(shifts).max(axis=1)) > _LEAST_SHIFT:
                break
        return found


def _dependent_dofs(view: _View) -> Iterator[Finding]:
    """Dofs that are linear in the others, so that no model can separate them."""
    p, names = view.p, [dof for dof, moves in zip(DOFS, view.moving, strict=True) if moves]
    if len(names) < 2 or len(p) < 4 * len(names):
        return
    fits = {dof: _regress(p, i) for i, dof in enumerate(names)}
    tied = {dof: round(share, 4) for dof, (share, _) in fits.items() if share > DEPENDENT}
    if not tied:
        return
    inliers = p[np.all([fits[dof][1] for dof in tied], axis=0)]
    varying = inliers[:, inliers.std(axis=0) > _HARDLY_VARIES]
    spreads = np.linalg.eigvalsh(np.atleast_2d(np.corrcoef(varying.T)))
    n_free = len(names) - max(1, int(np.sum(spreads < 1 - DEPENDENT)))
    text = (
        f"{', '.join(tied)} only move{'s' * (len(tied) == 1)} together with others (R2 "
        f"{min(tied.values()):.3f} or more): {len(names)} degrees of freedom move, but by {n_free} "
        f"independent motion{'s' * (n_free > 1)}. No model can separate them; take images in which "
        "each moves by itself, or ask for fewer."
    )
    yield Finding("dependent_dofs", text, {"r2": tied, "n_independent": n_free})


def _regress(p: Array, i: int) -> tuple[float, NDArray[np.bool_]]:
    """Adjusted R2 of one column on the others, of 19 of 20 rows, and which these are."""
    A = np.column_stack([np.delete(p, i, axis=1), np.ones(len(p))])
    kept = np.ones(len(p), dtype=bool)
    for _ in range(3):
        residuals = p[:, i] - A @ np.linalg.lstsq(A[kept], p[kept, i], rcond=None)[0]
        kept = np.abs(residuals) <= np.quantile(np.abs(residuals), 0.95)
    variance = p[kept, i].var(ddof=1)
    if variance < _HARDLY_VARIES:
        return 0.0, kept
    n, k = int(kept.sum()), A.shape[1]
    return float(1 - np.square(residuals[kept]).sum() / max(n - k, 1) / variance), kept


def _unlike_images(view: _View) -> Iterator[Finding]:
    """Images of one pose that differ by more than noise and light."""
    pairs = _shots_of_one_pose(view)
    if not len(pairs):
        return
    n, small = len(view.data), shrink_all(view.data.images, _SMALLER)
    far = np.arange(n), (np.arange(n) + n // 2) % n
    usual = float(np.median(_differences(small[far[0]], small[far[1]])))
    some = view.data.images[:: -(-n // 30)]
    noise = float(np.quantile([estimate_pixel_noise(image) for image in some], 0.9))
    pixels = view.data.images[0].size / small[0].size
    limit = max(0.1 * usual, 2.5 * max(noise, 0.3) / np.sqrt(pixels))
    apart = _differences(small[pairs[:, 0]], small[pairs[:, 1]])
    if not (unlike := apart > limit).any():
        return
    names = [view.data.names[int(i)] for i in pairs[np.argmax(apart)]]
    text = (
        f"Of {len(pairs)} pairs of images from equal poses {unlike.sum()} differ by more than "
        f"noise and light (up to {apart.max():.1f} grey levels, {names[0]} and {names[1]}; images "
        f"of different poses by {usual:.1f}): was the part moved, or something in the view? Leave "
        "out those from before or after."
    )
    numbers = {"n_unlike": int(unlike.sum()), "n_pairs": len(pairs), "grey": float(apart.max())}
    images = {view.data.names[int(i)] for pair in pairs[unlike] for i in pair}
    yield Finding("unlike_images", text, numbers, tuple(sorted(images)))


def _shots_of_one_pose(view: _View) -> Indices:
    """Pairs of images whose poses are equal up to the repeatability of a robot, (n, 2)."""
    if view.is_sequence:
        rounded = view.data.delta_p().round(9)
        labels = np.unique(rounded, axis=0, return_inverse=True)[1].ravel()
    else:
        labels = view.groups.labels if view.groups.kind == "independent" else _near(view)
    order = np.argsort(labels, kind="stable")
    same = labels[order[1:]] == labels[order[:-1]]
    return np.column_stack([order[:-1], order[1:]])[same]


def _near(view: _View) -> Indices:
    """Places of a set that was taken at places visited again, however many they are."""
    return find_repeats(view.p, view.p)


def _differences(a: NDArray[np.float32], b: NDArray[np.float32]) -> Array:
    """RMS of what is left of one image once gain and offset fit it to the other, by pair."""
    x, y = (part.reshape(len(part), -1).astype(float) for part in (a, b))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    gain = (x * y).sum(axis=1) / np.maximum((x * x).sum(axis=1), 1e-9)
    return np.asarray(np.sqrt(np.square(y - gain[:, None] * x).mean(axis=1)))


def _repeated_shots(view: _View) -> Iterator[Finding]:
    """Images that repeat the pose of another one; of a sequence, they only follow slowly."""
    if view.is_sequence or not (n_repeats := len(_shots_of_one_pose(view))):
        return
    n = len(view.data)
    among = "" if n == view.n_sound else f" that were looked at, of {view.n_sound},"
    text = (
        f"{n_repeats} of {n} images{among} repeat the pose of another one: {n - n_repeats} "
        "different poses. Shots of one pose count as one, and are tested on together; take more "
        "poses."
    )
    yield Finding("repeated_shots", text, {"n_repeats": n_repeats, "n_poses": n - n_repeats})


def _late_images(view: _View) -> Iterator[Finding]:
    """Images that fit the poses of other rows, or of another time, far better than their own."""
    unit = "rows" if view.data.times is None or not view.is_sequence else "s"
    lags, left = _lags_of_sequence(view) if view.is_sequence else _lags_in_rows(view)
    if not len(lags):
        return
    best, own = int(np.argmin(left)), int(np.argmin(np.abs(lags)))
    most, better = (0.5, 1.5) if view.is_sequence else (0.6, 1.8)
    if left[best] > most or left[own] < better * left[best] or best == own:
        return
    lag, before, after = float(lags[best]), min(float(left[own]), 1.0), float(left[best])
    if unit == "s":
        if 0 < best < len(lags) - 1:
            lag += (lags[1] - lags[0]) * parabola_vertex(*left[best - 1 : best + 2])
        how = f"{1e3 * abs(lag):.0f} ms"
    else:
        how = f"{abs(lag):.0f} row{'s' * (abs(lag) > 1)}"
    where, whose = ("behind", "before") if lag > 0 else ("ahead of", "after")
    text = (
        f"Images seem to be {how} {where} their poses: {100 * before:.0f} % of what they show is "
        f"unexplained as they are, {100 * after:.0f} % if each gets the pose of {how} {whose}; "
        "join them anew so, or take images at rest, and none that the camera still held."
    )
    numbers = {"lag": float(lag), "unit": unit, "unexplained": before, "unexplained_then": after}
    yield Finding("late_images", text, numbers)


def _lags_of_sequence(view: _View) -> tuple[Array, Array]:
    """Lags, and the share of the shifts between neighbours that the motions then do not explain."""
    first, second, shifts = view.pairs_in_time()
    if not len(first):
        return np.empty(0), np.empty(0)
    usual, n = float(np.median(np.diff(view.seconds))), MOST_ROWS
    step = usual
    if view.data.times is not None:
        n = max(n, min(int(np.ceil(MOST_SECONDS / usual)), _MOST_LAGS))
        step = max(usual, MOST_SECONDS / _MOST_LAGS)
        n += 1  # so that the farthest is between others
    pairs = ImagePairs(view.seconds[first], view.seconds[second], shifts)
    lags = np.asarray(step * np.arange(-n, n + 1), dtype=np.float64)
    left = unexplained(pairs, Trajectory(view.seconds, view.data.T_world_cam), lags, usual)
    return lags[np.isfinite(left)], left[np.isfinite(left)]


def _lags_in_rows(view: _View) -> tuple[Array, Array]:
    """Lags, and the error of the best-predicted dof as a share of the variance.

    Each image is predicted from all others by a Gaussian kernel on tiny images.
    """
    n, m = len(view.data), MOST_ROWS
    rows = np.arange(m, n - m)[:: -(-max(n - 2 * m, 1) // _MOST_LOOKED_AT)]
    if len(rows) < _LEAST_ROWS or view.groups.kind != "independent":
        return np.empty(0), np.empty(0)
    rows = rows[np.sort(np.unique(view.groups.labels[rows], return_index=True)[1])]
    tiny = shrink_all(view.data.images[rows], _TINY).reshape(len(rows), -1)
    tiny = (tiny - tiny.mean(axis=0)) / max(float(tiny.std()), 1e-6)
    squared = cdist(tiny, tiny, "sqeuclidean")
    kernel = np.exp(-squared / (2 * np.median(squared)))
    lags = np.arange(-m, m + 1.0)
    left = np.full(len(lags), np.inf)
    for ridge in (1e-3, 1e-2, 1e-1):
        inverse = np.linalg.inv(kernel + ridge * np.eye(len(rows)))
        for k, lag in enumerate(lags):
            y = view.p[rows - int(lag)]
            y = (y - y.mean(axis=0)) / np.maximum(y.std(axis=0), 1e-9)
            errors = (inverse @ y) / np.diag(inverse)[:, None]
            left[k] = min(left[k], float(np.square(errors).mean(axis=0).min()))
    return lags, left


def _inverted_poses(view: _View) -> Iterator[Finding]:
    """Poses that map the world to the camera: shifts of the images fit their inverses alone."""
    if view.is_sequence:
        first, second, shifts = view.pairs_in_time()
    else:
        first, second = nearest_pairs(view.p, max(100, len(view.data) // 2))
        shifts = image_shifts(view.small[first], view.small[second])
    if len(first) < _LEAST_PAIRS:
        return
    given, inverse = (
        explained_by_camera(camera_motions(T, first, second), shifts)
        for T in (view.data.T_world_cam, inverse_transform(view.data.T_world_cam))
    )
    if inverse < 0.85 or given > 0.4:
        return
    text = (
        f"Poses look inverted: a camera at them would see {100 * max(given, 0):.0f} % of how the "
        f"images shift, one at their inverses {100 * inverse:.0f} %. T_world_cam maps camera "
        "coordinates to the world; invert them"
    )
    if _is_imported(view.data):
        options = view.data.source.get("options")
        was_inverse = isinstance(options, dict) and options.get("direction") == "world-to-camera"
        other = "camera-to-world" if was_inverse else "world-to-camera"
        text += f", or import with --direction {other}"
    text += "."
    yield Finding("inverted_poses", text, {"explained": given, "explained_inverted": inverse})


def _grey_levels(images: NDArray[np.uint8]) -> tuple[NDArray[Any], ...]:
    """The level below which 99 % of the pixels lie, share of saturated ones, and contrast."""
    n_images, height, width = images.shape
    n_pixels, side = height * width, max(1, min(height, width) // 8)
    flat = images.reshape(n_images, -1)
    nearly_all = int(0.99 * (n_pixels - 1))
    bright = np.partition(flat, nearly_all, axis=1)[:, nearly_all].copy()  # not the whole
    saturated = (flat >= WHITE_LEVEL).mean(axis=1)
    rows, columns = height // side, width // side
    blocks = images[:, : rows * side, : columns * side].reshape(n_images, rows, side, columns, side)
    contrast = blocks.mean(axis=(2, 4), dtype=np.float32).std(axis=(1, 2))
    return bright, saturated, contrast


def _repeated(
    digests: list[bytes], T_world_cam: NDArray[np.float64], sound: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which sound images equal an earlier one that was taken from another pose."""
    by_content: dict[bytes, list[int]] = defaultdict(list)
    for i in np.flatnonzero(sound):
        by_content[digests[i]].append(int(i))
    repeated = np.zeros(len(digests), dtype=bool)
    for first, *others in by_content.values():
        moved = np.abs(T_world_cam[others] - T_world_cam[first]).max(axis=(1, 2), initial=0.0)
        repeated[others] = moved > 1e-6
    return repeated
