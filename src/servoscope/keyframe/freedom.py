"""The displacements that a robot of some degrees of freedom can make and undo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.dofs import mask_of
from servoscope.keyframe.motion import adjoint, conjugate, displacement_by_twist
from servoscope.poses import (
    DOFS,
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
    rigid_transform,
)

Array = NDArray[np.float64]


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
        D = conjugate(inverse_transform(self.mount), inverse_transform(T))
        (delta_p,) = displacements_from_poses(np.eye(4), D[None], self.pivot)
        return delta_p if self.is_full else np.where(mask_of(self.dofs), delta_p, 0.0)

    def displacement(self, T: Array) -> Array:
        """The displacement of the reported frame, (4, 4), [m]."""
        if self.is_full:
            return conjugate(inverse_transform(self.mount), inverse_transform(T))
        return np.asarray(poses_from_displacements(np.eye(4), self.delta_p(T), self.pivot))

    def nearest(self, T: Array) -> Array:
        """The motion with the other dofs left out, (4, 4)."""
        if self.is_full:
            return T
        return inverse_transform(conjugate(self.mount, self.displacement(T)))

    def by_twist(self, displacement: Array) -> Array:
        """Derivative of the displacement about the pivot by a twist before T, shape (6, 6)."""
        P = rigid_transform(np.eye(3), [0.0, 0.0, self.pivot])
        about = displacement_by_twist(conjugate(P, displacement))
        return -about @ adjoint(inverse_transform(P) @ self.mount)

    def twists(self, T: Array) -> Array:
        """Twists before T that displace in one dof each, shape (6, n_dofs)."""
        if self.is_full:
            return np.eye(6)
        by_twist = self.by_twist(self.displacement(T))
        return np.asarray(np.linalg.inv(by_twist)[:, mask_of(self.dofs)])
