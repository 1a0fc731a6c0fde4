"""Whether what is seen after a move is what the move should have brought into view."""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from servoscope.poses import displacements_from_poses, inverse_transform, rigid_transform
from servoscope.positioning.interfaces import Array, Estimate

LEAST_DEVIATIONS = 3.0
"""Innovations of fewer standard deviations may be noise."""

LEAST_DEVIATIONS_EXPLAINED = 1.6
"""The same where a fault explains them, or the view hardly followed the move."""

_FOLLOWS = 0.25

_LEAST_STD = 1e-3
"""No deviation is taken for less than this share of the reach."""

_FITS = 0.35
LATE, _OPPOSITE, _MIRRORED, _SCALED, _OTHER = "late", "opposite", "mirrored", "scaled", "other"

CAUSES = {
    LATE: "the view is still the one from before the move, so that the camera gives images late, "
    "or the robot did not move; empty the camera's buffer before each image",
    _OPPOSITE: "the view moved the other way, so that the robot executes moves with the wrong sign "
    "or reports them so; check the sign of the move and of the pose",
    _MIRRORED: "the view moved as in a mirror, so that the camera's image is flipped or turned "
    "against training; check its flip and rotation settings",
    _SCALED: "the view moved along the move, but by another length, so that the scale of the moves "
    "is not that of the training poses; check the units",
    _OTHER: "the view moved otherwise than the robot, so that the frame or the scale of its moves "
    "is not that of the training poses; check the tool frame, its axes and the units",
}
"""What each contradiction means and what to check."""


class Innovation(NamedTuple):
    """How an estimate differs from the one that a move led to expect.

    Parameters
    ----------
    expected : ndarray of shape (4, 4)
        The displacement that was expected, [m].
    size : float
        Size of the move, as the root mean square over the dofs in shares of the reach.
    share : float
        Size of the difference, likewise, relative to the move.
    deviations : float
        Its size in standard deviations of both estimates and of the robot, likewise.
    along : float
        Share of the move that was seen, along its direction: 1 where the view followed it.
    cause : str
        The key of `CAUSES` that explains it best.
    fits : bool
        Whether that cause explains it well, and not merely best.
    is_known : bool
        Whether any deviation of the estimates was believed.
    """

    expected: Array
    size: float
    share: float
    deviations: float
    along: float
    cause: str
    fits: bool
    is_known: bool

    def contradicts(self, largest_share: float) -> bool:
        """Whether the view did not follow the move.

        Without believed deviations only what a fault explains, or what leads away, is judged.
        """
        if not (self.is_known or self.fits or self.along < 0):
            return False
        is_explained = self.fits or self.along < _FOLLOWS
        least = LEAST_DEVIATIONS_EXPLAINED if is_explained else LEAST_DEVIATIONS
        return self.share > largest_share and self.deviations > least


def innovation(
    before: Estimate,
    moved: Array,
    after: Estimate,
    *,
    pivot: float,
    reach: Array,
    robot_std: ArrayLike = 0.0,
) -> Innovation:
    """Compare what is seen after a move with what it should have brought into view.

    Parameters
    ----------
    before, after : Estimate
        From the images before and after the move.
    moved : ndarray of shape (4, 4)
        The displacement between the two images as the robot reports it, [m].
    pivot : float
        [m].
    reach : ndarray of shape (6,)
        The unit of each dof, [m] and [rad].
    robot_std : array of shape (6,), optional
        Deviation of the robot's motion from what it reports, about the pivot, [m] and [rad].

    Returns
    -------
    Innovation

    Notes
    -----
    The estimate that is expected is ``before @ moved``; the innovation is the difference of the
    two displacements about the pivot, as in a Kalman filter. Each fault predicts another estimate:
    an image from before the move ``before``, a wrong sign ``before @ inv(moved)``, a mirrored or
    turned image ``before @ S moved inv(S)``. Another scale has a factor of its own to be fitted,
    and has to explain more for that.

    Examples
    --------
    >>> from servoscope.poses import rigid_transform
    >>> there, nearer = (rigid_transform(np.eye(3), [x, 0, 0]) for x in (0.02, -0.02))
    >>> seen = Estimate(there, np.full(6, 1e-4), 0.1, "fine")
    >>> found = innovation(seen, nearer, seen, pivot=0.5, reach=np.full(6, 0.1))
    >>> found.contradicts(0.75), found.cause
    (True, 'late')
    """
    unit = np.where(reach > 0, reach, 1.0)

    def size(delta_p: Array) -> float:
        return float(np.sqrt(np.mean((delta_p / unit) ** 2)))

    expected = before.displacement @ moved
    really = inverse_transform(before.displacement) @ after.displacement
    faults = _explanations(moved, really, pivot)
    of_faults = [before.displacement @ other for others in faults.values() for other in others]
    poses = np.stack([before.displacement, after.displacement, expected, *of_faults])
    start, seen, end, *ends = displacements_from_poses(np.eye(4), poses, pivot)
    move = end - start
    difference = seen - start - move
    believed = np.hypot(before.std, after.std)
    known = np.isfinite(believed)
    std = np.hypot(np.where(known, believed, 0.0), robot_std)
    judged = known if known.any() else np.ones(6, dtype=bool)
    ratio = difference / np.maximum(std, _LEAST_STD * unit)
    deviations = float(np.sqrt(np.mean(ratio[judged] ** 2)))
    squared = max(size(move) ** 2, 1e-24)
    along = float(np.mean((seen - start) * move / unit**2)) / squared
    misses = (size(end - seen) for end in ends)
    explained = {cause: min(islice(misses, len(others))) for cause, others in faults.items()}
    explained[_SCALED] += _FITS / 2 * size(move)
    cause = min(explained, key=lambda cause: explained[cause])
    fits = explained[cause] <= _FITS * size(move)
    return Innovation(
        expected=expected,
        size=size(move),
        share=size(difference) / np.sqrt(squared),
        deviations=deviations,
        along=along,
        cause=cause if fits else _OTHER,
        fits=fits,
        is_known=bool(known.any()),
    )


def _explanations(moved: Array, really: Array, pivot: float) -> dict[str, list[Array]]:
    """What the camera may have done instead of the move, by cause, given what it did really."""
    mirrors = [np.diag(signs) for signs in ((-1, 1, 1, 1), (1, -1, 1, 1), (-1, -1, 1, 1))]
    quarter = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    mirrors += [quarter, quarter.T]
    return {
        LATE: [np.eye(4)],
        _OPPOSITE: [inverse_transform(moved)],
        _MIRRORED: [mirror @ moved @ mirror.T for mirror in mirrors],
        _SCALED: [_scaled(moved, really, pivot or 1.0)],
    }


def _scaled(moved: Array, really: Array, length: float) -> Array:
    """The move made longer or shorter, by what makes it most like what was done really."""
    one, other = (
        np.concatenate([T[:3, 3], length * Rotation.from_matrix(T[:3, :3]).as_rotvec()])
        for T in (moved, really)
    )
    scaled = one * float(one @ other) / max(float(one @ one), 1e-24)
    return rigid_transform(Rotation.from_rotvec(scaled[3:] / length).as_matrix(), scaled[:3])
