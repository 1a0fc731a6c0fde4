"""Joint trajectories that keep below a speed and an acceleration."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPEED = np.radians(90.0)
"""Joints turn no faster than this: half of what a UR5e can, [rad / s]."""

ACCELERATION = np.radians(180.0)
"""[rad / s^2]"""

_PEAK_SPEED, _PEAK_ACCELERATION = 15 / 8, 10 / np.sqrt(3)
"""Of the minimum-jerk course over unit distance in unit time."""


def minimum_jerk(start: Array, goal: Array, timestep: float) -> Array:
    """Joint angles at every step on the straight way between two postures.

    All joints start and arrive together, and the one that turns farthest keeps just below `SPEED`
    and `ACCELERATION`.

    Parameters
    ----------
    start, goal : ndarray of shape (n_joints,)
        [rad].
    timestep : float
        [s].

    Returns
    -------
    ndarray of shape (n_steps, n_joints)
        [rad]; the last is `goal`.

    Notes
    -----
    ``q(s) = start + (10 s^3 - 15 s^4 + 6 s^5) (goal - start)``: T. Flash and N. Hogan, "The
    coordination of arm movements", J. Neuroscience 5(7), 1985.

    Examples
    --------
    >>> course = minimum_jerk(np.zeros(1), np.ones(1), timestep=0.2)
    >>> course[:, 0].round(3).tolist()
    [0.023, 0.145, 0.368, 0.632, 0.855, 0.977, 1.0]
    """
    farthest = np.abs(goal - start).max()
    duration = max(
        _PEAK_SPEED * farthest / SPEED, np.sqrt(_PEAK_ACCELERATION * farthest / ACCELERATION)
    )
    n_steps = max(1, int(np.ceil(duration / timestep)))
    s = np.arange(1, n_steps + 1)[:, None] / n_steps
    course: Array = start + (s**3 * (10 - 15 * s + 6 * s**2)) * (goal - start)
    course[-1] = goal
    return course
