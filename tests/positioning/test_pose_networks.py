"""Pose networks: features that fail are left out, and nothing depends on the processes."""

import json

import numpy as np
import pytest

from planar import RANGES, planar_data_set, planar_images
from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS
from servoscope.positioning.holding_up import LARGEST_SHARE, disturbance_shares
from servoscope.positioning.pose_networks import PoseNetworks
from servoscope.scene.disturbances import SINGLE_DISTURBANCES, Disturbances

SIZE = 48
NORMALISED = ("local_", "gradient_", "orientation_")


@pytest.fixture(scope="module")
def data():
    return planar_data_set(300, SIZE, seed=3)


@pytest.fixture(scope="module")
def hardened(data) -> PoseNetworks:
    return PoseNetworks.train(
        data.images, data.delta_p(), RANGES, disturbances=Disturbances(), n_jobs=1
    )


@pytest.fixture(scope="module")
def plain(data) -> PoseNetworks:
    return PoseNetworks.train(data.images, data.delta_p(), RANGES, n_jobs=1)


@pytest.fixture(scope="module")
def unseen() -> tuple[np.ndarray, np.ndarray]:
    delta_p = np.random.default_rng(9).uniform(-1, 1, (60, 6)) * RANGES
    return planar_images(delta_p, SIZE, seed=3), delta_p


def rms(networks: PoseNetworks, images: np.ndarray, delta_p: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(((networks.predict(images) - delta_p) / RANGES) ** 2, axis=0))


def disturbed(images: np.ndarray, how: Disturbances) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.array([how.disturb(image, rng) for image in images])


def test_both_tell_where_unseen_images_were_taken(plain, hardened, unseen) -> None:
    for networks in (plain, hardened):
        assert (rms(networks, *unseen) < 0.45).all()


def test_disturbances_harm_hardened_networks_less(plain, hardened, unseen) -> None:
    images, delta_p = unseen
    for name in ("gain", "covering", "light"):
        changed = disturbed(images, SINGLE_DISTURBANCES[name])
        assert rms(hardened, changed, delta_p).mean() < rms(plain, changed, delta_p).mean()
    gained = disturbed(images, SINGLE_DISTURBANCES["gain"])
    np.testing.assert_allclose(rms(hardened, gained, delta_p), rms(hardened, *unseen), atol=0.05)


def test_most_moments_are_left_out_and_normalised_features_stay(hardened) -> None:
    report = hardened.report()
    moments = [name for name in report["left_out"] if name.endswith(("_50", "_100", "_150"))]
    assert len(moments) >= 18
    for features in report["features"].values():
        assert sum(name.startswith(NORMALISED) for name in features) > 0.5 * len(features)
        assert not set(features) & set(report["left_out"])


def test_what_is_left_out_is_told_with_its_numbers(hardened) -> None:
    for shares in hardened.report()["left_out"].values():
        assert set(shares) == set(SINGLE_DISTURBANCES)
        assert max(np.inf if s is None else s for s in shares.values()) >= LARGEST_SHARE - 1e-3


def test_without_disturbances_the_features_are_the_papers(plain) -> None:
    report = plain.report()
    chosen = {name for features in report["features"].values() for name in features}
    assert not any(name.startswith(NORMALISED) for name in chosen)
    assert report["left_out"] == {}
    assert list(report["features"]) == list(DOFS)


def test_the_report_is_json_with_errors_in_millimetres_and_degrees(hardened, unseen) -> None:
    report = json.loads(json.dumps(hardened.report()))
    assert set(report["validation_rms"]) == {"clean", *SINGLE_DISTURBANCES}
    told = np.array(report["validation_rms"]["clean"])
    seen = rms(hardened, *unseen) * [25, 25, 25, 15, 15, 15]
    np.testing.assert_allclose(told, seen, rtol=0.5)
    np.testing.assert_allclose(hardened.validation_rms[:3], told[:3] / 1e3)


def test_what_is_saved_predicts_the_same_bit_for_bit(hardened, unseen, tmp_path) -> None:
    np.savez(tmp_path / "networks.npz", **hardened.to_arrays())
    with np.load(tmp_path / "networks.npz", allow_pickle=False) as arrays:
        loaded = PoseNetworks.from_arrays(arrays)
    np.testing.assert_array_equal(loaded.predict(unseen[0]), hardened.predict(unseen[0]))
    assert loaded.report() == hardened.report()
    assert (loaded.ranges == hardened.ranges).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ranges": None}, "need the array 'ranges'"),
        ({"pool.preparations": np.array(["eval"])}, "can be prepared as .* got 'eval'"),
        ({"networks.tx.weights": np.zeros(7)}, "not of one network"),
        ({"pool.orientation.mean": np.zeros(7)}, "not of one pool"),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(hardened, change, message) -> None:
    arrays = hardened.to_arrays() | change
    kept = {name: array for name, array in arrays.items() if array is not None}
    with pytest.raises(InvalidInputError, match=message):
        PoseNetworks.from_arrays(kept)


@pytest.mark.slow
def test_a_seed_gives_one_result_for_any_number_of_processes(data) -> None:
    few = slice(0, 80)
    a, b = (
        PoseNetworks.train(
            data.images[few],
            data.delta_p()[few],
            RANGES,
            disturbances=Disturbances(),
            seed=4,
            n_jobs=n_jobs,
        ).to_arrays()
        for n_jobs in (1, 2)
    )
    assert set(a) == set(b)
    for name in a:
        np.testing.assert_array_equal(a[name], b[name])


def test_progress_counts_images_and_then_networks(data) -> None:
    told: list[int] = []
    PoseNetworks.train(
        data.images[:60], data.delta_p()[:60], RANGES, n_jobs=1, on_progress=told.append
    )
    assert told == sorted(told)
    assert told[0] <= 60 < told[-1]


def test_a_share_is_the_disturbed_variance_over_that_of_the_pose(rng) -> None:
    clean = rng.normal(size=(5000, 3)) * [1.0, 2.0, 0.0]
    noise = rng.normal(size=(5000, 2, 3)) * [[[0.5, 0.5, 0.0]], [[0.0, 4.0, 1.0]]][0]
    shares = disturbance_shares(clean, clean[:, None] + noise)
    np.testing.assert_allclose(shares[:2, 0], [0.25, 0.0625], rtol=0.1)
    assert (shares[2] == 0).all()


@pytest.mark.parametrize(
    ("images", "delta_p", "message"),
    [
        (np.zeros((10, 8, 8), np.uint8), np.zeros((10, 6)), "trained on 40 or more uint8 images"),
        (np.zeros((50, 8, 8)), np.zeros((50, 6)), "got float64"),
        (np.zeros((50, 8, 8), np.uint8), np.zeros((50, 5)), r"must be of shape \(50, 6\)"),
        (np.zeros((50, 8, 8), np.uint8), np.full((50, 6), np.nan), "must be finite"),
    ],
)
def test_what_cannot_train_is_refused(images, delta_p, message) -> None:
    with pytest.raises(InvalidInputError, match=message):
        PoseNetworks.train(images, delta_p, RANGES, n_jobs=1)
