import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

SCRIPT = Path(__file__).parents[2] / "examples" / "own_images.py"


@pytest.fixture
def sliding_camera(tmp_path):
    """200 images by a camera that slides above a bright patch and turns about its axis."""
    rng = np.random.default_rng(0)
    mm, deg = rng.uniform(-20, 20, (200, 2)), rng.uniform(-15, 15, 200)
    plane = np.zeros((96, 128), np.uint8)
    cv2.ellipse(plane, (64, 48), (30, 14), 20, 0, 360, 120, -1)
    lines = ["name,tx,ty,tz,qx,qy,qz,qw"]
    for i in range(200):
        M = cv2.getRotationMatrix2D((64, 48), deg[i], 1.0)
        M[:, 2] -= M[:, :2] @ mm[i]
        assert cv2.imwrite(str(tmp_path / f"{i}.png"), cv2.warpAffine(plane, M, (128, 96)))
        quaternion = Rotation.from_euler("z", deg[i], degrees=True).as_quat()
        lines.append(",".join([f"{i}.png", *map(str, [*mm[i] / 1e3, 0.0, *quaternion])]))
    (tmp_path / "poses.csv").write_text("\n".join(lines))
    return tmp_path


def run(*arguments):
    return subprocess.run(
        [sys.executable, "-W", "error", SCRIPT, *arguments], capture_output=True, text=True
    )


def test_the_example_finds_the_features_of_the_dofs_that_move(sliding_camera):
    finished = run(sliding_camera)
    assert finished.returncode == 0, finished.stderr
    rows = {line.split()[0]: line for line in finished.stdout.splitlines()}
    assert all(float(rows[dof].split()[3]) > 1.0 for dof in ("tx", "ty", "rz"))
    assert all("does not move" in rows[dof] for dof in ("tz", "rx", "ry"))
    assert "theta_150" in rows["rz"]


def test_the_example_says_how_it_is_called():
    finished = run()
    assert finished.returncode == 1
    assert "own_images.py FOLDER" in finished.stderr
