"""Real images with poses, where they lie beside the project; none of them is part of it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from servoscope import CameraModel, TumOptions, read_tum
from servoscope.poses import inverse_transform, is_rigid

SHARED = Path(__file__).parents[2] / "shared" / "data"

TUM_DELAY = 0.018
"""By how much the images of the sequence lag behind its poses, [s]: what is read of rotations is
off in proportion to the speed of turning."""


def read_kuka() -> tuple[np.ndarray, np.ndarray]:
    """Images and tool poses of a real arm's wrist camera."""
    poses = np.loadtxt(SHARED / "kuka_board" / "RobotPosesVec.txt").reshape(-1, 4, 4)
    images = np.stack([_grey(SHARED / "kuka_board" / f"im_{k:02d}.jpg") for k in range(1, 29)])
    images = np.stack([cv2.resize(i, (256, 160), interpolation=cv2.INTER_AREA) for i in images])
    return images, poses


def split_by_blocks(times: np.ndarray, gap: float, draw: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames to learn from, and those of 3 of 12 blocks that are kept out."""
    blocks = np.array_split(np.argsort(times), 12)
    kept_out = np.random.default_rng(draw).permutation(12)[:3]
    test = np.concatenate([blocks[k] for k in kept_out])
    train = np.setdiff1d(np.arange(len(times)), test)
    nearest = np.abs(times[train][:, None] - times[test]).min(axis=1)
    return train[nearest > gap], test


def evenly(indices: np.ndarray, n: int) -> np.ndarray:
    """At most n of them, evenly spread."""
    return indices[np.linspace(0, len(indices) - 1, min(n, len(indices))).round().astype(int)]


def read_tum_sequence(
    delay: float,
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray], CameraModel]:
    """The sequence, each image with the pose that was reported `delay` seconds before it."""
    options = TumOptions(reference_index=144, max_mm=150, max_deg=20, pivot_mm=0)
    source = SHARED / "tum_fr1_rpy"
    with tempfile.TemporaryDirectory() as folder:
        for name in ("rgb", "rgb.txt"):
            (Path(folder) / name).symlink_to(source / name)
        lines = (source / "groundtruth.txt").read_text().splitlines()
        rows = [line.split() for line in lines if not line.startswith("#")]
        text = "".join(f"{float(t) + delay:.6f} {' '.join(pose)}\n" for t, *pose in rows)
        (Path(folder) / "groundtruth.txt").write_text(text)
        data = read_tum(folder, options)
    camera = CameraModel.from_pixels(258.5, (159.1, 127.4), width=320, height=240)
    held = data.images, data.T_world_cam, data.times
    return held, (data.reference_image, data.T_world_ref), camera


def read_kitchen() -> tuple[
    tuple[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray], None
]:
    """Frames near one of them, without those that repeat the frame before."""
    reference = 251
    images, poses, numbers = read_kitchen_frames()
    at_reference = np.flatnonzero(numbers == reference)[0]
    D = inverse_transform(poses[at_reference]) @ poses
    angle = Rotation.from_matrix(D[:, :3, :3]).magnitude()
    near = (np.linalg.norm(D[:, :3, 3], axis=1) < 0.35) & (angle < np.radians(25))
    near[at_reference] = False
    held = images[near], poses[near], numbers[near].astype(float)
    return held, (images[at_reference], poses[at_reference]), None


def read_kitchen_frames() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All frames with their poses and numbers, without those that repeat the frame before."""
    folder = SHARED / "seven_scenes_kitchen"
    poses = np.stack([np.loadtxt(folder / f"frame-{k:06d}.pose.txt") for k in range(1000)])
    U, _, Vt = np.linalg.svd(poses[:, :3, :3])
    poses[:, :3, :3] = U @ Vt
    assert is_rigid(poses)
    images = np.stack([_grey(folder / f"frame-{k:06d}.jpg") for k in range(1000)])
    is_new = np.append(True, (images[1:] != images[:-1]).any(axis=(1, 2)))
    return images[is_new], poses[is_new], np.flatnonzero(is_new)


def _grey(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
