"""Independent images, sequences, and places that were visited again."""

from dataclasses import replace

import numpy as np
import pytest

from planar import PIVOT, RANGES
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import find_groups, mark_sequence, split_groups
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
    found = find_groups(data_at(at_random(seed=seed)))
    assert found.kind == "independent"
    assert found.ratio == pytest.approx(1.0, abs=0.2)
    assert len(np.unique(found.groups)) == 300


@pytest.mark.parametrize("seed", range(5))
def test_a_moving_camera_makes_a_sequence(seed):
    found = find_groups(data_at(wandering(seed=seed)))
    assert found.kind == "sequence"
    assert (np.diff(found.groups) >= 0).all()  # runs of images in their order
    assert len(np.unique(found.groups)) == 20


def test_a_sequence_is_to_be_split_by_blocks_by_whoever_gets_it_next():
    assert mark_sequence(data_at(wandering())).split == "blocks"
    independent = data_at(at_random())
    assert mark_sequence(independent) is independent


def test_times_put_a_sequence_into_order():
    order = np.random.default_rng(1).permutation(300)
    data = data_at(wandering()[order], times=order / 30.0)
    found = find_groups(data)
    assert found.kind == "sequence"
    assert (np.diff(found.groups[np.argsort(order)]) >= 0).all()


def test_a_set_that_says_blocks_is_a_sequence_whatever_its_poses():
    assert find_groups(data_at(at_random(), split="blocks")).kind == "sequence"


def test_few_places_visited_again_are_seen_in_any_order():
    places = np.repeat(at_random(40), 8, axis=0)
    jitter = 0.01 * RANGES * np.random.default_rng(2).normal(size=places.shape)
    order = np.random.default_rng(3).permutation(len(places))
    assert find_groups(data_at((places + jitter)[order])).kind == "revisited"


def test_a_shuffled_sequence_is_not_taken_for_independent():
    order = np.random.default_rng(4).permutation(900)
    assert find_groups(data_at(wandering(900)[order])).kind == "revisited"


def test_encoder_noise_of_dofs_that_stand_still_does_not_hide_a_sequence():
    delta_p = 1e-6 * np.random.default_rng(5).normal(size=(300, 6))
    delta_p[:, 0] += wandering()[:, 0]
    assert find_groups(data_at(delta_p)).kind == "sequence"
    shuffled = np.random.default_rng(6).permutation(delta_p)
    assert find_groups(data_at(shuffled)).kind == "independent"  # along a line all of it is covered


def test_stops_along_one_axis_are_places_that_were_visited_again():
    stops = np.zeros((300, 6))
    stops[:, 0] = np.random.default_rng(7).integers(0, 12, 300) * 2e-3
    stops[:, 0] += 1e-6 * np.random.default_rng(8).normal(size=300)
    found = find_groups(data_at(stops))
    assert found.kind == "revisited"
    assert len(np.unique(found.groups)) == 12
    evenly = np.zeros((300, 6))
    evenly[:, 0] = np.random.default_rng(9).permutation(np.linspace(-1, 1, 300)) * RANGES[0]
    assert find_groups(data_at(evenly)).kind == "independent"


@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_no_place_is_cut_in_two_where_there_are_few(jitter):
    place = np.random.default_rng(10).integers(0, 12, 240)
    delta_p = at_random(12)[place]
    delta_p += jitter * RANGES * np.random.default_rng(11).normal(size=delta_p.shape)
    found = find_groups(data_at(delta_p))
    assert found.kind == "revisited"
    assert len(np.unique(found.groups)) == 12
    assert all(len(np.unique(found.groups[place == i])) == 1 for i in range(12))


def test_images_from_one_pose_among_independent_ones_stay_together():
    delta_p = at_random(200)
    delta_p[40:100] = delta_p[40]
    data = data_at(delta_p)
    found = find_groups(data)
    assert found.kind == "independent"
    assert len(np.unique(found.groups[40:100])) == 1
    assert len(np.unique(found.groups)) == 141
    split = split_groups(data, found, seed=0)
    assert sum(bool(np.isin(np.arange(40, 100), part).any()) for part in vars(split).values()) == 1


def test_too_few_places_are_refused():
    data = data_at(at_random(5)[np.random.default_rng(12).integers(0, 5, 100)])
    with pytest.raises(InvalidInputError, match=r"at least 8 places.* these 100 are from 5"):
        split_groups(data, find_groups(data), seed=0)


def test_dofs_that_move_together_are_no_sign_of_dependence():
    delta_p = at_random()
    delta_p[:, 4] = delta_p[:, 0] / RANGES[0] * RANGES[4]
    assert find_groups(data_at(delta_p)).kind == "independent"


@pytest.mark.parametrize(
    "poses", [at_random(), wandering(), np.repeat(at_random(40), 8, axis=0)[::-1]]
)
def test_no_group_is_in_two_parts_and_a_quarter_tests(poses):
    data = data_at(poses)
    found = find_groups(data)
    split = split_groups(data, found, seed=0)
    parts = [set(found.groups[part]) for part in (split.train, split.validation, split.test)]
    assert not parts[0] & parts[1]
    assert not (parts[0] | parts[1]) & parts[2]
    assert 0.15 < len(split.test) / len(data) < 0.35


def test_a_set_that_never_moves_and_one_of_one_image_are_described():
    assert find_groups(data_at(np.zeros((50, 6)))).kind == "independent"
    assert find_groups(data_at(np.zeros((1, 6)))).kind == "independent"


def test_too_few_images_are_refused():
    data = data_at(at_random(59))
    with pytest.raises(InvalidInputError, match=r"at least 60 images .* got 59"):
        split_groups(data, find_groups(data), seed=0)


def test_another_seed_tests_on_other_images():
    data = replace(data_at(wandering()), split="blocks")
    found = find_groups(data)
    tests = [set(split_groups(data, found, seed).test) for seed in (0, 1)]
    assert tests[0] != tests[1]


def test_a_short_sequence_that_leaves_too_few_is_refused():
    data = data_at(wandering(60), split="blocks")
    with pytest.raises(InvalidInputError, match=r"depend on each other \(sequence\), 38 and 10"):
        split_groups(data, find_groups(data), seed=1)
