import numpy as np
import pytest

from rehearsal_sample import PIVOT, RANGES, displacements, keyframe, plate
from servoscope.poses import displacements_from_poses, poses_from_displacements
from servoscope.positioning.first_guess import WINDOWS, FirstGuess, _parts, bounds_of, small_shape


@pytest.fixture(scope="module")
def learned() -> FirstGuess:
    sample = keyframe()
    D = displacements(8)
    images = np.stack([sample.render(d)[0] for d in D])
    return FirstGuess.train(sample, RANGES, images, D, n_rendered=400)


def test_guesses_are_much_nearer_than_the_range(learned):
    truth = 0.6 * displacements_from_poses(np.eye(4), displacements(12, seed=9), PIVOT)
    seen = poses_from_displacements(np.eye(4), truth, PIVOT)
    found = displacements_from_poses(
        np.eye(4), np.concatenate([learned(keyframe().render(D)[0]) for D in seen]), PIVOT
    )
    off = found.reshape(12, len(WINDOWS), 6).mean(axis=1) - truth
    assert np.mean(off.std(axis=0) / truth.std(axis=0)) < 0.7


def test_the_same_seed_learns_the_same(learned):
    D = displacements(8)
    images = np.stack([keyframe().render(d)[0] for d in D])
    again = FirstGuess.train(keyframe(), RANGES, images, D, n_rendered=400)
    for one, other in zip(learned.to_arrays().values(), again.to_arrays().values(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    "shape",
    [(171, 256), (480, 2100), (2064, 3088), (20, 30), (32, 3000), (3000, 32), (96, 128), (3, 7)],
)
def test_windows_are_as_large_whatever_the_image_was_made_of(shape):
    small = small_shape(shape)
    sizes = [(r.stop - r.start) * (c.stop - c.start) for r, c in bounds_of(small)]
    image = np.random.default_rng(0).integers(0, 255, shape, dtype=np.uint8)
    assert [part.size for part in _parts(image, small)] == sizes
    assert min(sizes) > 0
    assert len(sizes) == len(WINDOWS)


def test_what_is_saved_is_read_and_what_does_not_fit_the_images_is_refused(learned):
    arrays = learned.to_arrays()
    loaded = FirstGuess.from_arrays(arrays, plate().shape, RANGES, PIVOT)
    np.testing.assert_array_equal(loaded(plate()), learned(plate()))
    with pytest.raises(ValueError, match="window 0"):
        FirstGuess.from_arrays(arrays, (171, 256), RANGES, PIVOT)
    with pytest.raises(KeyError):
        FirstGuess.from_arrays({k: v for k, v in arrays.items() if k != "3/mean"}, plate().shape,
                               RANGES, PIVOT)  # fmt: skip
    with pytest.raises(ValueError, match="window 2"):
        FirstGuess.from_arrays(
            arrays | {"2/weights": np.zeros((5, 6), np.float32)}, plate().shape, RANGES, PIVOT
        )
