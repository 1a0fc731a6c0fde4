"""Images in rings: each ring fills its share of the range, and none hangs on another."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from same_data import assert_same
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.poses import displacements_from_poses
from servoscope.robots.registry import make_robot
from servoscope.scene.scene import T_WORLD_REF, Scene

SCHEDULE = ((30, 1.5), (20, 0.3), (10, 0.04))
SMALL = {"image_size": 16, "seed": 3, "part": "textured_plane"}
CONFIG = AcquisitionConfig(schedule=SCHEDULE, **SMALL)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> PoseImageSet:
    """What an undisturbed acquisition in one process gives."""
    return acquire(tmp_path_factory.mktemp("rings"), CONFIG, n_jobs=1)


def test_each_ring_lies_in_its_box_and_fills_it() -> None:
    schedule = ((1500, 1.6), (1500, 0.3), (1500, 0.04))
    poses = AcquisitionConfig(schedule=schedule).poses()
    delta_p = displacements_from_poses(T_WORLD_REF, poses, 0.55).reshape(3, 1500, 6)
    for ring, (_, factor) in zip(delta_p, schedule, strict=True):
        scaled = ring / (factor * np.array([0.025] * 3 + [np.radians(15)] * 3))
        assert np.abs(scaled).max() <= 1 + 1e-9
        assert all(kstest(column, "uniform", (-1, 2)).pvalue > 1e-3 for column in scaled.T)


def test_rings_are_drawn_independently() -> None:
    n = 2000
    a, b = AcquisitionConfig(schedule=((n, 1.0), (n, 1.0))).displacements().reshape(2, n, 6)
    correlations = np.corrcoef(a.T, b.T)[:6, 6:]
    assert np.abs(correlations).max() < 4 / np.sqrt(n)


@pytest.mark.parametrize("others", [((12, 1.5), (20, 0.3), (10, 0.04)), ((30, 0.7), (20, 0.3))])
def test_a_ring_stays_as_it_is_when_others_change(
    tmp_path: Path, whole: PoseImageSet, others: tuple[tuple[int, float], ...]
) -> None:
    changed = AcquisitionConfig(schedule=others, **SMALL)
    data = acquire(tmp_path, changed, n_jobs=1)
    start = others[0][0]
    np.testing.assert_array_equal(data.images[start : start + 20], whole.images[30:50])
    np.testing.assert_array_equal(data.T_world_cam[start : start + 20], whole.T_world_cam[30:50])


def test_a_longer_ring_begins_with_the_same_images(tmp_path: Path, whole: PoseImageSet) -> None:
    longer = AcquisitionConfig(schedule=((30, 1.5), (27, 0.3)), **SMALL)
    data = acquire(tmp_path, longer, n_jobs=1)
    np.testing.assert_array_equal(data.images[:50], whole.images[:50])


def test_one_ring_at_factor_1_is_what_no_schedule_takes(tmp_path: Path) -> None:
    same = {**SMALL, "seed": 5, "n_reference_images": 1}
    ring = acquire(tmp_path / "ring", AcquisitionConfig(schedule=((4, 1.0),), **same), n_jobs=1)
    plain = acquire(tmp_path / "plain", AcquisitionConfig(4, **same), n_jobs=1)
    assert_same(ring, plain)
    np.testing.assert_array_equal(ring.pivot_ranges, plain.pivot_ranges)


def test_the_ranges_are_those_of_the_widest_ring(whole: PoseImageSet) -> None:
    widest = 1.5 * np.array([0.025] * 3 + [np.radians(15)] * 3)
    np.testing.assert_allclose(whole.ranges(), widest)
    assert whole.source["rings"] == "30@1.5,20@0.3,10@0.04"
    assert whole.source["n_images"] == len(whole) == 60


@pytest.mark.slow
def test_two_processes_give_the_images_of_one(tmp_path: Path, whole: PoseImageSet) -> None:
    assert_same(acquire(tmp_path, CONFIG, n_jobs=2), whole)


@pytest.mark.parametrize("at", [25, 50, 60])
def test_interrupted_rings_end_with_the_same_images(
    tmp_path: Path, whole: PoseImageSet, at: int
) -> None:
    def stop(n_done: int) -> None:
        if n_done == at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        acquire(tmp_path, CONFIG, n_jobs=1, on_progress=stop)
    assert_same(acquire(tmp_path, CONFIG, n_jobs=1), whole)
    assert {path.name for path in tmp_path.iterdir()} == {
        "images.zarr",
        "meta.json",
        "poses.csv",
        "reference.png",
    }


def test_the_reference_image_of_rings_is_a_mean_of_16(tmp_path: Path) -> None:
    noiseless = make_robot("free", Scene(image_size=64)).read().astype(float)

    def error(**settings: object) -> float:
        config = AcquisitionConfig(image_size=64, **settings)
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        image = acquire(folder, config, n_jobs=1).reference_image
        return float((image - noiseless).std())

    single, mean = error(n_images=1), error(schedule=((1, 1.0),))
    assert error(n_images=1, n_reference_images=16) == mean
    # Beside a quarter of the noise the mean has the error of rounding, 1 / 12.
    assert mean == pytest.approx(np.sqrt((single**2) / 16 + 1 / 12), rel=0.15)


def test_the_noise_of_an_image_is_measured_where_several_show_the_reference(tmp_path) -> None:
    scene = Scene(image_size=64)
    clean = make_robot("free", scene).read().astype(float)
    images = [make_robot("free", scene, rng=np.random.default_rng(k)).read() for k in range(40)]
    unclipped = (clean > 12) & (clean < 243)
    sigma = float(np.sqrt(np.mean((np.array(images, dtype=float) - clean)[:, unclipped] ** 2)))
    config = AcquisitionConfig(image_size=64, n_images=1, n_reference_images=16)
    data = acquire(tmp_path / "several", config, n_jobs=1)
    assert data.image_noise == pytest.approx(sigma, rel=0.05)
    one = acquire(tmp_path / "one", replace(config, n_reference_images=1), n_jobs=1)
    assert one.image_noise is None
    assert acquire(tmp_path / "several", config, n_jobs=1).image_noise == data.image_noise


def test_of_a_schedule_and_a_number_one_is_too_many() -> None:
    with pytest.raises(InvalidInputError, match="leave n_images out, got 1000"):
        AcquisitionConfig(1000, schedule=SCHEDULE)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schedule": [(5, np.nan)]}, "factor must be above 0"),
        ({"schedule": ((5, 4.0),), "rotation_deg": 16.0}, "over the largest factor, 4, got 16"),
        ({"schedule": ((5, 4.0),), "translation_mm": 51.0}, "translation_mm must be from 0 to 200"),
        ({"part": "valve"}, "part must be one of cylinder_head, textured_plane, got 'valve'"),
        ({"variant": -1}, "variant must be a whole number from 0, got -1"),
        ({"robot": "crane"}, "robot must be one of arm, free, got 'crane'"),
        ({"n_reference_images": 0}, "n_reference_images must be a whole number from 1, got 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        AcquisitionConfig(**changes)


def test_another_variant_is_another_part(tmp_path: Path) -> None:
    config = {"n_images": 1, "image_size": 32}
    first = acquire(tmp_path / "0", AcquisitionConfig(**config), n_jobs=1)
    other = acquire(tmp_path / "1", AcquisitionConfig(variant=1, **config), n_jobs=1)
    assert (first.reference_image != other.reference_image).mean() > 0.01
    assert other.source["kind"] == "simulated cylinder head"
    assert other.source["variant"] == 1


def test_a_plane_fills_the_view(tmp_path: Path) -> None:
    config = AcquisitionConfig(2, 32, part="textured_plane")
    data = acquire(tmp_path, config, n_jobs=1)
    assert data.source["kind"] == "simulated textured plane"
    edges = [data.reference_image[rim].std() for rim in (0, -1)]
    assert min(edges) > 5
