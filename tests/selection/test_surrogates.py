import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.selection.surrogates import REARRANGEMENTS, rearrangements


@given(st.integers(2, 50), st.sampled_from(REARRANGEMENTS), st.data())
def test_every_sample_comes_once(n_samples, kind, data):
    length = data.draw(st.integers(1, n_samples // 2))
    for order in rearrangements(n_samples, kind, 3, length):
        np.testing.assert_array_equal(np.sort(order), np.arange(n_samples))


def test_shifts_are_all_different_and_no_more_than_there_are():
    orders = list(rearrangements(7, "shifts", 999))
    assert sorted(order[0] for order in orders) == [1, 2, 3, 4, 5, 6]
    for order in orders:
        assert (np.diff(order) % 7 == 1).all()


def test_blocks_stay_whole_and_are_cut_at_changing_places():
    cuts = set()
    for order in rearrangements(100, "blocks", 50, 10):
        steps = np.diff(order) % 100
        assert (steps == 1).sum() >= 90
        cuts.update(order[1:][steps != 1] % 10)
    assert cuts == set(range(10))


def test_blocks_of_one_sample_are_a_shuffle():
    (blocks,), (shuffle,) = (list(rearrangements(30, k, 1, 1, 5)) for k in ("blocks", "shuffle"))
    np.testing.assert_array_equal(blocks, shuffle)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "turn"}, "one of shuffle, blocks, shifts, got 'turn'"),
        ({"n_permutations": 0}, "n_permutations must be 1 or more, got 0"),
        ({"kind": "blocks"}, "from 1 to half of the 9 samples, got None"),
        ({"kind": "blocks", "block_length": 5}, "from 1 to half of the 9 samples, got 5"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        rearrangements(9, **arguments)
