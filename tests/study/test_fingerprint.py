import shutil
from dataclasses import replace

import numpy as np
import pytest

from servoscope.storage.run_folder import open_run_folder
from servoscope.study import Study, StudyConfig

STAGES = ("_compute_features", "_assess", "_train")
QUICK = StudyConfig(hidden=1, restarts=1, n_thresholds=2, protocols=("honest",))
EVERY = ["_compute_features", "_assess", "_train", "_train"]  # nets of either displacement form


@pytest.fixture(scope="module")
def finished(plane, tmp_path_factory):
    """The folder of a finished study of the plane."""
    folder = tmp_path_factory.mktemp("study") / "run"
    Study(open_run_folder(folder, {}), plane, QUICK, n_jobs=1).run()
    return folder


@pytest.fixture
def redone(finished, tmp_path, monkeypatch):
    """The stages that a study in the finished folder would do again."""
    folder = shutil.copytree(finished, tmp_path / "run")
    done = []
    for stage in STAGES:
        monkeypatch.setattr(Study, stage, lambda *_, stage=stage: done.append(stage))

    def run(data, config=QUICK) -> list[str]:
        Study(open_run_folder(folder, {}, resume=True), data, config).run()
        return done

    return run


def with_a_flipped_bit(pixels: np.ndarray) -> np.ndarray:
    flipped = pixels.copy()
    flipped[(-1,) * pixels.ndim] ^= 1
    return flipped


def moved(T: np.ndarray) -> np.ndarray:
    """The poses with the last of them 1 um further along x."""
    T = T.copy()
    T.reshape(-1, 4, 4)[-1, 0, 3] += 1e-6
    return T


CHANGES = {
    "pixel of an image": lambda data: {"images": with_a_flipped_bit(data.images)},
    "pixel of the reference": lambda data: {
        "reference_image": with_a_flipped_bit(data.reference_image)
    },
    "pose": lambda data: {"T_world_cam": moved(data.T_world_cam)},
    "pose of the reference": lambda data: {"T_world_ref": moved(data.T_world_ref)},
    "pivot": lambda data: {"pivot": data.pivot + 1e-6},
    "ranges": lambda data: {"pivot_ranges": 1.001 * data.pivot_ranges},
    "times": lambda data: {"times": np.arange(len(data))[::-1].astype(float)},
    "split": lambda data: {"split": "blocks"},
}


@pytest.mark.parametrize("change", CHANGES)
def test_every_stage_is_done_again_for_another(plane, redone, change):
    assert redone(replace(plane, **CHANGES[change](plane))) == EVERY


def test_every_stage_is_done_again_for_another_order_of_the_same_images(plane, redone):
    order = np.random.default_rng(0).permutation(len(plane))
    assert redone(replace(plane, images=plane.images[order])) == EVERY


def test_every_stage_is_done_again_for_another_seed(plane, redone):
    assert redone(plane, replace(QUICK, seed=1)) == EVERY


def test_no_stage_is_done_again_for_equal_data(plane, redone):
    images, poses = np.asfortranarray(plane.images), plane.T_world_cam.copy()
    assert redone(replace(plane, images=images, T_world_cam=poses)) == []
