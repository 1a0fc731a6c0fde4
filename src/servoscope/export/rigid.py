"""Rigid transforms, angles and small systems of equations, as parts of a graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.dofs import mask_of
from servoscope.export.graph import Value, concatenate, maximum, stack, where
from servoscope.keyframe.motion import Freedom, adjoint, skew
from servoscope.poses import inverse_transform, rigid_transform

Array = NDArray[np.float64]

_TINY = 1e-12


def solve(A: Value, B: Value, n: int) -> Value:
    """The X with ``A X = B``, for an A of shape (n, n) that is symmetric and positive definite.

    By the elimination of Gauss and Jordan, which needs no pivots there.
    """
    graph = A.graph
    units = graph.constant(np.eye(n))

    def eliminate(k: Value, state: list[Value]) -> tuple[None, list[Value], list[Value]]:
        (M,) = state
        row, column = M.take(k), M.take(k, axis=1)
        factor = (column - units.take(k)) / row.take(k)
        return None, [M - factor.reshape(n, 1) * row.reshape(1, -1)], []

    (M,), _ = graph.loop(n, [concatenate([A, B], axis=1)], eliminate)
    return M[:, n:]


def angle(y: Value, x: Value) -> Value:
    """The angle of a point from the x axis, -pi to pi, [rad]; double precision from single.

    The arctangent of onnxruntime is of single precision: a step of Newton makes up for it.
    """
    r = maximum((x * x + y * y).sqrt(), 1e-300)
    near = (y / maximum(r + x, _TINY * r)).cast(np.float32)
    rough = 2.0 * y.graph.apply("Atan", near).cast(np.float64)
    fine = rough + (y * cosine(rough) - x * sine(rough)) / r
    return where(r + x > 1e-9 * r, fine, np.pi)


def sine(x: Value) -> Value:
    """Of an angle."""
    return x.graph.apply("Sin", x)


def cosine(x: Value) -> Value:
    """Of an angle; many versions of onnxruntime have no cosine of double precision."""
    return sine(x + 0.5 * np.pi)


def rigid(R: Value, t: Value) -> Value:
    """The transform of a rotation (3, 3) and a translation of three numbers."""
    return concatenate([concatenate([R, t.reshape(3, 1)], axis=1), [[0, 0, 0, 1]]])


def inverse(T: Value) -> Value:
    """The inverse of a rigid transform."""
    back = T[:3, :3].transpose(1, 0)
    return rigid(back, -(back @ T[:3, 3:]))


def cross(w: Value) -> Value:
    """The matrix (3, 3) that takes q to ``w x q``."""
    return (w.reshape(1, 3) @ skew(np.eye(3)).reshape(3, 9)).reshape(3, 3)


def exponential(twist: Value) -> Value:
    """The transform of a twist, as `servoscope.keyframe.motion.exponential`."""
    w = twist[3:]
    theta = maximum(w.norm(), _TINY)
    K, half = cross(w), sine(0.5 * theta) / theta
    R = np.eye(3) + (sine(theta) / theta) * K + (2.0 * half * half) * (K @ K)
    return rigid(R, twist[:3])


def rotation_angle(T: Value) -> Value:
    """By how much a transform turns, [rad]."""
    sines = 0.5 * stack([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]], 3).norm()
    return angle(sines, 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1.0))


class Turns:
    """Sines and cosines of the Euler angles of ``R = Rz(rz) Ry(ry) Rx(rx)``, each of shape (3,)."""

    def __init__(self, sines: Value, cosines: Value) -> None:
        self.sines, self.cosines = sines, cosines

    @classmethod
    def of(cls, D: Value) -> Turns:
        """Of a transform."""
        lengths = [(a * a + b * b).sqrt() for a, b in ((D[2, 1], D[2, 2]), (D[1, 0], D[0, 0]))]
        lx, lz = (maximum(length, 1e-300) for length in lengths)
        sy = (-D[2, 0]).clip(-1.0, 1.0)
        sines = stack([D[2, 1] / lx, sy, D[1, 0] / lz], 3)
        return cls(sines, stack([D[2, 2] / lx, (1.0 - sy * sy).sqrt(), D[0, 0] / lz], 3))

    def only(self, taken: NDArray[np.bool_]) -> Turns:
        """The same with all angles 0 that are not taken."""
        share = taken.astype(float)
        return Turns(self.sines * share, self.cosines * share + (1.0 - share))

    def angles(self) -> Value:
        """The three, [rad]."""
        return stack([angle(self.sines[k], self.cosines[k]) for k in range(3)], 3)

    def rotation(self) -> Value:
        """The matrix, (3, 3)."""
        (sx, sy, sz), (cx, cy, cz) = ([x[k] for k in range(3)] for x in (self.sines, self.cosines))
        about_x = stack([1, 0, 0, 0, cx, -sx, 0, sx, cx], 3, 3)
        about_y = stack([cy, 0, sy, 0, 1, 0, -sy, 0, cy], 3, 3)
        about_z = stack([cz, -sz, 0, sz, cz, 0, 0, 0, 1], 3, 3)
        return about_z @ about_y @ about_x


def about_pivot(six: Value) -> Value:
    """The displacement about the pivot, (4, 4), of its six numbers."""
    angles = six[3:]
    return rigid(Turns(sine(angles), cosine(angles)).rotation(), six[:3])


class Motions:
    """What `servoscope.keyframe.motion.Freedom` does, in a graph.

    Parameters
    ----------
    freedom : Freedom
    """

    def __init__(self, freedom: Freedom) -> None:
        to_pivot = rigid_transform(np.eye(3), [0.0, 0.0, -freedom.pivot])
        self.n_dofs, self.is_full = len(freedom.dofs), freedom.is_full
        self._about, self._mount = to_pivot @ freedom.mount, freedom.mount
        self._from, self._to_pivot = inverse_transform(self._about), to_pivot
        self._taken = mask_of(freedom.dofs)

    def about_pivot(self, T: Value) -> Value:
        """The displacement about the pivot, (4, 4), whatever dofs it is in."""
        return self._about @ inverse(T) @ self._from

    def delta_p(self, T: Value) -> Value:
        """Its six numbers, [m] and [rad]; 0 in other dofs."""
        D = self.about_pivot(T)
        six = concatenate([D[:3, 3], Turns.of(D).angles()])
        return six if self.is_full else six * self._taken.astype(float)

    def displacement(self, T: Value) -> Value:
        """The displacement of the reported frame, (4, 4), [m]."""
        D = self.about_pivot(T)
        D = D if self.is_full else self._in_dofs(D)
        return inverse_transform(self._to_pivot) @ D @ self._to_pivot

    def nearest(self, T: Value) -> Value:
        """The motion of the camera with the other dofs left out."""
        if self.is_full:
            return T
        return self._from @ inverse(self._in_dofs(self.about_pivot(T))) @ self._about

    def of_six(self, six: Value) -> tuple[Value, Value]:
        """The displacement of the reported frame, and the motion of the camera, of six numbers."""
        D = about_pivot(six)
        displacement = inverse_transform(self._to_pivot) @ D @ self._to_pivot
        return displacement, self._from @ inverse(D) @ self._about

    def twists(self, T: Value) -> Value:
        """Twists before T that displace in one dof each, (6, n_dofs)."""
        if self.is_full:
            return T.graph.constant(np.eye(6))
        D = self.about_pivot(T)
        turns = Turns.of(D).only(self._taken[3:])
        (sx, sy, _), (cx, cy, _) = ([x[k] for k in range(3)] for x in (turns.sines, turns.cosines))
        rates = stack([1, 0, -sy, 0, cx, sx * cy, 0, -sx, cx * cy], 3, 3)
        zeros = np.zeros((3, 3))
        upper = concatenate([turns.rotation().transpose(1, 0), zeros], axis=1)
        behind = concatenate([upper, concatenate([zeros, rates], axis=1)])
        taken = np.flatnonzero(self._taken)
        return (-adjoint(self._from) @ behind).take(taken, axis=1)

    def by_twist(self, T: Value) -> Value:
        """Derivative of the six numbers by a twist before T, (6, 6)."""
        D = self.about_pivot(T)
        D = D if self.is_full else self._in_dofs(D)
        turns = Turns.of(D)
        (sx, sy, _), (cx, cy, _) = ([x[k] for k in range(3)] for x in (turns.sines, turns.cosines))
        tangent = sy / cy
        rates = stack([1, sx * tangent, cx * tangent, 0, cx, -sx, 0, sx / cy, cx / cy], 3, 3)
        zeros = np.zeros((3, 3))
        upper = concatenate([D[:3, :3], zeros], axis=1)
        return -concatenate([upper, concatenate([zeros, rates], axis=1)]) @ adjoint(self._about)

    def _in_dofs(self, D: Value) -> Value:
        turns = Turns.of(D).only(self._taken[3:])
        return rigid(turns.rotation(), D[:3, 3] * self._taken[:3].astype(float))
