"""Levels are as many, and of as high a degree, as the images allow."""

import re

import numpy as np
import pytest

from planar import RANGES, planar_images
from servoscope.data.schedule import RECOMMENDED, parse_schedule
from servoscope.errors import DataSetError
from servoscope.positioning.interaction import MARGIN
from servoscope.positioning.ladder import (
    HIGHEST_DEGREES,
    RATIO,
    held_out_errors,
    hold_out,
    learn_levels,
    plan_rungs,
)
from servoscope.positioning.polynomials import exponents

SIZE = 32


def displacements(schedule: str, seed: int = 0) -> np.ndarray:
    """Displacements drawn evenly from rings, in shares of the range."""
    rng = np.random.default_rng(seed)
    rings = parse_schedule(schedule)
    return np.vstack([f * rng.uniform(-1, 1, (n, 6)) for n, f in rings])


def planar_levels(schedule: str, seed: int = 0):
    p = displacements(schedule)
    images = planar_images(np.vstack([p, np.zeros(6)]) * RANGES, SIZE, seed=3)
    return learn_levels(images[:-1], p, images[-1], np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(3))
def test_the_recommended_rings_allow_levels_down_to_the_innermost(seed) -> None:
    text = ",".join(f"{n}@{factor}" for n, factor in RECOMMENDED)
    rungs = plan_rungs(displacements(text, seed))
    radii = [rung.radius for rung in rungs]
    assert radii[0] == 1
    assert rungs[0].degree == 4
    assert radii[-1] == pytest.approx(RECOMMENDED[-1].factor, rel=0.3)
    assert radii == sorted(radii, reverse=True)
    assert max(np.array(radii[:-1]) / radii[1:]) <= 1 / RATIO**3


@pytest.mark.parametrize("seed", range(3))
def test_the_rings_of_an_example_allow_levels_down_to_the_innermost(seed) -> None:
    rungs = plan_rungs(displacements("1000@1.0,400@0.2,400@0.03", seed))
    assert (rungs[0].radius, rungs[0].degree) == (1, 4)
    radii = np.array([rung.radius for rung in rungs])
    assert radii[-1] == pytest.approx(0.03, rel=0.3)
    assert np.min(np.abs(radii / 0.2 - 1)) < 0.3


def test_degrees_are_as_high_as_the_images_allow_and_no_higher() -> None:
    p = np.full((168, 6), 0.9)
    assert plan_rungs(p) == [(1.0, 3)]
    assert plan_rungs(p[:167]) == [(1.0, 2)]
    near = np.vstack([np.full((2 * len(exponents(4)), 6), x) for x in (0.9, 0.06)])
    assert [degree for _, degree in plan_rungs(near)][:2] == [4, 2]
    assert [degree for _, degree in HIGHEST_DEGREES] == [4, 3, 2]


@pytest.mark.parametrize("size", [0.05, 0.19, 0.26, 0.4])
def test_levels_lie_where_the_images_do(size: float) -> None:
    wide, narrow = np.full((120, 6), 0.9), np.full((120, 6), size)
    radii = np.array([rung.radius for rung in plan_rungs(np.vstack([wide, narrow]))])
    assert radii[0] == 1
    assert len(radii) > 1
    assert (size > 0.7 * radii[1:]).all()
    assert (size <= MARGIN * radii[1:]).all()
    assert (radii[1:] <= RATIO * radii[:-1]).all()
    assert len(plan_rungs(np.vstack([wide, narrow[:111]]))) == 1


@pytest.mark.parametrize("p", [np.full((111, 6), 0.9), np.full((900, 6), 0.3), np.zeros((0, 6))])
def test_too_few_wide_images_are_refused_in_a_line(p) -> None:
    with pytest.raises(DataSetError, match=r"at least \d+ images displaced by 70%") as info:
        plan_rungs(p)
    assert "\n" not in str(info.value)
    assert f"got {int((np.abs(p).max(axis=1, initial=0) > 0.7).sum())}" in str(info.value)


def test_every_tenth_image_is_held_out_once_and_disturbed() -> None:
    images = planar_images(displacements("100@0.5") * RANGES, SIZE, seed=3)
    p = displacements("100@0.5")
    held = hold_out(images, p, np.random.default_rng(0))
    kept = held.kept
    assert len(kept) == 90
    assert len(held.images) == len(held.disturbed) == len(held.p) == 10
    learned = {tuple(row) for row in p[kept]}
    assert not learned & {tuple(row) for row in held.p}
    assert (np.abs(held.images - held.disturbed.astype(float)).max(axis=(1, 2)) > 0).mean() > 0.8


def test_one_ring_alone_makes_levels_as_far_as_it_reaches() -> None:
    levels, held_out = planar_levels("400@1.0")
    assert levels[0].radius == 1
    errors = held_out_errors(levels[0], held_out.images, held_out.p)
    assert np.abs(errors).mean() < 0.1


def test_levels_narrow_and_their_errors_with_them() -> None:
    levels, held_out = planar_levels("300@1.0,250@0.2,150@0.03")
    errors = [
        np.abs(held_out_errors(level, held_out.images, held_out.p)).mean() for level in levels
    ]
    assert np.allclose([level.radius for level in levels], [1, 0.2, 0.03], rtol=0.3)
    assert errors[0] > 2 * errors[1]
    assert errors[0] > 2 * errors[2]
    assert all(level.std_factor >= 1 and level.unlikeness_limit > 0 for level in levels)
    assert all(np.isfinite([level.std_factor, level.unlikeness_limit]).all() for level in levels)


def test_a_level_is_judged_by_images_of_its_own_wherever_they_stand_in_the_data() -> None:
    levels, _ = planar_levels("300@1.0")
    inner, outer = displacements("60@0.03"), displacements("20@1.0")
    images = [planar_images(p * RANGES, SIZE, seed=3) for p in (inner, outer)]
    alone = held_out_errors(levels[0], images[1], outer)
    inner_first = held_out_errors(levels[0], np.concatenate(images), np.vstack([inner, outer]))
    assert alone.shape == inner_first.shape
    assert np.abs(inner_first).mean() > 0.5 * np.abs(alone).mean()


@pytest.mark.parametrize("seed", range(12))
def test_images_of_every_level_are_held_out_whatever_the_seed(seed) -> None:
    p = displacements("400@1.0,70@0.03")
    images = np.zeros((len(p), 4, 4), np.uint8)
    held_out = hold_out(images, p, np.random.default_rng(seed))
    inner = np.abs(held_out.p).max(axis=1) < 0.04
    assert 6 <= inner.sum() <= 7


@pytest.mark.parametrize("n_images", [0, 1, 9, 55])
def test_levels_of_too_few_images_are_refused(n_images, rng) -> None:
    p, images = np.full((n_images, 6), 0.9), np.zeros((n_images, 8, 8), np.uint8)
    with pytest.raises(DataSetError, match=rf"at least \d+ images .* got {n_images};"):
        learn_levels(images, p, np.zeros((8, 8), np.uint8), rng)


def test_as_many_images_as_are_asked_for_are_enough(rng) -> None:
    with pytest.raises(DataSetError) as info:
        plan_rungs(np.full((1, 6), 0.9))
    least = int(re.search(r"at least (\d+)", str(info.value))[1])
    p = rng.choice([-0.9, 0.9], (least, 6)) * rng.uniform(0.9, 1, (least, 6))
    images = planar_images(p * RANGES, 16, seed=3)
    levels, held_out = learn_levels(images, p, images[0], rng)
    assert (len(levels), len(held_out.p)) == (1, least // 10)
    with pytest.raises(DataSetError, match=f"got {least - 1};"):
        learn_levels(images[1:], p[1:], images[0], rng)


def test_no_pose_is_learned_from_and_held_out():
    p = np.repeat(np.random.default_rng(0).uniform(-1, 1, (40, 6)), 3, axis=0)
    images = np.zeros((120, 8, 8), np.uint8)
    held_out = hold_out(images, p, np.random.default_rng(0))
    kept = held_out.kept
    assert len(held_out.p) == 12
    assert not set(map(tuple, p[kept])) & set(map(tuple, held_out.p))


@pytest.mark.parametrize("schedule", ["260@1.0", "260@1.0,120@0.4"])
def test_without_images_near_the_reference_no_more_is_believed_there_than_is_true(schedule) -> None:
    levels, _ = planar_levels(schedule)
    p = 0.05 * np.random.default_rng(5).uniform(-1, 1, (20, 6))
    images = planar_images(p * RANGES, SIZE, seed=3)
    finest = levels[-1]
    found = [finest.align(image, np.zeros(6)) for image in images]
    errors = np.abs([finest.displacement(a) for a in found] - p)
    std = np.array([finest.std(a) for a in found])
    assert np.mean(errors <= 2 * std) > 0.8
