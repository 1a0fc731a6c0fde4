"""Directions in image space that tell the pose and its products best."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from servoscope.poses import DOFS
from servoscope.processes import one_blas_thread

RIDGE = 1e-2
"""Added to the variance of every value, as a share of their mean variance."""

PRODUCTS = [(i, j) for i in range(len(DOFS)) for j in range(i, len(DOFS))]


def compute_pose_vectors(
    prepared: NDArray[np.float32], delta_p: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Ridge regressions of the displacement and of its products of two on prepared images.

    Parameters
    ----------
    prepared : ndarray of shape (n, n_values), float32
        Of more than one image for a pose, these being disturbed copies of it, the directions
        turn away from what disturbances change.
    delta_p : ndarray of shape (n, 6)
        In units of the range.

    Returns
    -------
    ndarray of shape (27, n_values), float32
        Those of the six dofs, then of their 21 products in the order of `PRODUCTS`.

    Notes
    -----
    A pose-image covariance vector (eq. 13 of the paper) is ``X^T p``; this is
    ``(X^T X + r I)^-1 X^T p``, in which the dofs are told apart.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> delta_p = rng.uniform(-1, 1, (500, 6))
    >>> vectors = compute_pose_vectors((2 * delta_p).astype(np.float32), delta_p)
    >>> np.allclose(vectors[:6], np.eye(6) / 2, atol=0.02)
    True
    """
    centred = prepared - prepared.mean(axis=0)
    products = [delta_p[:, i] * delta_p[:, j] for i, j in PRODUCTS]
    targets = np.column_stack([delta_p, *products]).astype(np.float32)
    with one_blas_thread():
        scatter = (centred.T @ centred).astype(np.float64)
        scatter[np.diag_indices_from(scatter)] += max(
            RIDGE * np.trace(scatter) / len(scatter), 1e-9
        )
        covariance = centred.T @ (targets - targets.mean(axis=0))
        return scipy.linalg.solve(scatter, covariance, assume_a="pos").T.astype(np.float32)


def pose_vector_names() -> list[str]:
    """Names of the directions that `compute_pose_vectors` gives.

    Examples
    --------
    >>> pose_vector_names()[0], pose_vector_names()[7]
    ('pose_tx', 'pose_tx_ty')
    """
    names = [*DOFS, *(f"{DOFS[i]}_{DOFS[j]}" for i, j in PRODUCTS)]
    return [f"pose_{name}" for name in names]
