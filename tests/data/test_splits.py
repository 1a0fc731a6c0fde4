import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.data.splits import deal_groups, further_splits, split_images
from servoscope.errors import InvalidInputError

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


@given(st.integers(8, 400), seeds)
def test_both_protocols_test_on_the_same_images(n_images, seed):
    honest, paper = (split_images(n_images, name, seed) for name in ("honest", "paper"))
    np.testing.assert_array_equal(paper.test, honest.test)
    np.testing.assert_array_equal(paper.validation, paper.test)
    assert set(paper.train) == set(honest.train) | set(honest.validation)
    assert not set(paper.train) & set(paper.test)


def test_one_seed_gives_one_split_and_another_gives_another():
    a, b, other = (split_images(200, "honest", seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.train, b.train)
    np.testing.assert_array_equal(a.test, b.test)
    assert set(a.test) != set(other.test)


def test_images_by_themselves_are_drawn_in_the_order_of_one_permutation():
    order = np.random.default_rng([5, 1]).permutation(1000)  # as in every version before
    split = split_images(1000, seed=5)
    assert set(split.test) == set(order[:250])
    assert set(split.validation) == set(order[250:400])


def test_an_unknown_protocol_is_refused():
    with pytest.raises(InvalidInputError, match="one of paper, honest, got 'lucky'"):
        split_images(100, "lucky")


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


@given(st.lists(st.integers(1, 12), min_size=12, max_size=40), seeds)
def test_parts_have_their_shares_up_to_half_a_group(sizes, seed):
    groups = np.repeat(np.arange(len(sizes)), sizes)
    split = split_images(len(groups), "honest", seed, groups)
    for part, share in ((split.test, 0.25), (split.validation, 0.15)):
        assert abs(len(part) - share * len(groups)) <= max(sizes) / 2 + 0.5


def test_images_of_no_group_serve_no_purpose():
    groups = np.arange(100) // 5
    groups[::7] = -1
    split = split_images(100, "honest", 0, groups)
    used = np.sort(np.concatenate([split.learned, split.test]))
    np.testing.assert_array_equal(used, np.flatnonzero(groups >= 0))


def test_groups_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInputError, match="groups must be 9 values, one an image"):
        split_images(9, groups=np.arange(8))
    with pytest.raises(InvalidInputError, match=r"at least 8 places .* got 3 of 9 images"):
        split_images(9, groups=np.arange(9) // 3)


@given(st.lists(st.integers(1, 9), min_size=8, max_size=40), seeds)
def test_further_splits_test_every_group_once_and_divide_none(sizes, seed):
    labels = np.append(np.repeat(np.arange(len(sizes)), sizes), [-1, -1])  # some of no group
    groups = np.random.default_rng(seed).permutation(labels)
    split = split_images(len(groups), seed=seed, groups=groups)
    splits = [split, *further_splits(split, groups, seed)]
    tested = np.concatenate([one.test for one in splits])
    assert np.sort(tested).tolist() == np.flatnonzero(groups >= 0).tolist()
    for one in splits:
        parts = [set(groups[part].tolist()) for part in (one.train, one.validation, one.test)]
        assert all(parts)
        assert sum(map(len, parts)) == len(set.union(*parts)) == len(set(groups[groups >= 0]))


def test_groups_are_dealt_so_that_parts_are_of_about_equal_size():
    dealt = deal_groups(np.repeat([0, 1, 2, 3, 4, -1], [5, 4, 3, 3, 2, 1]), 3)
    assert sorted(np.bincount(dealt[:-1]).tolist()) == [5, 6, 6]
    assert dealt[-1] == -1
