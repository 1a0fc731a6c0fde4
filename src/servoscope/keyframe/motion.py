"""Small motions, how they change with the frame, and those that a robot of some dofs can make.

A twist is ``(v, w)``: a translation in metres and a rotation vector in radians. It moves a point q
by ``v + w x q`` to first order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import asin, atan2, cos, sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.compiled import compiled
from servoscope.dofs import mask_of
from servoscope.poses import DOFS, inverse_transform, rigid_transform

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
    twist = np.ascontiguousarray(twist, dtype=float)
    T = np.empty((*twist.shape[:-1], 4, 4))
    _write_exponentials(twist.reshape(-1, 6), T.reshape(-1, 4, 4))
    return T


@compiled(error_model="numpy")
def _write_exponentials(twists: NDArray[Any], T: NDArray[Any]) -> None:
    """By Rodrigues' formula; ``sin a / a`` and ``(1 - cos a) / a^2`` of small angles by series."""
    for i in range(twists.shape[0]):
        x, y, z = twists[i, 3], twists[i, 4], twists[i, 5]
        square = x * x + y * y + z * z
        if square < 1e-6:
            first = 1.0 - square / 6.0 * (1.0 - square / 20.0)
            second = 0.5 - square / 24.0 * (1.0 - square / 30.0)
        else:
            angle = np.sqrt(square)
            first, second = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
        T[i, 0, 0], T[i, 1, 1] = 1.0 - second * (y * y + z * z), 1.0 - second * (x * x + z * z)
        T[i, 2, 2] = 1.0 - second * (x * x + y * y)
        T[i, 0, 1], T[i, 1, 0] = second * x * y - first * z, second * x * y + first * z
        T[i, 0, 2], T[i, 2, 0] = second * x * z + first * y, second * x * z - first * y
        T[i, 1, 2], T[i, 2, 1] = second * y * z - first * x, second * y * z + first * x
        T[i, 0, 3], T[i, 1, 3], T[i, 2, 3] = twists[i, 0], twists[i, 1], twists[i, 2]
        T[i, 3, 0] = T[i, 3, 1] = T[i, 3, 2] = 0.0
        T[i, 3, 3] = 1.0


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


def _angles(R: Array) -> tuple[float, float, float]:
    """rx, ry and rz of ``R = Rz(rz) Ry(ry) Rx(rx)``, [rad]."""
    ry = -asin(min(1.0, max(-1.0, R[2, 0])))
    return atan2(R[2, 1], R[2, 2]), ry, atan2(R[1, 0], R[0, 0])


def displacement_by_twist(D_pivot: ArrayLike) -> Array:
    """Derivative of the six numbers of a displacement by a twist behind it, shape (6, 6).

    With ``D = D_pivot @ exp(twist)`` the translation changes by ``R v`` and the Euler angles,
    ``R = Rz(rz) Ry(ry) Rx(rx)``, by the inverse of the matrix of body rates (Diebel,
    "Representing attitude", 2006).
    """
    R = np.asarray(D_pivot, dtype=float)[:3, :3]
    rx, ry, _ = _angles(R)
    s, c, tangent = np.sin(rx), np.cos(rx), np.tan(ry)
    out = np.zeros((6, 6))
    out[:3, :3] = R
    out[3:, 3:] = [
        [1, s * tangent, c * tangent],
        [0, c, -s],
        [0, s / np.cos(ry), c / np.cos(ry)],
    ]
    return out


@dataclass(frozen=True, eq=False)
class Freedom:
    """Motions of a camera that some degrees of freedom of the reported frame make.

    Parameters
    ----------
    mount : ndarray of shape (4, 4)
        Camera coordinates to those of the frame whose poses are reported, [m].
    pivot : float
        Along z of that frame, [m].
    dofs : tuple of str
    """

    mount: Array
    pivot: float
    dofs: tuple[str, ...] = DOFS

    @property
    def is_full(self) -> bool:
        """Whether there are all six."""
        return self.dofs == DOFS

    def turning(self) -> Freedom:
        """The rotations alone; about the frame's origin if there are translations to be left out.

        For views so far away that translations are not seen.
        """
        turning = tuple(dof for dof in self.dofs if dof.startswith("r"))
        return self if turning == self.dofs else Freedom(self.mount, 0.0, turning)

    def delta_p(self, T: Array) -> Array:
        """The displacement about the pivot of a motion of the camera, (6,); 0 in other dofs.

        Parameters
        ----------
        T : ndarray of shape (4, 4)
            Reference camera to this camera.
        """
        D = self._about_pivot @ inverse_transform(T) @ self._from_pivot
        return np.where(self._mask, [*D[:3, 3], *_angles(D)], 0.0)

    def displacement(self, T: Array) -> Array:
        """The displacement of the reported frame, (4, 4), [m]."""
        if self.is_full:
            return conjugate(inverse_transform(self.mount), inverse_transform(T))
        P = rigid_transform(np.eye(3), [0.0, 0.0, self.pivot])
        return np.asarray(P @ _displaced(self.delta_p(T)) @ inverse_transform(P))

    def nearest(self, T: Array) -> Array:
        """The motion with the other dofs left out, (4, 4)."""
        if self.is_full:
            return T
        back = inverse_transform(_displaced(self.delta_p(T)))
        return np.asarray(self._from_pivot @ back @ self._about_pivot)

    def by_twist(self, displacement: Array) -> Array:
        """Derivative of the displacement about the pivot by a twist before T, shape (6, 6)."""
        P = rigid_transform(np.eye(3), [0.0, 0.0, self.pivot])
        return -displacement_by_twist(conjugate(P, displacement)) @ self._adjoint

    def twists(self, T: Array) -> Array:
        """Twists before T that displace in one dof each, shape (6, n_dofs).

        Of the rotations ``R = Rz(rz) Ry(ry) Rx(rx)`` each turns about an axis of its own.
        """
        if self.is_full:
            return np.eye(6)
        _, _, _, rx, ry, _ = delta_p = self.delta_p(T)
        behind = np.zeros((6, 6))
        behind[:3, :3] = _displaced(delta_p)[:3, :3].T
        sx, cx, sy, cy = sin(rx), cos(rx), sin(ry), cos(ry)
        behind[3:, 3:] = [[1, 0, -sy], [0, cx, sx * cy], [0, -sx, cx * cy]]
        return np.asarray(-self._inverse_adjoint @ behind[:, self._mask])

    @cached_property
    def _mask(self) -> NDArray[np.bool_]:
        return mask_of(self.dofs)

    @cached_property
    def _about_pivot(self) -> Array:
        """Camera coordinates to those about the pivot."""
        return rigid_transform(np.eye(3), [0.0, 0.0, -self.pivot]) @ self.mount

    @cached_property
    def _from_pivot(self) -> Array:
        return inverse_transform(self._about_pivot)

    @cached_property
    def _adjoint(self) -> Array:
        return adjoint(self._about_pivot)

    @cached_property
    def _inverse_adjoint(self) -> Array:
        return adjoint(self._from_pivot)


def _displaced(delta_p: Array) -> Array:
    """The motion of six numbers, (4, 4)."""
    tx, ty, tz, rx, ry, rz = delta_p
    sx, cx, sy, cy, sz, cz = sin(rx), cos(rx), sin(ry), cos(ry), sin(rz), cos(rz)
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx, tx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx, ty],
            [-sy, cy * sx, cy * cx, tz],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
