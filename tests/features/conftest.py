"""Images of a smooth random pattern that moves with six degrees of freedom."""

import cv2
import numpy as np
import pytest


@pytest.fixture(scope="session")
def delta_p():
    return np.random.default_rng(1).uniform(-1, 1, (60, 6))


@pytest.fixture(scope="session")
def images(delta_p):
    rng = np.random.default_rng(2)
    pattern = cv2.GaussianBlur(rng.normal(size=(90, 90)), (0, 0), 4)
    pattern = cv2.normalize(pattern, None, 0, 255, cv2.NORM_MINMAX)
    taken = [cv2.warpAffine(pattern, _motion(p), (40, 30)) for p in delta_p]
    noisy = np.array(taken) + rng.normal(scale=2, size=(len(taken), 30, 40))
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.fixture(scope="session")
def normalised(images):
    """Centred rows of eq. 9, in float64."""
    flat = images.reshape(len(images), -1).astype(float)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return flat - flat.mean(axis=0)


def _motion(p):
    matrix = cv2.getRotationMatrix2D((45, 45), 15 * p[5], 1 + 0.1 * p[2])
    matrix[0, 1] += 0.1 * p[3]
    matrix[1, 0] += 0.1 * p[4]
    matrix[:, 2] += [4 * p[0] - 25, 4 * p[1] - 30]
    return matrix
