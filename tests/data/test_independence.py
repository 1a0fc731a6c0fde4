"""Independent images, sequences, and places that were visited again."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planar import PIVOT, RANGES
from real_sets import SEQUENCES, real_sequence
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import (
    FARTHEST_APART,
    REPEATED,
    independent_groups,
    mark_sequence,
    split_data,
    split_groups,
)
from servoscope.errors import InvalidInputError
from servoscope.poses import poses_from_displacements


def data_at(delta_p, **fields):
    n = len(delta_p)
    return PoseImageSet(
        np.zeros((n, 4, 4), np.uint8),
        poses_from_displacements(np.eye(4), delta_p, PIVOT),
        np.eye(4),
        np.zeros((4, 4), np.uint8),
        pivot=PIVOT,
        pivot_ranges=RANGES,
        **fields,
    )


def at_random(n=300, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES


def wandering(n=300, seed=0):
    steps = np.random.default_rng(seed).normal(size=(n + 40, 6))
    smooth = np.stack([np.convolve(s, np.hanning(41), "valid") for s in steps.T], axis=1)[:n]
    return smooth / np.abs(smooth).max(axis=0) * RANGES


@pytest.mark.parametrize("seed", range(5))
def test_poses_drawn_at_random_are_independent(seed):
    found = independent_groups(data_at(at_random(seed=seed)))
    assert found.kind == "independent"
    assert found.ratio == pytest.approx(1.0, abs=0.2)
    assert len(np.unique(found.labels)) == 300


@pytest.mark.parametrize("seed", range(5))
def test_a_moving_camera_makes_a_sequence(seed):
    found = independent_groups(data_at(wandering(seed=seed)))
    assert found.kind == "sequence"
    for label in range(found.labels.max() + 1):
        runs = np.diff(np.flatnonzero(found.labels == label))  # of images in their order
        assert np.mean(runs == 1) > 0.7
    assert 8 <= found.labels.max() + 1 <= 20


def test_a_sequence_is_to_be_split_by_blocks_by_whoever_gets_it_next():
    assert mark_sequence(data_at(wandering())).split == "blocks"
    independent = data_at(at_random())
    assert mark_sequence(independent) is independent


def test_times_put_a_sequence_into_order():
    order = np.random.default_rng(1).permutation(300)
    data = data_at(wandering()[order], times=order / 30.0)
    found = independent_groups(data)
    assert found.kind == "sequence"
    in_order = independent_groups(data_at(wandering()))
    np.testing.assert_array_equal(found.labels[np.argsort(order)], in_order.labels)


def test_a_set_that_says_blocks_is_a_sequence_whatever_its_poses():
    assert independent_groups(data_at(at_random(), split="blocks")).kind == "sequence"


def test_few_places_visited_again_are_seen_in_any_order():
    places = np.repeat(at_random(40), 8, axis=0)
    jitter = 0.01 * RANGES * np.random.default_rng(2).normal(size=places.shape)
    order = np.random.default_rng(3).permutation(len(places))
    assert independent_groups(data_at((places + jitter)[order])).kind == "revisited"


@pytest.mark.parametrize(("n", "passes"), [(60, 3), (100, 2), (400, 4)])
@pytest.mark.parametrize("jitter", [0.0, 3e-3])
def test_many_poses_that_are_visited_twice_are_independent_of_each_other(n, passes, jitter):
    rng, drawn = np.random.default_rng(0), at_random(n)
    often = [drawn + jitter * rng.normal(size=drawn.shape) * RANGES for _ in range(passes)]
    found = independent_groups(data_at(np.concatenate(often)))
    assert found.kind == "independent"
    np.testing.assert_array_equal(found.labels, np.tile(found.labels[:n], passes))
    assert len(np.unique(found.labels)) == n


def test_a_shuffled_sequence_is_not_taken_for_independent():
    order = np.random.default_rng(4).permutation(900)
    assert independent_groups(data_at(wandering(900)[order])).kind == "revisited"


def test_encoder_noise_of_dofs_that_stand_still_does_not_hide_a_sequence():
    delta_p = 1e-6 * np.random.default_rng(5).normal(size=(300, 6))
    delta_p[:, 0] += wandering()[:, 0]
    assert independent_groups(data_at(delta_p)).kind == "sequence"
    shuffled = np.random.default_rng(6).permutation(delta_p)
    assert (
        independent_groups(data_at(shuffled)).kind == "independent"
    )  # along a line all of it is covered


def test_stops_along_one_axis_are_places_that_were_visited_again():
    stops = np.zeros((300, 6))
    stops[:, 0] = np.random.default_rng(7).integers(0, 12, 300) * 2e-3
    stops[:, 0] += 1e-6 * np.random.default_rng(8).normal(size=300)
    found = independent_groups(data_at(stops))
    assert found.kind == "revisited"
    assert len(np.unique(found.labels)) == 12
    evenly = np.zeros((300, 6))
    evenly[:, 0] = np.random.default_rng(9).permutation(np.linspace(-1, 1, 300)) * RANGES[0]
    assert independent_groups(data_at(evenly)).kind == "independent"


@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_no_place_is_cut_in_two_where_there_are_few(jitter):
    place = np.random.default_rng(10).integers(0, 12, 240)
    delta_p = at_random(12)[place]
    delta_p += jitter * RANGES * np.random.default_rng(11).normal(size=delta_p.shape)
    found = independent_groups(data_at(delta_p))
    assert found.kind == "revisited"
    assert len(np.unique(found.labels)) == 12
    assert all(len(np.unique(found.labels[place == i])) == 1 for i in range(12))


def test_images_from_one_pose_among_independent_ones_stay_together():
    delta_p = at_random(200)
    delta_p[40:100] = delta_p[40]
    data = data_at(delta_p)
    found = independent_groups(data)
    assert found.kind == "independent"
    assert len(np.unique(found.labels[40:100])) == 1
    assert len(np.unique(found.labels)) == 141
    split = split_groups(data, found, seed=0)
    assert sum(bool(np.isin(np.arange(40, 100), part).any()) for part in vars(split).values()) == 1


def test_too_few_places_are_refused():
    data = data_at(at_random(5)[np.random.default_rng(12).integers(0, 5, 100)])
    with pytest.raises(InvalidInputError, match=r"at least 8 places.* got 5 of 100"):
        split_groups(data, independent_groups(data), seed=0)


def test_dofs_that_move_together_are_no_sign_of_dependence():
    delta_p = at_random()
    delta_p[:, 4] = delta_p[:, 0] / RANGES[0] * RANGES[4]
    assert independent_groups(data_at(delta_p)).kind == "independent"


@pytest.mark.parametrize(
    "poses", [at_random(), wandering(), np.repeat(at_random(40), 8, axis=0)[::-1]]
)
def test_no_group_is_in_two_parts_and_a_quarter_tests(poses):
    data = data_at(poses)
    found = independent_groups(data)
    split = split_groups(data, found, seed=0)
    parts = [set(found.labels[part]) for part in (split.train, split.validation, split.test)]
    assert not parts[0] & parts[1]
    assert not (parts[0] | parts[1]) & parts[2]
    assert 0.15 < len(split.test) / len(data) < 0.35


def test_a_set_that_never_moves_and_one_of_one_image_are_described():
    assert independent_groups(data_at(np.zeros((50, 6)))).kind == "independent"
    assert independent_groups(data_at(np.zeros((1, 6)))).kind == "independent"


def test_too_few_images_are_refused():
    data = data_at(at_random(59))
    with pytest.raises(InvalidInputError, match=r"at least 60 images .* got 59"):
        split_groups(data, independent_groups(data), seed=0)


def test_another_seed_tests_on_other_images():
    data = replace(data_at(wandering()), split="blocks")
    found = independent_groups(data)
    tests = [set(split_groups(data, found, seed).test) for seed in (0, 1)]
    assert tests[0] != tests[1]


def test_a_short_sequence_that_leaves_too_few_is_refused():
    data = data_at(wandering(60), split="blocks")
    with pytest.raises(InvalidInputError, match=r"depend on each other \(sequence\), \d+ and \d+"):
        split_groups(data, independent_groups(data), seed=1)


def gaps(data, labels):
    """Of images of different groups, the least largest difference of a dof in ranges."""
    p = data.delta_p() / data.ranges()
    apart = np.abs(p[:, None] - p[None]).max(axis=2)
    both = (labels[:, None] >= 0) & (labels[None] >= 0)
    across = both & (labels[:, None] != labels[None])
    return float(apart[across].min())


def of_kind(kind, rng):
    if kind == "random":
        return rng.uniform(-1, 1, (60, 6))
    if kind == "shots":
        p = np.repeat(rng.uniform(-1, 1, (20, 6)), 3, axis=0) + 1e-5 * rng.normal(size=(60, 6))
        return p[rng.permutation(60)]
    knots = rng.uniform(-1, 1, (13, 6))
    knots = np.concatenate([knots, knots]) if kind == "revisits" else knots
    at = np.linspace(0, len(knots) - 1, 240)
    p = np.stack([np.interp(at, np.arange(len(knots)), k) for k in knots.T], axis=1)
    return p[rng.permutation(240)] if kind == "shuffled" else p


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from(["random", "shots", "sequence", "revisits", "shuffled"]),
    seed=st.integers(0, 1000),
    n_groups=st.sampled_from([None, 2, 3, 4]),
)
def test_images_of_different_groups_are_farther_apart_than_stated(kind, seed, n_groups):
    data = data_at(of_kind(kind, np.random.default_rng(seed)) * RANGES)
    found = independent_groups(data, n_groups)
    kept = found.labels >= 0
    assert gaps(data, found.labels) > found.distance
    assert kept.mean() > 0.7
    assert found.distance >= (REPEATED if kind in ("random", "shots") else FARTHEST_APART / 8)
    if n_groups is not None:
        sizes = np.bincount(found.labels[kept])
        assert len(sizes) == n_groups
        assert sizes.min() * n_groups >= kept.sum() / 2


@settings(max_examples=30, deadline=None)
@given(
    kind=st.sampled_from(["random", "shots", "sequence", "revisits", "shuffled"]),
    seed=st.integers(0, 1000),
)
def test_no_test_image_has_a_twin_among_those_learned_from(kind, seed):
    data = data_at(of_kind(kind, np.random.default_rng(seed)) * RANGES)
    found, split = independent_groups(data), split_data(data, seed=seed)
    parts = np.full(len(data), -1)
    for i, part in enumerate((split.train, split.validation, split.test)):
        parts[part] = i
    assert gaps(data, parts) > found.distance
    assert 0.1 < len(split.test) / (parts >= 0).sum() < 0.4
    assert len(split.train) > 0.35 * len(data)


@pytest.mark.parametrize("name", SEQUENCES)
def test_real_sequences_leave_no_twins(name):
    data = real_sequence(name)
    found = independent_groups(data)
    assert found.kind == "sequence"
    assert found.distance == FARTHEST_APART
    assert gaps(data, found.labels) > found.distance
    delta_p = data.delta_p()
    for seed in range(3):
        split = split_data(data, seed=seed)
        apart = np.abs(delta_p[split.test, None] - delta_p[split.learned])
        twins = (apart[..., :3] < 2e-3).all(axis=2) & (apart[..., 3:] < np.radians(0.3)).all(axis=2)
        assert not twins.any()
        assert len(split.learned) > 0.5 * len(data)
        assert len(split.test) > 0.15 * len(data)


def test_a_split_of_every_third_frame_would_have_twins():
    data = data_at(wandering())
    labels = np.arange(300) // 3 % 3
    assert gaps(data, labels) < FARTHEST_APART / 2  # what the tests above would see


def test_shots_of_a_pose_are_in_one_group_wherever_they_stand():
    rng = np.random.default_rng(0)
    poses = np.arange(20).repeat(3)[rng.permutation(60)]
    labels = independent_groups(data_at(at_random(20)[poses]), 3).labels
    assert all(len(set(labels[poses == k])) == 1 for k in range(20))


def test_a_few_shots_repeated_with_the_jitter_of_an_arm_stay_together():
    delta_p = at_random(200)
    delta_p[100:104] = delta_p[:4] + 1e-3 * RANGES * np.random.default_rng(1).uniform(-1, 1, (4, 6))
    labels = independent_groups(data_at(delta_p)).labels
    np.testing.assert_array_equal(labels[100:104], labels[:4])
    assert len(np.unique(labels)) == 196


def test_noise_of_dofs_that_stand_still_does_not_hide_repeats():
    rng = np.random.default_rng(2)
    delta_p = np.zeros((240, 6))
    delta_p[:, [0, 1, 5]] = np.repeat(at_random(80)[:, [0, 1, 5]], 3, axis=0)
    delta_p += 1e-3 * RANGES * rng.normal(size=delta_p.shape)
    place = np.repeat(np.arange(80), 3)
    order = rng.permutation(240)
    labels = independent_groups(data_at(delta_p[order])).labels
    kept = labels >= 0
    assert kept.mean() > 0.7
    for k in range(80):
        assert len(set(labels[kept & (place[order] == k)])) <= 1


def test_what_a_sequence_returns_to_is_in_the_group_of_the_first_visit():
    there = np.linspace(-1, 1, 120)[:, None] * RANGES
    labels = independent_groups(data_at(np.concatenate([there, there]), split="blocks")).labels
    first, again = labels[:120], labels[120:]
    both = (first >= 0) & (again >= 0)
    assert both.mean() > 0.5
    np.testing.assert_array_equal(first[both], again[both])


def test_a_dense_sequence_is_kept_apart_as_far_as_it_allows():
    labels = independent_groups(data_at(np.linspace(-1, 1, 400)[:, None] * RANGES), 3).labels
    assert np.bincount(labels[labels >= 0]).min() > 60


def test_images_of_too_few_places_cannot_be_held_out():
    with pytest.raises(InvalidInputError, match="at least 3 different places"):
        independent_groups(data_at(np.ones((9, 1)) * RANGES), 3)


def test_shots_that_follow_each_other_from_one_pose_are_one_place_each():
    delta_p = np.repeat(np.random.default_rng(0).uniform(-1, 1, (16, 6)), 5, axis=0) * RANGES
    jitter = np.random.default_rng(1).normal(size=delta_p.shape) * 1e-5 * RANGES
    images = np.zeros((80, 4, 4), np.uint8)
    poses = poses_from_displacements(np.eye(4), delta_p + jitter, PIVOT)
    found = independent_groups(PoseImageSet(images, poses, np.eye(4), images[0], pivot=PIVOT))
    assert found.kind == "independent"
    np.testing.assert_array_equal(np.unique(found.labels, return_counts=True)[1], [5] * 16)
