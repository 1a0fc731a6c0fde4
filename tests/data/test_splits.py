import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servoscope.data.images import PoseImageSet
from servoscope.data.independence import FARTHEST_APART, independent_groups
from servoscope.data.splits import split_images
from servoscope.errors import InvalidInputError
from servoscope.poses import poses_from_displacements

seeds = st.integers(0, 2**31)


@given(st.integers(8, 400), seeds)
def test_a_random_split_uses_every_image_once(n_images, seed):
    split = split_images(n_images, "honest", seed)
    parts = [split.train, split.validation, split.test]
    assert np.sort(np.concatenate(parts)).tolist() == list(range(n_images))
    assert all(len(part) for part in parts)


@pytest.mark.parametrize("n_images", [100, 1000])
def test_shares_are_60_15_25_and_the_paper_trains_on_75(n_images):
    honest, paper = split_images(n_images, "honest"), split_images(n_images, "paper")
    lengths = [len(part) / n_images for part in (honest.train, honest.validation, honest.test)]
    assert lengths == [0.60, 0.15, 0.25]
    assert len(paper.train) == 0.75 * n_images


@given(st.integers(40, 400), seeds, st.booleans())
def test_both_protocols_test_on_the_same_images(n_images, seed, by_time):
    times = np.arange(n_images) if by_time else None
    honest = split_images(n_images, "honest", seed, times)
    paper = split_images(n_images, "paper", seed, times)
    np.testing.assert_array_equal(paper.test, honest.test)
    np.testing.assert_array_equal(paper.validation, paper.test)
    assert set(paper.train) == set(honest.train) | set(honest.validation)
    assert not set(paper.train) & set(paper.test)


@given(st.integers(40, 400), seeds)
def test_blocks_keep_training_away_from_its_neighbours_in_time(n_images, seed):
    times = np.random.default_rng(seed).permutation(n_images).astype(float)
    split = split_images(n_images, "honest", seed, times)
    purpose = {}
    for name in ("train", "validation", "test"):
        for time in times[getattr(split, name)]:
            assert purpose.setdefault(time, name) == name
    for time, name in purpose.items():
        assert purpose.get(time + 1, name) == name


@given(st.integers(40, 400), seeds)
def test_blocks_leave_out_little_and_no_part_is_empty(n_images, seed):
    split = split_images(n_images, "honest", seed, times=np.arange(n_images))
    lengths = [len(split.train), len(split.validation), len(split.test)]
    assert min(lengths) > 0
    assert sum(lengths) >= n_images - 20 * max(1, -(-n_images // 20) // 10)


@pytest.mark.parametrize("times", [None, np.arange(200)])
def test_one_seed_gives_one_split_and_another_gives_another(times):
    a, b, other = (split_images(200, "honest", seed, times) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.train, b.train)
    np.testing.assert_array_equal(a.test, b.test)
    assert set(a.test) != set(other.test)


def test_an_unknown_protocol_is_refused():
    with pytest.raises(InvalidInputError, match="one of paper, honest, got 'lucky'"):
        split_images(100, "lucky")


@pytest.mark.parametrize(("n_images", "times", "least"), [(7, None, 8), (39, np.arange(39), 40)])
def test_too_few_images_are_refused(n_images, times, least):
    with pytest.raises(InvalidInputError, match=f"needs at least {least} images, got {n_images}"):
        split_images(n_images, times=times)


def test_times_that_do_not_fit_the_images_are_refused():
    with pytest.raises(InvalidInputError, match="times must be 50 finite numbers"):
        split_images(50, times=np.arange(60.0))
    with pytest.raises(InvalidInputError, match="times must be 50 finite numbers"):
        split_images(50, times=np.full(50, np.nan))


@given(
    st.lists(st.integers(1, 9), min_size=8, max_size=60),
    seeds,
    st.sampled_from(["paper", "honest"]),
)
def test_shots_of_one_pose_serve_one_purpose(counts, seed, protocol):
    poses = np.random.default_rng(seed).permutation(np.repeat(np.arange(len(counts)), counts))
    split = split_images(len(poses), protocol, seed, groups=poses)
    assert not set(poses[split.train]) & set(poses[split.test])
    assert not set(poses[split.train]) & set(poses[split.validation])
    assert len(split.learned) + len(split.test) >= len(poses)


@given(st.integers(8, 100), seeds)
def test_groups_of_one_image_each_change_nothing(n_images, seed):
    plain = split_images(n_images, "honest", seed)
    grouped = split_images(n_images, "honest", seed, groups=np.arange(n_images) * -1.5)
    for one, other in zip(vars(plain).values(), vars(grouped).values(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_groups_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInputError, match="groups must be 9 values, one an image"):
        split_images(9, groups=np.arange(8))
    with pytest.raises(InvalidInputError, match="at least 8 images, got 3"):
        split_images(9, groups=np.arange(9) // 3)


def _set_of(delta_p: np.ndarray, **fields) -> PoseImageSet:
    return PoseImageSet(
        np.zeros((len(delta_p), 4, 4), np.uint8),
        poses_from_displacements(np.eye(4), delta_p, 0.5),
        np.eye(4),
        np.zeros((4, 4), np.uint8),
        pivot=0.5,
        pivot_ranges=np.full(6, 0.1),
        **fields,
    )


def _nearest_across(data: PoseImageSet, labels: np.ndarray) -> float:
    """Least largest difference of a dof between images of different groups, in ranges."""
    p = data.delta_p() / data.ranges()
    apart = np.abs(p[:, None] - p[None]).max(axis=2)
    both = (labels[:, None] >= 0) & (labels[None] >= 0)
    across = both & (labels[:, None] != labels[None])
    return float(apart[across].min())


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from(["random", "shots", "sequence", "revisits"]),
    seed=st.integers(0, 1000),
    n_groups=st.integers(2, 4),
)
def test_images_of_different_groups_are_farther_apart_than_stated(kind, seed, n_groups) -> None:
    rng = np.random.default_rng(seed)
    fields = {}
    if kind == "random":
        delta_p = rng.uniform(-0.1, 0.1, (60, 6))
    elif kind == "shots":
        delta_p = np.repeat(rng.uniform(-0.1, 0.1, (20, 6)), 3, axis=0)
        delta_p += 1e-6 * rng.normal(size=delta_p.shape)
        delta_p = delta_p[rng.permutation(60)]
    else:
        knots = rng.uniform(-0.1, 0.1, (13, 6))
        knots = np.concatenate([knots, knots]) if kind == "revisits" else knots
        at = np.linspace(0, len(knots) - 1, 240)
        delta_p = np.stack([np.interp(at, np.arange(len(knots)), k) for k in knots.T], axis=1)
        fields = {"split": "blocks", "times": np.arange(240) / 30}
    data = _set_of(delta_p, **fields)
    labels, distance = independent_groups(data, n_groups)
    assert set(labels[labels >= 0]) == set(range(n_groups))
    assert _nearest_across(data, labels) > distance
    sizes = np.bincount(labels[labels >= 0])
    assert sizes.min() * n_groups >= len(data) / 2
    assert distance >= (FARTHEST_APART if kind in ("random", "shots") else FARTHEST_APART / 8)


def test_shots_of_a_pose_are_in_one_group_wherever_they_stand() -> None:
    rng = np.random.default_rng(0)
    poses = np.arange(20).repeat(3)[rng.permutation(60)]
    data = _set_of(rng.uniform(-0.1, 0.1, (20, 6))[poses])
    labels = independent_groups(data).labels
    assert all(len(set(labels[poses == k])) == 1 for k in range(20))


def test_what_a_sequence_returns_to_is_in_the_group_of_the_first_visit() -> None:
    there = np.linspace(-0.1, 0.1, 120)[:, None] * np.ones(6)
    data = _set_of(np.concatenate([there, there]), split="blocks", times=np.arange(240.0))
    labels = independent_groups(data).labels
    first, again = labels[:120], labels[120:]
    both = (first >= 0) & (again >= 0)
    assert both.mean() > 0.5
    np.testing.assert_array_equal(first[both], again[both])


def test_a_dense_set_is_kept_apart_as_far_as_it_allows() -> None:
    dense = _set_of(np.linspace(-0.1, 0.1, 400)[:, None] * np.ones(6))
    labels, distance = independent_groups(dense)
    assert distance >= FARTHEST_APART / 2  # by its order, though it does not say it is a sequence
    assert np.bincount(labels[labels >= 0]).min() > 60
    shuffled = _set_of(dense.delta_p()[np.random.default_rng(0).permutation(400)])
    assert 0 < independent_groups(shuffled).distance < 0.02


def test_images_of_too_few_places_cannot_be_held_out() -> None:
    with pytest.raises(InvalidInputError, match="at least 3 different places"):
        independent_groups(_set_of(np.zeros((9, 6))))
