"""Small motions: twists, their exponentials, and how they change with the frame.

A twist is ``(v, w)``: a translation in metres and a rotation vector in radians. It moves a point q
by ``v + w x q`` to first order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.poses import inverse_transform, rigid_transform

Array = NDArray[np.float64]


def skew(w: ArrayLike) -> Array:
    """Matrices of shape (..., 3, 3) with ``skew(w) @ q = w x q``."""
    w = np.asarray(w, dtype=float)
    out = np.zeros((*w.shape, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = w[..., 0], w[..., 1], w[..., 2]
    return out - np.swapaxes(out, -1, -2)


def exponential(twist: ArrayLike) -> Array:
    """Rigid transforms of shape (..., 4, 4): first the rotation vector, then the translation.

    It is a retraction, equal to the exponential of SE(3) to first order.
    """
    twist = np.asarray(twist, dtype=float)
    R = Rotation.from_rotvec(twist[..., 3:].reshape(-1, 3)).as_matrix()
    return rigid_transform(R.reshape(*twist.shape[:-1], 3, 3), twist[..., :3])


def logarithm(T: ArrayLike) -> Array:
    """Twists of shape (..., 6) whose `exponential` is T."""
    T = np.asarray(T, dtype=float)
    w = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([T[..., :3, 3], w.reshape(*T.shape[:-2], 3)], axis=-1)


def adjoint(T: ArrayLike) -> Array:
    """Matrices of shape (..., 6, 6) with ``T exp(twist) = exp(adjoint(T) twist) T``."""
    T = np.asarray(T, dtype=float)
    R = T[..., :3, :3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew(T[..., :3, 3]) @ R
    return out


def conjugate(X: ArrayLike, D: ArrayLike) -> Array:
    """``inv(X) @ D @ X``: a displacement in the frame that X maps to the frame of D."""
    return inverse_transform(X) @ np.asarray(D, dtype=float) @ np.asarray(X, dtype=float)


def displacement_by_twist(D_pivot: ArrayLike) -> Array:
    """Derivative of the six numbers of a displacement by a twist behind it, shape (6, 6).

    With ``D = D_pivot @ exp(twist)`` the translation changes by ``R v`` and the Euler angles,
    ``R = Rz(rz) Ry(ry) Rx(rx)``, by the inverse of the matrix of body rates (Diebel,
    "Representing attitude", 2006).
    """
    R = np.asarray(D_pivot, dtype=float)[:3, :3]
    rx, ry, _ = Rotation.from_matrix(R).as_euler("xyz")
    s, c, tangent = np.sin(rx), np.cos(rx), np.tan(ry)
    out = np.zeros((6, 6))
    out[:3, :3] = R
    out[3:, 3:] = [
        [1, s * tangent, c * tangent],
        [0, c, -s],
        [0, s / np.cos(ry), c / np.cos(ry)],
    ]
    return out
