"""Levels of the fine stage: from all of the reach down to the innermost images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
from servoscope.kernels import find_repeats
from servoscope.positioning.appearance import Appearance
from servoscope.positioning.interaction import MARGIN, LearnedInteraction, learn_interaction
from servoscope.positioning.polynomials import exponents
from servoscope.scene.disturbances import Disturbances

Array = NDArray[np.float64]
Images = NDArray[np.uint8]

RATIO = 0.6
"""The largest radius of a level relative to the one before it."""

BLURS = tuple(pixels / 256 for pixels in (24, 16, 12, 8, 5, 3, 2, 1))
"""Blurs that levels may have, [image widths], widest first."""

HIGH_PASS = 4.0
"""The high-pass of a level, if it helps, in its blurs."""

HIGHEST_DEGREES = ((0.5, 4), (0.1, 3), (0.0, 2))
"""The highest degree of a level's polynomials, from a radius on: near the reference low ones do."""

_RADII = [float(radius) for radius in 2.0 ** -np.arange(0, 12, 0.25)]
_SHELL = 0.7
_WIDE = 0.5
_NARROW = 0.2
_LEAST_IMAGES = 112
_IMAGES_PER_TERM = 2
_MOST_HELD_OUT = 40
_GUESS = 0.3
_NORMAL_MEDIAN = 0.6745
_NOISE = 3.0


class HeldOut(NamedTuple):
    """Images that no level learns from: as they are, and disturbed; and those that are kept."""

    images: Images
    disturbed: Images
    p: Array
    kept: NDArray[np.intp]


class Rung(NamedTuple):
    """A level to be learned: its radius, and the highest degree that its images allow."""

    radius: float
    degree: int


def plan_rungs(p: Array) -> list[Rung]:
    """The levels that displacements allow, widest first.

    Parameters
    ----------
    p : ndarray of shape (n_images, 6)
        Displacements in shares of the reach.

    Raises
    ------
    DataSetError
        If they do not even allow the widest.

    Examples
    --------
    >>> plan_rungs(np.full((168, 6), 0.9))
    [Rung(radius=1.0, degree=3)]
    """
    size = np.abs(p).max(axis=1)
    rungs: list[Rung] = []
    radii = [radius for radius in _RADII if _shell(size, radius) >= _images_needed(2)]
    while radii:
        near = [radius for radius in radii if radius >= radii[0] / 2] if rungs else radii[:1]
        radius = max(near, key=lambda radius: _shell(size, radius))
        rungs.append(Rung(radius, _degree(radius, _shell(size, radius))))
        radii = [narrower for narrower in radii if narrower <= RATIO * radius]
    if not rungs or rungs[0].radius < 1:
        least = _images_needed(2)
        raise DataSetError(
            f"Levels need at least {least} images displaced by {_SHELL:.0%} of the range or more, "
            f"got {int(np.sum(size > _SHELL))}; take more, or train a keyframe, which needs few."
        )
    return rungs


def has_images_for_levels(p: Array) -> bool:
    """Whether displacements in shares of the reach, (n_images, 6), allow the widest level."""
    return _shell(np.abs(p).max(axis=1), 1.0) >= _images_needed(2)


def _shell(size: Array, radius: float) -> int:
    """How many images lie near the border of a radius."""
    return int(np.sum((size > _SHELL * radius) & (size <= MARGIN * radius)))


def _degree(radius: float, n_images: int) -> int:
    highest = next(degree for least, degree in HIGHEST_DEGREES if radius >= least)
    return max(d for d in range(2, highest + 1) if d == 2 or n_images >= _images_needed(d))


def _images_needed(degree: int) -> int:
    return max(_LEAST_IMAGES, _IMAGES_PER_TERM * len(exponents(degree)))


def hold_out(
    images: Images, p: Array, rng: np.random.Generator, groups: NDArray[np.intp] | None = None
) -> HeldOut:
    """One of every ten images that are displaced about as far, or the first of the groups."""
    if groups is None:
        n_held = len(images) // 10
        tens = np.argsort(np.abs(p).max(axis=1), kind="stable")[: 10 * n_held].reshape(n_held, 10)
        held = np.sort(tens[np.arange(n_held), rng.integers(10, size=n_held)])
        poses = find_repeats(p, p)
        kept = np.flatnonzero(~np.isin(poses, poses[held]))
    else:
        held, kept = np.flatnonzero(groups == 0), np.flatnonzero(groups > 0)
    disturbances = Disturbances()
    disturbed = np.stack([disturbances.disturb(images[i], rng) for i in held])
    return HeldOut(images[held], disturbed, p[held], kept)


def learn_levels(
    images: Images,
    p: Array,
    reference_image: Images,
    rng: np.random.Generator,
    on_progress: Callable[[int], object] | None = None,
    groups: NDArray[np.intp] | None = None,
) -> tuple[list[LearnedInteraction], HeldOut]:
    """Learn every level, each with the blur that does best on held-out images.

    Parameters
    ----------
    images : ndarray of shape (n_images, height, width)
    p : ndarray of shape (n_images, 6)
        Displacements in shares of the reach.
    reference_image : ndarray of shape (height, width)
    rng : Generator
        Draws what is held out, and the disturbances.
    on_progress : callable, optional
        Called with the number of levels that are learned.
    groups : ndarray of shape (n_images,), optional
        Images of group 0 are held out, those of higher groups learned from; by default one image
        of ten is held out.

    Returns
    -------
    levels : list of LearnedInteraction
        Widest first.
    held_out : HeldOut
    """
    rungs = plan_rungs(p)
    held_out = hold_out(images, p, rng, groups)
    images, p = images[held_out.kept], p[held_out.kept]
    levels: list[LearnedInteraction] = []
    for rung in rungs:
        blurs = BLURS[:3]
        if levels:
            wider = levels[-1]
            least = 0.5 * wider.appearance.blur * rung.radius / wider.radius
            blurs = tuple(b for b in BLURS if least <= b <= wider.appearance.blur) or BLURS[-1:]
        candidates = [Appearance(blur) for blur in blurs]
        candidates += [Appearance(a.blur, HIGH_PASS * a.blur) for a in candidates]
        learned = [learn_interaction(images, p, *rung, appearance) for appearance in candidates]
        if rung is rungs[-1]:
            learned = [level.at_reference(reference_image) for level in learned]
        best = min(learned, key=lambda level: _held_out_error(level, held_out))
        levels.append(_calibrated(best, held_out))
        if on_progress is not None:
            on_progress(len(levels))
    if levels[-1].radius <= _NARROW:
        levels[-1] = _calibrated_by_noise(levels[-1], held_out, rng)
    return levels, held_out


def held_out_errors(level: LearnedInteraction, images: Images, p: Array) -> Array:
    """Errors of images from within the radius, in shares of the reach, (n, 6).

    The first guess is off by as much as a wider level's answer might be.
    """
    near = _near(level, p)
    guesses = p + _GUESS * level.radius * np.random.default_rng(0).uniform(-1, 1, p.shape)
    said = [level.displacement(level.align(images[i], guesses[i])) for i in near]
    return np.array(said).reshape(-1, 6) - p[near]


def _near(level: LearnedInteraction, p: Array) -> NDArray[np.intp]:
    """Images from within the radius: those that no narrower level would have, if there are any."""
    size = np.abs(p).max(axis=1)
    inside = np.flatnonzero(size <= level.radius)
    own = inside[size[inside] > RATIO * level.radius]
    return (own if own.size else inside)[:_MOST_HELD_OUT]


def _held_out_error(level: LearnedInteraction, held_out: HeldOut) -> float:
    """Mean largest error of a dof in shares of the radius, of clean and of disturbed images."""
    errors = [
        np.abs(held_out_errors(level, images, held_out.p)).max(axis=1) / level.radius
        for images in (held_out.images, held_out.disturbed)
    ]
    return float(np.mean(np.minimum(np.concatenate(errors), 1.0)))


def _calibrated(level: LearnedInteraction, held_out: HeldOut) -> LearnedInteraction:
    """The level with its standard deviations and its limit of unlikeness set by held-out images."""
    near = _near(level, held_out.p)
    alignments = [level.align(held_out.images[i], held_out.p[i]) for i in near]
    errors = np.array([level.displacement(a) for a in alignments]).reshape(-1, 6) - held_out.p[near]
    unlike = [a.unlikeness for a in alignments]
    unlike += [level.align(held_out.disturbed[i], held_out.p[i]).unlikeness for i in near]
    return replace(
        level,
        std_factor=_ratio(errors, [level.std(a) for a in alignments]),
        unlikeness_limit=_limit(unlike, level.radius),
    )


def _calibrated_by_noise(
    level: LearnedInteraction, held_out: HeldOut, rng: np.random.Generator
) -> LearnedInteraction:
    """The narrowest level, its standard deviations set by the scatter that noise alone makes.

    Where it ends its errors vanish with the displacement, all but those of noise; on held-out
    images they would hold those of the robot too. Without images near the reference they do not
    vanish, and the level keeps the deviations that held-out images showed.
    """
    scatter, std = [], []
    for i in _near(level, held_out.p):
        twins = held_out.images[i] + rng.normal(0.0, _NOISE, (2, *held_out.images[i].shape))
        one, other = (level.align(twin, held_out.p[i]) for twin in twins)
        scatter.append((level.displacement(one) - level.displacement(other)) / np.sqrt(2))
        std.append(level.std(one))
    return replace(level, std_factor=_ratio(np.array(scatter), std))


def _limit(unlike: list[float], radius: float) -> float:
    """The most unlike an image may be.

    At the widest levels, which tell whether it shows the part at all, it is halfway, in
    logarithms, to the 1 that tells nothing. At narrow ones noise alone comes near that.
    """
    usual = float(np.quantile(unlike, 0.95))
    return float(np.sqrt(min(usual, 0.95))) if radius >= _WIDE else 2 * usual


def _ratio(errors: Array, std: list[Array]) -> float:
    """How much larger errors are than their standard deviations, as these tell for a factor 1."""
    if not std:
        return 1.0
    return max(float(np.median(np.abs(errors) / np.array(std))) / _NORMAL_MEDIAN, 1.0)
