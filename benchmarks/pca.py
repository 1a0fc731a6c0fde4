"""The leading eigenvectors of a set of images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from sklearn.decomposition import PCA

from benchmarks.scenery import displaced_images
from benchmarks.timing import Contender, Table, race
from servoscope.features import compute_image_basis

N_COMPONENTS = 35


def tables(quick: bool) -> Iterator[Table]:
    """One table."""
    n_images, size = (200, 128) if quick else (1000, 256)
    images, _ = displaced_images(n_images, size)
    yield Table(
        "PCA",
        f"{N_COMPONENTS} eigenvectors of {n_images} images of {size} x {size}",
        race(_contenders(images), repeats=3),
    )


def _contenders(images: np.ndarray) -> list[Contender]:
    X = images.reshape(len(images), -1).astype(np.float32)
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    eigenvalues = compute_image_basis(images, N_COMPONENTS).eigenvalues
    contenders = [
        Contender(
            "servoscope",
            lambda: compute_image_basis(images, N_COMPONENTS),
            remark="from uint8, brightness normalised",
        )
    ]
    for solver in ("arpack", "randomized"):
        pca = PCA(N_COMPONENTS, svd_solver=solver, random_state=0)
        error = np.abs(pca.fit(X).singular_values_ ** 2 / eigenvalues - 1).max()
        remark = f"from normalised float32; eigenvalues within {error:.1g} of ours"
        contenders.append(
            Contender(f"sklearn PCA {solver}", lambda pca=pca: pca.fit(X), remark=remark)
        )
    return contenders
