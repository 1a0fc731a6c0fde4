"""Camera poses, displacements from the reference, and how far two poses are apart.

Poses are 4 x 4 homogeneous matrices: ``T_world_cam`` maps camera coordinates to world
coordinates. Camera axes are x right, y down, z forward. Lengths are in metres and angles in
radians throughout.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.arrays import as_numbers
from servoscope.errors import InvalidInputError

DOFS = ("tx", "ty", "tz", "rx", "ry", "rz")
"""The degrees of freedom, in the order of every array that has one column for each."""

DISPLACEMENTS = ("pivot", "camera")
"""The two forms of a displacement: about a pivot on the optical axis, or about the camera."""

DISPLAY_UNITS = ("mm", "mm", "mm", "deg", "deg", "deg")
"""The units in which people are shown each degree of freedom."""

DOF_LABELS = {dof: dof.capitalize() for dof in DOFS}
"""``Tx`` for ``tx``, as the paper has it."""

DOF_UNITS = dict(zip(DOFS, DISPLAY_UNITS, strict=True))

DISPLAY_FACTORS = np.array([1e3, 1e3, 1e3, *(np.degrees(1.0),) * 3])
"""What turns metres and radians into `DISPLAY_UNITS`."""

FARTHEST = 1e8
"""Largest coordinate of a pose, [m]: beyond any on the earth."""

Array = NDArray[np.float64]


def rigid_transform(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Rigid transforms with the given rotations and translations.

    Parameters
    ----------
    rotation : array of shape (..., 3, 3)
        Rotation matrices.
    translation : array of shape (..., 3)
        Translations, [m].

    Returns
    -------
    ndarray of shape (..., 4, 4)

    Examples
    --------
    >>> rigid_transform(np.eye(3), [0.0, 0.0, 0.55])[:3, 3]
    array([0.  , 0.  , 0.55])
    """
    rotation, translation = np.asarray(rotation, dtype=float), np.asarray(translation, dtype=float)
    T = np.zeros((*np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1]), 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def inverse_transform(T: ArrayLike) -> Array:
    """Inverses of rigid transforms of shape (..., 4, 4), without a general matrix inversion.

    Examples
    --------
    >>> inverse_transform(rigid_transform(np.eye(3), [0.0, 0.0, 0.55]))[:3, 3]
    array([-0.  , -0.  , -0.55])
    """
    T = np.asarray(T, dtype=float)
    R_inv = np.swapaxes(T[..., :3, :3], -1, -2)
    return rigid_transform(R_inv, -np.einsum("...ij,...j->...i", R_inv, T[..., :3, 3]))


def is_rigid(T: ArrayLike, tolerance: float = 1e-4) -> bool:
    """Whether all matrices of shape (..., 4, 4) are rotations with a translation.

    Examples
    --------
    >>> is_rigid(np.eye(4)), is_rigid(2 * np.eye(4)), is_rigid(np.diag([1.0, 1.0, -1.0, 1.0]))
    (True, False, False)
    """
    T = np.asarray(T, dtype=float)
    R = T[..., :3, :3]
    orthonormal = np.abs(np.swapaxes(R, -1, -2) @ R - np.eye(3)) < tolerance
    last_row = np.abs(T[..., 3, :] - [0.0, 0.0, 0.0, 1.0]) < tolerance
    return bool(orthonormal.all() and last_row.all() and (np.linalg.det(R) > 0).all())


def nearest_rigid(T: ArrayLike) -> Array:
    """The rigid transform whose rotation is nearest to that of a matrix, which may be off a little.

    Examples
    --------
    >>> nearest_rigid(np.diag([1.001, 0.999, 1.0, 1.0]))[:3, :3].round(9)
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    T = np.asarray(T, dtype=float)
    u, _, v = np.linalg.svd(T[..., :3, :3])
    u[..., 2] *= np.linalg.det(u @ v)[..., None]
    return rigid_transform(u @ v, T[..., :3, 3])


def as_rigid(T: ArrayLike, name: str) -> Array:
    """A rigid transform as a new array of shape (4, 4).

    Examples
    --------
    >>> as_rigid(np.eye(3), "T_world_cam")
    Traceback (most recent call last):
    servoscope.errors.InvalidInputError: T_world_cam must be a finite rigid transform of shape \
(4, 4), got [[1. 0. 0.] [0. 1. 0.] [0. 0. 1.]].
    """
    T = np.array(as_numbers(T, name))
    if T.shape != (4, 4) or not np.isfinite(T).all() or not is_rigid(T):
        shown = " ".join(np.array2string(T, precision=3, threshold=16).split())
        raise InvalidInputError(
            f"{name} must be a finite rigid transform of shape (4, 4), got {shown}."
        )
    return T


def poses_from_quaternions(translation: ArrayLike, quaternion_xyzw: ArrayLike) -> Array:
    """Rigid transforms from translations and scalar-last quaternions.

    Parameters
    ----------
    translation : array of shape (n, 3)
        [m].
    quaternion_xyzw : array of shape (n, 4)
        Scalar last; need not have unit length.

    Returns
    -------
    ndarray of shape (n, 4, 4)

    Raises
    ------
    InvalidInputError
        If a number is NaN or infinite, a translation goes beyond `FARTHEST`, or a quaternion has
        zero length or one above 1e6.

    Examples
    --------
    >>> poses_from_quaternions([[1.0, 0.0, 0.0]], [[0.0, 0.0, 0.0, 2.0]])[0, :3, 3]
    array([1., 0., 0.])
    """
    translation = np.atleast_2d(np.asarray(translation, dtype=float))
    quaternion_xyzw = np.atleast_2d(np.asarray(quaternion_xyzw, dtype=float))
    for what, values in (("translation", translation), ("quaternion", quaternion_xyzw)):
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise InvalidInputError(
                f"Every {what} must be finite, but number {bad[0]} is {values[bad[0]].tolist()} "
                f"({bad.size} in all); remove or mend those poses."
            )
    bad = np.flatnonzero(np.abs(translation).max(axis=1, initial=0.0) > FARTHEST)
    if bad.size:
        raise InvalidInputError(
            f"A translation must be within {FARTHEST:g} m, but number {bad[0]} is "
            f"{translation[bad[0]].tolist()} m ({bad.size} in all); check the units."
        )
    largest = np.abs(quaternion_xyzw).max(axis=1, initial=0.0)
    bad = np.flatnonzero((largest < 1e-6) | (largest > 1e6))
    if bad.size:
        what = "zero length" if largest[bad[0]] < 1e-6 else "a length above 1e6"
        raise InvalidInputError(
            f"A quaternion must not have {what}, but number {bad[0]} is "
            f"{quaternion_xyzw[bad[0]].tolist()} ({bad.size} in all); remove those poses."
        )
    return rigid_transform(Rotation.from_quat(quaternion_xyzw).as_matrix(), translation)


def quaternions_xyzw(T: ArrayLike) -> Array:
    """Scalar-last unit quaternions, scalar not negative, of rigid transforms of shape (n, 4, 4)."""
    return Rotation.from_matrix(np.asarray(T)[..., :3, :3]).as_quat(canonical=True)


def displacements_from_poses(T_world_ref: ArrayLike, T_world_cam: ArrayLike, pivot: float) -> Array:
    """Displacement of each camera pose from the reference.

    With ``P = translation(0, 0, pivot)`` and ``D = inv(T_world_ref) @ T_world_cam``, the
    displacement about the pivot is ``D_pivot = inv(P) @ D @ P``. Its translation and its Euler
    angles, ``R = Rz(rz) Ry(ry) Rx(rx)``, are the six numbers.

    Parameters
    ----------
    T_world_ref : array of shape (4, 4)
    T_world_cam : array of shape (n, 4, 4)
    pivot : float
        Distance of the pivot from the camera along the optical axis, [m]. 0 gives the
        displacement of the camera itself.

    Returns
    -------
    delta_p : ndarray of shape (n, 6)
        [m] and [rad], in `DOFS` order.

    Examples
    --------
    >>> T = rigid_transform(np.eye(3), [[0.01, 0.0, 0.0]])
    >>> displacements_from_poses(np.eye(4), T, pivot=0.55).round(3)
    array([[0.01, 0.  , 0.  , 0.  , 0.  , 0.  ]])
    """
    P = rigid_transform(np.eye(3), [0.0, 0.0, pivot])
    D = inverse_transform(P) @ inverse_transform(T_world_ref) @ np.asarray(T_world_cam) @ P
    angles = Rotation.from_matrix(D[..., :3, :3]).as_euler("xyz")
    return np.concatenate([D[..., :3, 3], angles], axis=-1)


def poses_from_displacements(T_world_ref: ArrayLike, delta_p: ArrayLike, pivot: float) -> Array:
    """Camera poses at the given displacements; undoes `displacements_from_poses`.

    Parameters
    ----------
    T_world_ref : array of shape (4, 4)
    delta_p : array of shape (n, 6)
        [m] and [rad], in `DOFS` order.
    pivot : float
        Distance of the pivot from the camera along the optical axis, [m].

    Returns
    -------
    T_world_cam : ndarray of shape (n, 4, 4)
    """
    delta_p = np.asarray(delta_p, dtype=float)
    P = rigid_transform(np.eye(3), [0.0, 0.0, pivot])
    R = Rotation.from_euler("xyz", delta_p[..., 3:]).as_matrix()
    D_pivot = rigid_transform(R, delta_p[..., :3])
    return np.asarray(T_world_ref) @ P @ D_pivot @ inverse_transform(P)


def displacement_ranges(pivot_ranges: ArrayLike, pivot: float, displacement: str) -> Array:
    """Displacement of each dof that an acquisition about a pivot reaches.

    In the camera form the rotations about x and y carry the camera sideways, so that tx and ty
    reach ``t + pivot sin(r)``, the "+-167 mm" of the paper, and backwards, so that tz reaches
    ``t + pivot (1 - cos(rx) cos(ry))``. A rotation about z swings the few poses in the corners
    of the range a little farther in x and y.

    Parameters
    ----------
    pivot_ranges : array of shape (6,)
        Half-widths of the sampled displacements about the pivot, [m] and [rad].
    pivot : float
        [m].
    displacement : {"pivot", "camera"}

    Returns
    -------
    ndarray of shape (6,)
        [m] and [rad].

    Examples
    --------
    >>> r = [0.025] * 3 + [np.radians(15)] * 3
    >>> (1e3 * displacement_ranges(r, 0.55, "camera")[:3]).round()
    array([167., 167.,  62.])
    """
    ranges = np.array(pivot_ranges, dtype=float)
    if check_displacement(displacement) == "camera":
        _, _, _, rx, ry, _ = ranges
        ranges[:3] += pivot * np.array([np.sin(ry), np.sin(rx), 1 - np.cos(rx) * np.cos(ry)])
    return ranges


def check_displacement(displacement: str) -> str:
    """`displacement` itself, if it is one of `DISPLACEMENTS`."""
    if displacement not in DISPLACEMENTS:
        raise InvalidInputError(
            f"displacement must be one of {', '.join(DISPLACEMENTS)}, got {displacement!r}."
        )
    return displacement


def pose_error(T_a: ArrayLike, T_b: ArrayLike) -> tuple[Array, Array]:
    """Distance [m] and angle [rad] between poses of shape (..., 4, 4).

    Examples
    --------
    >>> distance, angle = pose_error(np.eye(4), rigid_transform(np.eye(3), [0.0, 3e-3, 4e-3]))
    >>> round(float(distance), 6), float(angle)
    (0.005, 0.0)
    """
    T_a, T_b = np.asarray(T_a, dtype=float), np.asarray(T_b, dtype=float)
    distance = np.linalg.norm(T_a[..., :3, 3] - T_b[..., :3, 3], axis=-1)
    return distance, rotation_angle(np.swapaxes(T_a[..., :3, :3], -1, -2) @ T_b[..., :3, :3])


def rotation_angle(R: ArrayLike) -> Array:
    """By how much rotations of shape (..., 3, 3) turn, [rad].

    Examples
    --------
    >>> float(rotation_angle([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])) == np.pi / 2
    True
    """
    R = np.asarray(R, dtype=float)
    axis = R[..., [2, 0, 1], [1, 2, 0]] - R[..., [1, 2, 0], [2, 0, 1]]  # twice its sine long
    cosine = R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1  # twice
    return np.arctan2(np.sqrt(np.sum(axis * axis, axis=-1)), cosine)
