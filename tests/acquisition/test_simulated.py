"""An acquisition gives the same images however it is split, interrupted or repeated."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from same_data import assert_same
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data import folder as dataset_folder
from servoscope.data.folder import Progress, write_progress
from servoscope.data.images import PoseImageSet
from servoscope.errors import FolderExistsError, InvalidInputError
from servoscope.storage.folders import write_json

PART = "textured_plane"  # which is rendered sooner than the cylinder head
CONFIG = AcquisitionConfig(n_images=60, image_size=16, seed=3, part=PART)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> PoseImageSet:
    """What an undisturbed acquisition in one process gives."""
    return acquire(tmp_path_factory.mktemp("whole"), CONFIG, n_jobs=1)


def _interrupt_at_the_end(path: Path, content: dict[str, Any]) -> None:
    if path.name == "meta.json":
        raise KeyboardInterrupt
    write_json(path, content)


def _interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def _content(folder: Path) -> dict[str, tuple[int, bytes]]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def test_displacements_are_drawn_evenly_over_the_stated_ranges(whole: PoseImageSet) -> None:
    from scipy.stats import kstest

    config = AcquisitionConfig(n_images=2000)
    many = PoseImageSet(
        np.zeros((2000, 1, 1), np.uint8),
        config.poses(),
        whole.T_world_ref,
        np.zeros((1, 1), np.uint8),
        pivot=0.55,
    )
    scaled = many.delta_p() / ([0.025] * 3 + [np.radians(15)] * 3)
    assert np.abs(scaled).max() <= 1 + 1e-9
    assert all(kstest(column, "uniform", (-1, 2)).pvalue > 1e-3 for column in scaled.T)


def test_stored_poses_are_the_commanded_ones(whole: PoseImageSet) -> None:
    np.testing.assert_allclose(whole.T_world_cam, CONFIG.poses(), atol=1e-12)
    assert (np.abs(whole.delta_p()) <= whole.ranges() + 1e-9).all()
    np.testing.assert_allclose(whole.ranges("camera")[:2], 0.1673, atol=1e-4)


def test_images_differ_by_pose_and_noise(whole: PoseImageSet) -> None:
    assert whole.images.shape == (60, 16, 16)
    assert len(np.unique(whole.images.reshape(60, -1), axis=0)) == 60


def test_every_image_has_noise_of_its_own(tmp_path: Path) -> None:
    config = AcquisitionConfig(
        27, 16, 0, 0.0, 0.0, repeatability_mm=0.0, repeatability_deg=0.0, part=PART
    )
    images = acquire(tmp_path, config, n_jobs=1).images.astype(int)
    pairs = ((1, 0), (2, 1), (25, 0), (26, 1))  # those 25 apart stand alike in their blocks
    assert all((images[i] != images[j]).mean() > 0.2 for i, j in pairs)


def test_more_images_begin_with_the_same_ones(tmp_path: Path, whole: PoseImageSet) -> None:
    fewer = acquire(
        tmp_path, AcquisitionConfig(n_images=7, image_size=16, seed=3, part=PART), n_jobs=1
    )
    np.testing.assert_array_equal(fewer.images, whole.images[:7])
    np.testing.assert_allclose(fewer.T_world_cam, whole.T_world_cam[:7], atol=1e-12)
    np.testing.assert_array_equal(fewer.reference_image, whole.reference_image)


def test_another_seed_gives_other_poses() -> None:
    assert (AcquisitionConfig(seed=1).poses() != AcquisitionConfig(seed=2).poses()).any()


def test_progress_counts_the_images(tmp_path: Path) -> None:
    counts: list[int] = []
    acquire(tmp_path, CONFIG, n_jobs=1, on_progress=counts.append)
    assert counts == [25, 50, 60]


@pytest.mark.parametrize("at", [25, 50, 60])
def test_an_interrupted_acquisition_goes_on_where_it_stopped(
    tmp_path: Path, whole: PoseImageSet, at: int
) -> None:
    def stop(n_done: int) -> None:
        if n_done == at:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        acquire(tmp_path, CONFIG, n_jobs=1, on_progress=stop)
    assert not dataset_folder.is_finished(tmp_path)
    counts: list[int] = []
    assert_same(acquire(tmp_path, CONFIG, n_jobs=1, on_progress=counts.append), whole)
    assert counts == [n for n in (25, 50, 60) if n > at]


@pytest.mark.parametrize(
    "step",
    [
        "acquisition.simulated.write_poses",
        "acquisition.simulated.write_progress",
        "data.folder.finish",
        "data.folder.write_images",
        "data.folder.write_json",
        "data.folder.write_text",
    ],
)
def test_a_stop_at_any_step_loses_nothing(
    tmp_path: Path, whole: PoseImageSet, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        ends = step == "data.folder.write_json"
        patch.setattr(f"servoscope.{step}", _interrupt_at_the_end if ends else _interrupt)
        with pytest.raises(KeyboardInterrupt):
            acquire(tmp_path, CONFIG, n_jobs=1)
    assert_same(acquire(tmp_path, CONFIG, n_jobs=1), whole)
    assert not (tmp_path / "acquisition.json").exists()


def test_a_stop_at_the_very_end_loses_nothing(tmp_path: Path) -> None:
    config = AcquisitionConfig(n_images=2, image_size=16, part=PART)
    first = acquire(tmp_path, config, n_jobs=1)
    write_progress(tmp_path, Progress(config.plan(), 2))
    assert_same(acquire(tmp_path, config, n_jobs=1), first)
    assert not (tmp_path / "acquisition.json").exists()


def test_a_finished_folder_is_only_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = AcquisitionConfig(n_images=2, image_size=16, part=PART)
    first = acquire(tmp_path, config, n_jobs=1)
    before = _content(tmp_path)
    monkeypatch.setattr("servoscope.acquisition.simulated.make_robot", _interrupt)
    assert_same(acquire(tmp_path, config, n_jobs=1), first)
    assert _content(tmp_path) == before


def _half_done(folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        acquire(folder, CONFIG, n_jobs=1, on_progress=_interrupt)


def _done(folder: Path) -> None:
    acquire(folder, AcquisitionConfig(n_images=2, image_size=16, part=PART), n_jobs=1)


@pytest.mark.parametrize(
    ("begin", "message"),
    [
        (_half_done, r"unfinished acquisition of other settings \(n_images 60, seed 3\)"),
        (_done, "holds a data set already"),
    ],
)
def test_other_settings_are_refused_until_forced(
    tmp_path: Path, begin: Callable[[Path], None], message: str
) -> None:
    begin(tmp_path)
    before = _content(tmp_path)
    other = AcquisitionConfig(n_images=3, image_size=16, seed=9, part=PART)
    with pytest.raises(FolderExistsError, match=message):
        acquire(tmp_path, other, n_jobs=1)
    assert _content(tmp_path) == before
    data = acquire(tmp_path, other, n_jobs=1, force=True)
    assert len(data) == 3
    assert data.source["seed"] == 9


def _disk_full_at(n_images: int) -> Callable[..., None]:
    write_images = dataset_folder.write_images

    def write(folder: Path, start: int, images: np.ndarray) -> None:
        if start >= n_images:
            raise OSError(28, "No space left on device")
        write_images(folder, start, images)

    return write


@pytest.mark.parametrize("n_done", [0, 50])
def test_a_full_disk_costs_nothing_of_what_is_replaced(
    tmp_path: Path, whole: PoseImageSet, n_done: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = AcquisitionConfig(n_images=3, image_size=16, seed=9, part=PART)
    old = acquire(tmp_path, other, n_jobs=1)
    with monkeypatch.context() as patch:
        patch.setattr(dataset_folder, "write_images", _disk_full_at(n_done))
        with pytest.raises(OSError, match="No space left"):
            acquire(tmp_path, CONFIG, n_jobs=1, force=True)
    assert_same(PoseImageSet.load(tmp_path), old)
    counts: list[int] = []
    new = acquire(tmp_path, CONFIG, n_jobs=1, force=True, on_progress=counts.append)
    assert_same(new, whole)
    assert counts == [n for n in (25, 50, 60) if n > n_done]
    names = ["images.zarr", "meta.json", "poses.csv", "reference.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_force_goes_on_with_an_acquisition_that_replaces_nothing(
    tmp_path: Path, whole: PoseImageSet
) -> None:
    _half_done(tmp_path)
    counts: list[int] = []
    new = acquire(tmp_path, CONFIG, n_jobs=1, force=True, on_progress=counts.append)
    assert_same(new, whole)
    assert counts == [50, 60]


def test_a_replacement_of_other_settings_is_not_gone_on_with(
    tmp_path: Path, whole: PoseImageSet
) -> None:
    _done(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        acquire(
            tmp_path,
            AcquisitionConfig(n_images=60, image_size=16, seed=4, part=PART),
            n_jobs=1,
            force=True,
            on_progress=_interrupt,
        )
    assert_same(acquire(tmp_path, CONFIG, n_jobs=1, force=True), whole)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_images": 0}, "n_images must be a whole number from 1, got 0"),
        ({"n_images": 1.5}, r"n_images must be a whole number from 1, got 1\.5"),
        ({"seed": -1}, "seed must be a whole number from 0, got -1"),
        ({"image_size": 8}, "image_size must be a whole number from 16 to 2048, got 8"),
        ({"translation_mm": -1.0}, "translation_mm must be from 0 to 200, got -1"),
        ({"translation_mm": np.nan}, "translation_mm must be from 0 to 200, got nan"),
        ({"rotation_deg": 90.0}, "rotation_deg must be from 0 to 60, got 90"),
        ({"pivot_mm": np.inf}, "pivot_mm must be from 0 to 5000, got inf"),
        ({"repeatability_mm": 11.0}, "repeatability_mm must be from 0 to 10, got 11"),
        ({"repeatability_deg": -0.1}, "repeatability_deg must be from 0 to 10"),
    ],
)
def test_numbers_out_of_range_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        AcquisitionConfig(**changes)
