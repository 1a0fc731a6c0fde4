"""Real sequences beside the repository, where they are there; tests skip where they are not."""

import warnings
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from servoscope.data.images import PoseImageSet
from servoscope.errors import ServoscopeWarning
from servoscope.formats import TumOptions, read_tum
from servoscope.poses import pose_error, rigid_transform

FOLDER = Path(__file__).parents[2] / "shared" / "data"
SEQUENCES = ("desk", "desk_wide", "kitchen")


@cache
def real_sequence(name: str) -> PoseImageSet:
    """A real sequence around one of its frames; the test skips if it is not there."""
    if not FOLDER.is_dir():
        pytest.skip(f"no real sequences in {FOLDER}")
    if name == "kitchen":
        return _kitchen(FOLDER / "seven_scenes_kitchen")
    limits = {"desk": (150.0, 20.0), "desk_wide": (200.0, 30.0)}[name]
    options = TumOptions(
        reference_index=144, max_mm=limits[0], max_deg=limits[1], image_width=80, split="blocks"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ServoscopeWarning)  # what is left out is as it should be
        return read_tum(FOLDER / "tum_fr1_rpy", options)


def _kitchen(folder: Path) -> PoseImageSet:
    files = sorted(folder.glob("*.pose.txt"))
    T = np.stack([np.loadtxt(file) for file in files])
    u, _, v = np.linalg.svd(T[:, :3, :3])
    T = rigid_transform(u @ v, T[:, :3, 3])
    apart = [pose_error(T[i], T) for i in range(0, len(T), 10)]
    near = [(m < 0.35) & (angle < np.radians(25)) for m, angle in apart]
    best = int(np.argmax([ok.sum() for ok in near]))
    kept = np.flatnonzero(near[best])
    images = [
        cv2.resize(
            cv2.imread(str(files[i]).replace(".pose.txt", ".jpg"), 0), (80, 60), None, 0, 0, 3
        )
        for i in (10 * best, *kept)
    ]
    return PoseImageSet(
        np.stack(images[1:]), T[kept], T[10 * best], images[0], pivot=1.5,
        times=np.array([int(files[i].name[6:12]) / 30 for i in kept]), split="blocks",
    )  # fmt: skip
