"""A small keyframe model of a bumpy plate, made without training, and images that it reads."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

from servoscope.dofs import mask_of
from servoscope.keyframe import CameraModel, Keyframe, fitting
from servoscope.poses import DOFS, poses_from_displacements, rigid_transform
from servoscope.positioning.first_guess import FirstGuess
from servoscope.positioning.keyframe_model import KeyframeModel

PIVOT = 0.5
REACH = np.array([0.02, 0.02, 0.02, 0.15, 0.15, 0.2])
MOUNT = rigid_transform(cv2.Rodrigues(np.array([0.02, -0.03, 0.5]))[0], [0.03, -0.02, 0.05])


def texture(shape: tuple[int, int], seed: int, lo: float = 20, hi: float = 240) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=shape)
    smooth = cv2.GaussianBlur(noise, (0, 0), 0.03 * shape[1])
    return cv2.normalize(smooth, None, lo, hi, cv2.NORM_MINMAX)


def displacements(n: int, dofs=DOFS, seed: int = 1, share: float = 0.6) -> np.ndarray:
    drawn = np.random.default_rng(seed).uniform(-share, share, (n, 6)) * REACH * mask_of(dofs)
    return poses_from_displacements(np.eye(4), drawn, PIVOT)


def small_model(
    shape: tuple[int, int] = (48, 64),
    dofs=DOFS,
    *,
    reads=None,
    depth: float | None = None,
    guesses: bool = True,
) -> KeyframeModel:
    reads = dofs if reads is None else reads
    bumps = texture((24, 32), 5, 1.8, 2.2) if depth is None else np.full((24, 32), depth)
    trust = np.ones((24, 32), np.float32)
    trust[:3, :4] = 0
    seen = displacements(12, reads)
    keyframe = Keyframe(
        texture(shape, 0).round().astype(np.uint8), CameraModel(1.4, 0.01, -0.02, -0.05, 0.02),
        MOUNT, bumps.astype(np.float32), trust, seen, np.zeros((20, 20)), np.full(6, 1e-4), PIVOT,
        1.0, 1.0, dofs=reads,
    )  # fmt: skip
    reach = REACH * mask_of(reads)
    first_guess = None
    if guesses:
        images = np.stack([keyframe.render(D)[0] for D in seen])
        first_guess = FirstGuess.train(keyframe, reach, images, seen, n_rendered=100)
    return KeyframeModel(
        keyframe, first_guess=first_guess, reach=reach, dofs=dofs,
        accuracy={"least_similarity": 0.8, "median": {"tx": 0.1}, "quantile_90": {"tx": 0.3}},
    )  # fmt: skip


@contextmanager
def quick_fits(n_rendered: int = 400) -> Iterator[None]:
    """Learn first guesses from few rendered images, search the mount among few turns, and fit the
    relief at 64 pixels of width, where that is not the matter.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(FirstGuess.train.__kwdefaults__, "n_rendered", n_rendered)
        patch.setattr(fitting, "_N_ROTATIONS", 150)
        patch.setattr(fitting, "_N_STARTS", 6)
        patch.setattr(fitting, "_RELIEF_LEVELS", ((48, 1.0, 32), (64, 1.0, 24)))
        yield


def shown(model: KeyframeModel, n: int = 3) -> np.ndarray:
    """The reference image, and others with noise, under another lamp, and partly covered."""
    rng = np.random.default_rng(2)
    images = [model.reference_image]
    for D in displacements(n, model.keyframe.dofs, seed=3):
        grey = model.keyframe.render_grey(D)[0] + rng.normal(size=model.image_shape)
        images.append(grey)
    height, width = model.image_shape
    images[-1] = images[-1] * np.linspace(0.9, 1.3, width)
    images[-2][: height // 3, : width // 3] = 128
    return np.stack([np.rint(image).clip(0, 255).astype(np.uint8) for image in images])
