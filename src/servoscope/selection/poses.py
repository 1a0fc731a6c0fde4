"""The samples that count in a forecast: one for each pose, however often it was shot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.kernels.repeats import find_repeats, merge_repeats, whole_poses

Array = NDArray[np.float64]
Groups = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Poses:
    """Samples, the repeated shots of a pose joined to their mean.

    Parameters
    ----------
    X : ndarray of shape (n_poses, n_features)
    Y : ndarray of shape (n_poses, n_targets)
    groups : ndarray of shape (n_poses,), optional
        Which poses are left out together; by default each by itself.
    members : ndarray of shape (n_shots,)
        Which pose each shot is of.
    """

    X: Array
    Y: Array
    groups: Groups | None
    members: Groups

    def __len__(self) -> int:
        return len(self.X)

    @property
    def groups_of_shots(self) -> Groups | None:
        """Which shots are left out together; None where each shot is by itself."""
        if self.groups is not None:
            return self.groups[self.members]
        return self.members if len(self) < len(self.members) else None


def group_poses(X: Array, Y: Array, groups: Groups | None) -> Poses:
    """Samples by pose; what belongs together still does, and no pose is in two groups.

    Parameters
    ----------
    X, Y : ndarrays of shape (n, n_features) and (n, n_targets)
    groups : ndarray of shape (n,), optional
        Numbers from 0.
    """
    members = find_repeats(X, Y)
    merged = merge_repeats(X, Y, members)
    if groups is None:
        return Poses(*merged, None, members)
    if len(merged[0]) == len(X):
        return Poses(*merged, groups, members)
    whole = whole_poses(members, groups)
    _, first = np.unique(members, return_index=True)
    return Poses(*merged, whole[first], members)
