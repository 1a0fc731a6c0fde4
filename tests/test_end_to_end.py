"""From a bag to a controller: import, assess, train, export, and the exported model steers."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime", reason="the exported model runs under onnxruntime")
pytest.importorskip("rosbags", reason="the bag is written by rosbags")

from planar import PIVOT, RANGES, planar_images
from planar_cell import T_WORLD_REF, Cell
from recorded_bags import Recorder
from servoscope.cli import main
from servoscope.export.onnx_estimator import OnnxEstimator
from servoscope.poses import pose_error
from servoscope.positioning import Positioner
from small_keyframe import quick_fits

SIZE, N_IMAGES = 48, 64
ALONE = ("--jobs", "1")


class BagCell(Cell):
    """The cell at the size of the recording."""

    def read(self) -> np.ndarray:
        image = planar_images(self.delta_p[None], SIZE, seed=3)[0]
        return (
            np.rint(image + self.rng.normal(0, self.noise, image.shape)).clip(0, 255).astype("u1")
        )


def record(folder: Path) -> Path:
    """A robot that goes from pose to pose, stands, and is photographed: the reference first."""
    drawn = 0.8 * np.random.default_rng(0).uniform(-1, 1, (N_IMAGES, 6)) * RANGES
    with Recorder(folder, "mcap") as recorder:
        for k, delta_p in enumerate(np.vstack([np.zeros(6), drawn])):
            cell = BagCell(delta_p, noise=1.0 if k else 0.1)
            for wait in (0.0, 0.1, 0.2):
                time = 1000.0 + 2.0 * k + wait
                recorder.write("/pose", time, recorder.pose(time, cell.pose))
                if wait == 0.1:
                    recorder.write("/image", time, recorder.image(time, cell.read()))
    return recorder.path


@pytest.mark.slow
def test_a_model_exported_from_a_bag_brings_a_robot_back(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    bag = record(tmp_path)
    pivot = ["--pivot-mm", f"{1e3 * PIVOT:g}"]
    moved = ["--clock-offset", "0", "--reference-index", "0"]
    assert main(["import", "bag", str(bag), "data", *pivot, *moved]) == 0
    assess = ["assess", "data", "--out", "run", "--families", "moments", *ALONE]
    with quick_fits():
        assert main([*assess, "--tolerance", "t=0.5mm,r=0.1deg"]) == 0
        assert main(["train", "data", "--assessment", "run", "--out", "model", *ALONE]) == 0
    assert main(["export", "model", "model.onnx", "--check", "5"]) == 0
    capsys.readouterr()
    assert main(["info", "model", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "keyframe"
    positioner = Positioner(OnnxEstimator(tmp_path / "model.onnx"))
    for share in (0.6, -0.5):
        cell = BagCell(share * RANGES * [1, -1, 1, -1, 1, 1], noise=1.0)
        result = positioner.run(cell, cell)
        assert result.status == "converged", result.message
        distance, angle = pose_error(T_WORLD_REF, cell.pose)
        assert distance < 1e-3
        assert angle < np.radians(0.15)
