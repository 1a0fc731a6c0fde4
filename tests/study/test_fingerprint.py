from dataclasses import replace

import numpy as np
import pytest

from servoscope.study import RunFolder, Study, StudyConfig, open_run_folder

STAGES = ("_compute_features", "_assess", "_train")
QUICK = StudyConfig(protocols=("honest",))
N_STAGES = 4  # features, assessment, and the nets of either displacement form


@pytest.fixture
def stages_done(tmp_path, monkeypatch):
    """Runs a study in one folder; returns how many of its stages were not finished already."""
    done = []
    for stage in STAGES:
        monkeypatch.setattr(Study, stage, lambda *_, stage=stage: done.append(stage))
    monkeypatch.setattr(Study, "_summary", lambda _: {})
    run_stage = RunFolder.run_stage
    without_outputs = lambda folder, *args: run_stage(folder, *args[:3])  # noqa: E731
    monkeypatch.setattr(RunFolder, "run_stage", without_outputs)

    def run(data, config=QUICK) -> int:
        done.clear()
        Study(open_run_folder(tmp_path / "run", {}, resume=True), data, config).run()
        return len(done)

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
def test_every_stage_is_done_again_for_another(plane, stages_done, change):
    other = replace(plane, **CHANGES[change](plane))
    assert stages_done(plane) == N_STAGES
    assert stages_done(other) == N_STAGES


def test_every_stage_is_done_again_for_another_order_of_the_same_images(plane, stages_done):
    order = np.random.default_rng(0).permutation(len(plane))
    assert stages_done(plane) == N_STAGES
    assert stages_done(replace(plane, images=plane.images[order])) == N_STAGES


def test_every_stage_is_done_again_for_another_seed(plane, stages_done):
    assert stages_done(plane) == N_STAGES
    assert stages_done(plane, replace(QUICK, seed=1)) == N_STAGES


def test_no_stage_is_done_again_for_equal_data(plane, stages_done):
    equal = replace(
        plane,
        images=np.asfortranarray(plane.images),
        T_world_cam=plane.T_world_cam.copy(),
        T_world_ref=plane.T_world_ref.copy(),
    )
    assert stages_done(plane) == N_STAGES
    assert stages_done(equal) == 0
