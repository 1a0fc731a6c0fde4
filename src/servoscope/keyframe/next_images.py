"""Which images to take next: those that make what is read most accurate."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.arrays import as_numbers
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.keyframe.information import KeyframeInformation
from servoscope.keyframe.keyframe import Keyframe
from servoscope.poses import displacements_from_poses
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

N_CANDIDATES = 200
"""Displacements that are drawn to be chosen from."""

N_APART = 10
"""Of these, as many as lie farthest from the images there are compete."""

N_READ = 40
"""Displacements at which the accuracy of a look is predicted."""


def next_displacements(
    keyframe: Keyframe,
    n: int,
    ranges: ArrayLike,
    *,
    pose_noise: tuple[float, float] = (3e-4, 5e-4),
    scale: ArrayLike | None = None,
    random_state: int | np.random.Generator = 0,
) -> Array:
    """Displacements at which the next images should be taken.

    Of `N_CANDIDATES` that are drawn evenly from the range, those are chosen, one after the other,
    that most reduce the expected square of what is read wrongly over the range (A-optimal,
    greedy): ``argmin_c mean_d tr(S^-1 A_d (P + I_c)^-1 A_d^T S^-1)``, where P is the Fisher
    information of the images that were fitted and of those chosen before, I_c that of candidate
    c, A_d how errors of the keyframe show in what is read at d, and S the scale. Information about
    lens, mount and depth counts by what it is worth for the displacements that are to be read.

    Parameters
    ----------
    keyframe : Keyframe
    n : int
    ranges : array of shape (6,)
        Displacements are at most these about the pivot, [m] and [rad], in `DOFS` order; 0 in dofs
        that the keyframe does not read.
    pose_noise : tuple of 2 floats
        Standard deviations of the reported poses, [m] and [rad].
    scale : array of shape (6,), optional
        Errors count in these units; by default in shares of the ranges.
    random_state : int or Generator
        Draws the candidates.

    Returns
    -------
    ndarray of shape (n, 6)
        About the pivot, [m] and [rad], best first, all different.

    Raises
    ------
    InvalidInputError
        If n is not from 1 to `N_CANDIDATES`, or ranges or scale are not positive numbers of each
        dof that the keyframe reads.

    References
    ----------
    .. [1] F. Pukelsheim, "Optimal design of experiments", SIAM, 2006.
    """
    if not isinstance(n, int) or not 1 <= n <= N_CANDIDATES:
        raise InvalidInputError(f"n must be a whole number from 1 to {N_CANDIDATES}, got {n!r}.")
    is_read = mask_of(keyframe.dofs)
    ranges = positive_where("ranges", ranges, is_read)
    scale = ranges if scale is None else positive_where("scale", scale, is_read)
    unit, scale = (np.where(is_read, x, np.inf) for x in (ranges, scale))
    rng = np.random.default_rng(random_state)
    candidates = rng.uniform(-1, 1, (N_CANDIDATES, 6)) * ranges
    with one_blas_thread():
        taken = displacements_from_poses(np.eye(4), keyframe.displacements, keyframe.pivot) / unit
        says = KeyframeInformation(keyframe, pose_noise)
        known = says.fitted()
        informations = [says.of(D).information for D in says.displaced(candidates)]
        worth = says.worth(says.displaced(rng.uniform(-1, 1, (N_READ, 6)) * ranges), scale)
        chosen: list[int] = []
        for _ in range(n):
            apart = _distances(candidates / unit, taken)
            apart[chosen] = -1.0  # each is taken once
            left = np.argsort(-apart, kind="stable")[: min(N_APART, N_CANDIDATES - len(chosen))]
            errors = [np.sum(np.linalg.inv(known + informations[k]) * worth) for k in left]
            best = int(left[int(np.argmin(errors))])
            chosen.append(best)
            known = known + informations[best]
            taken = np.vstack([taken, candidates[best] / unit])
    return candidates[chosen]


def _distances(points: Array, others: Array) -> Array:
    """How far each point is from the nearest of the others, (n,)."""
    return np.asarray(np.linalg.norm(points[:, None] - others, axis=2).min(axis=1))


def positive_where(name: str, values: ArrayLike, is_read: NDArray[np.bool_]) -> Array:
    """The values, if they are six finite numbers, positive where `is_read`; 0 elsewhere."""
    array = as_numbers(values, name)
    if array.shape != (6,) or not np.isfinite(array).all() or not (array[is_read] > 0).all():
        raise InvalidInputError(f"{name} must be six positive numbers, got {array.tolist()}.")
    return np.where(is_read, array, 0.0)
