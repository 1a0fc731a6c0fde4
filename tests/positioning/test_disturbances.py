"""Disturbances: each does what its name says, and a generator decides which."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.positioning.disturbances import SINGLE_DISTURBANCES, Disturbances


def disturbed(image: np.ndarray, seed: int = 0, **strengths: float) -> np.ndarray:
    return Disturbances.only(**strengths).disturb(image, np.random.default_rng(seed))


@given(gain=st.floats(0, 3), offset=st.floats(-100, 100))
def test_gain_and_offset_follow_their_formula(gain: float, offset: float) -> None:
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    expected = np.clip(gain * image.astype(float) + offset, 0, 255)
    got = disturbed(image, gain=gain, offset=offset)
    assert np.abs(got - expected).max() <= 0.5 + 1e-3


@given(share=st.floats(0, 1), seed=st.integers(0, 1000))
def test_a_covering_hides_its_share_to_half_a_row(share: float, seed: int) -> None:
    image = np.random.default_rng(0).choice([0, 255], (60, 80)).astype(np.uint8)
    changed = disturbed(image, seed, covering=share)
    hidden = ~np.isin(changed, [0, 255])
    rows, columns = hidden.any(axis=1).sum(), hidden.any(axis=0).sum()
    if len(np.unique(changed[hidden])):
        assert hidden.sum() == rows * columns
        assert abs(hidden.mean() - share) <= 0.5 / 60 + 0.5 / 80
        assert len(np.unique(changed[hidden])) == 1


def test_noise_has_its_deviation_and_no_mean() -> None:
    noise = disturbed(np.full((200, 200), 128, np.uint8), noise=10.0) - 128.0
    assert noise.std() == pytest.approx(10, rel=0.02)
    assert abs(noise.mean()) < 0.2


@pytest.mark.parametrize("width", [128, 256])
def test_a_defocus_spreads_a_point_in_proportion_to_the_width(width: int) -> None:
    image = np.zeros((64, width), np.uint8)
    image[:, width // 2 - 8 : width // 2 + 8] = 250
    edge = -np.diff(disturbed(image, defocus=2.0)[32, width // 2 :].astype(float))
    x = np.arange(len(edge))
    mean = (edge * x).sum() / edge.sum()
    deviation = np.sqrt((edge * (x - mean) ** 2).sum() / edge.sum())
    assert deviation == pytest.approx(2.0 * width / 256, rel=0.1)


def test_a_light_is_smooth_and_of_its_strength() -> None:
    image = np.full((96, 96), 100, np.uint8)
    fields = [np.log(disturbed(image, seed, light=0.2) / 100.0) for seed in range(200)]
    knots = np.array([field[16::32, 16::32] for field in fields])
    assert knots.std() == pytest.approx(0.2, rel=0.1)
    assert max(np.abs(np.diff(field, axis=0)).max() for field in fields) < 0.05


def test_nothing_is_done_where_nothing_is_asked_for(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (20, 30), dtype=np.uint8)
    np.testing.assert_array_equal(disturbed(image), image)
    np.testing.assert_array_equal(disturbed(image, covering=0.0, noise=0.0, light=0.0), image)


def test_the_same_generator_gives_the_same_image_and_leaves_the_first_alone() -> None:
    image = np.random.default_rng(1).integers(0, 256, (64, 64), dtype=np.uint8)
    before = image.copy()
    first, again, other = (
        Disturbances().disturb(image, np.random.default_rng(seed)) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    np.testing.assert_array_equal(image, before)


def test_probabilities_are_kept() -> None:
    image = np.full((8, 8), 100, np.uint8)
    often = Disturbances(**dict.fromkeys(SINGLE_DISTURBANCES) | {"gain": (0.5, 0.5, 0.3)})
    rng = np.random.default_rng(0)
    share = np.mean([often.disturb(image, rng)[0, 0] == 50 for _ in range(2000)])
    assert share == pytest.approx(0.3, abs=0.04)


@pytest.mark.parametrize(
    ("strengths", "message"),
    [
        ({"gain": (1.2, 0.8, 1.0)}, "strength of gain must be from 0 to 100, the lower bound"),
        ({"covering": (0.0, 1.5, 1.0)}, "covering must be from 0 to 1"),
        ({"noise": (0.0, 1.0, 2.0)}, "its probability from 0 to 1"),
        ({"defocus": (np.nan, 1.0, 1.0)}, "defocus must be"),
    ],
)
def test_strengths_out_of_range_are_refused(strengths: dict, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        Disturbances(**strengths)


def test_an_unknown_disturbance_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"Disturbances are defocus, .* got fog"):
        Disturbances.only(fog=1.0)
