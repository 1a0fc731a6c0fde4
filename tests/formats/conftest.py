from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

HEADER = "name,tx,ty,tz,qx,qy,qz,qw"


class PoseFolder:
    """A folder of images with the texts that give their poses, to be damaged by tests."""

    def __init__(self, path: Path, n: int):
        rng = np.random.default_rng(0)
        self.path = path
        self.path.mkdir()
        self.names = [f"{i:02d}.png" for i in range(n)]
        self.images = rng.integers(0, 256, (n, 12, 16), dtype=np.uint8)
        self.translations = np.outer(np.arange(n), [0.01, 0.0, 0.0])
        self.quaternions = Rotation.from_rotvec(np.radians(rng.uniform(-2, 2, (n, 3)))).as_quat()
        self.times = 100.0 + 0.1 * np.arange(n)
        for name, image in zip(self.names, self.images, strict=True):
            self.write_image(name, image)

    @property
    def T_world_cam(self):
        T = np.tile(np.eye(4), (len(self.names), 1, 1))
        T[:, :3, :3] = Rotation.from_quat(self.quaternions).as_matrix()
        T[:, :3, 3] = self.translations
        return T

    @property
    def numbers(self):
        return np.hstack([self.translations, self.quaternions])

    def write_image(self, name, image):
        (self.path / name).parent.mkdir(exist_ok=True)
        assert cv2.imwrite(str(self.path / name), image)

    def rows(self, numbers=None):
        numbers = self.numbers if numbers is None else numbers
        return [
            ",".join([name, *map(repr, row.tolist())])
            for name, row in zip(self.names, numbers, strict=True)
        ]

    def write_csv(self, rows=None, header=HEADER, newline="\n", encoding="utf-8"):
        lines = [header, *(self.rows() if rows is None else rows)]
        (self.path / "poses.csv").write_bytes((newline.join(lines) + newline).encode(encoding))

    def write_tum(self, pose_times=None, numbers=None, image_times=None):
        image_times = self.times if image_times is None else image_times
        pose_times = self.times if pose_times is None else pose_times
        numbers = self.numbers if numbers is None else numbers
        images = zip(image_times, self.names, strict=True)
        poses = zip(pose_times, numbers.tolist(), strict=True)
        self.write_lines("rgb.txt", [f"{time:.6f} {name}" for time, name in images])
        self.write_lines(
            "groundtruth.txt", [f"{time:.6f} {' '.join(map(repr, row))}" for time, row in poses]
        )

    def write_lines(self, name, lines):
        (self.path / name).write_text("\n".join(["# a comment", *lines, ""]))


@pytest.fixture
def pose_folder(tmp_path):
    return PoseFolder(tmp_path / "source", 6)


@pytest.fixture
def rng():
    return np.random.default_rng(0)
