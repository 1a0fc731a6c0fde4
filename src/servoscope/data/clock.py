"""How far the clock of the camera is ahead of that of the robot, by what images and poses say.

Images that shift against each other while the camera moves say when it moved. The shifts between
neighbouring images are regressed on the motions of the camera at times that are displaced by a
lag; the lag that explains most is the offset of the clocks.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.data.image_motion import camera_motions, explained_by_any, parabola_vertex
from servoscope.data.trajectory import Trajectory, pair_in_time

Array = NDArray[np.float64]

LEAST_PAIRS = 40
"""Pairs of images below which lags are not compared."""

MOST_SECONDS = 1.0
"""Offsets of clocks that are looked for, to either side."""

MOST_UNEXPLAINED = 0.5
"""Share of the shifts that may be unexplained where an offset is believed."""

MOST_STD = 0.05
"""Standard deviation from which an offset is of no use, [s]."""

_NEAR = 0.75  # of the usual pause between poses, from a time to the pose nearest to it
_BLOCKS = 10
_MOST_LAGS = 120
_FINE = 21  # lags within two steps of the best


class ImagePairs(NamedTuple):
    """Pairs of images that were taken shortly after each other.

    Parameters
    ----------
    first, second : ndarrays of shape (n,)
        When, [s].
    shifts : ndarray of shape (n, 2)
        By how much the second is shifted against the first, [px].
    """

    first: Array
    second: Array
    shifts: Array


class ClockOffset(NamedTuple):
    """Offset of the clocks: an image stamped ``t`` was taken at the pose of ``t - seconds``.

    Parameters
    ----------
    seconds : float
    std : float
        Its standard deviation, [s].
    unexplained, unexplained_then : float
        Share of the images' shifts that the motions do not explain, without and with it.
    """

    seconds: float
    std: float
    unexplained: float
    unexplained_then: float

    @property
    def is_believable(self) -> bool:
        """Whether the motions explain most of the shifts then, and hardly as well elsewhere."""
        return self.unexplained_then < MOST_UNEXPLAINED and self.std < MOST_STD

    @property
    def is_certain(self) -> bool:
        """Whether there is an offset: it is beyond its uncertainty, and explains more."""
        is_better = self.unexplained > 1.2 * self.unexplained_then
        return self.is_believable and is_better and abs(self.seconds) > 4 * self.std


def unexplained(pairs: ImagePairs, trajectory: Trajectory, lags: ArrayLike, pause: float) -> Array:
    """Share of the images' shifts that is not linear in the camera's motions some lags earlier.

    Parameters
    ----------
    pairs : ImagePairs
        Of n.
    trajectory : Trajectory
        Of the camera, or of anything that moves with it.
    lags : array of shape (n_lags,)
        [s].
    pause : float
        Usual time between poses, [s]; pairs without a pose that near do not count.

    Returns
    -------
    ndarray of shape (n_lags,)
        NaN where fewer than `LEAST_PAIRS` are left.
    """
    return _left(*_motions(pairs, trajectory, np.asarray(lags, dtype=float), pause), pairs.shifts)


def _motions(
    pairs: ImagePairs, trajectory: Trajectory, lags: Array, pause: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Motions between the images of each pair, (n_lags, n, 6), and which have poses near."""
    times = np.concatenate([pairs.first, pairs.second])[None] - lags[:, None]
    T, gaps = pair_in_time(trajectory, times.ravel())
    near = np.asarray((gaps <= _NEAR * pause).reshape(len(lags), 2, -1).all(axis=1))
    places = np.arange(times.size).reshape(len(lags), 2, -1)
    motions = camera_motions(T, places[:, 0].ravel(), places[:, 1].ravel())
    return motions.reshape(*near.shape, 6), near


def _left(motions: Array, near: NDArray[np.bool_], shifts: Array) -> Array:
    """Share of the shifts that is left unexplained at each lag."""
    return np.array(
        [
            1 - explained_by_any(motion[own], shifts[own]) if own.sum() >= LEAST_PAIRS else np.nan
            for motion, own in zip(motions, near, strict=True)
        ]
    )


def estimate_clock_offset(pairs: ImagePairs, trajectory: Trajectory) -> ClockOffset | None:
    """The lag that explains the images' shifts best, within `MOST_SECONDS`, and how certain it is.

    Returns
    -------
    ClockOffset or None
        None if there are too few pairs, or nothing moves.

    Notes
    -----
    The standard deviation is that of the jackknife over stretches of the recording, or half the
    range of lags that explain as much up to chance, if that is larger: of images that were taken
    while the camera stood still, many do.

    Examples
    --------
    A camera that swings before a far wall, whose stamps are 80 ms late:

    >>> t = np.arange(0.0, 8.0, 0.01)
    >>> T = np.tile(np.eye(4), (len(t), 1, 1))
    >>> T[:, 0, 3] = 0.1 * np.sin(1.7 * t) + 0.05 * np.sin(4 * t)
    >>> at = t[20:-20:4]
    >>> x = np.interp(at - 0.08, t, T[:, 0, 3])
    >>> shifts = np.column_stack([-300 * np.diff(x), np.zeros(len(x) - 1)])
    >>> offset = estimate_clock_offset(ImagePairs(at[:-1], at[1:], shifts), Trajectory(t, T))
    >>> round(offset.seconds, 3)
    0.08
    """
    order = np.argsort(trajectory.times, kind="stable")
    trajectory = Trajectory(trajectory.times[order], trajectory.T_world_cam[order])
    if len(order) < 3 or len(pairs.first) < LEAST_PAIRS:
        return None
    pause = float(np.median(np.diff(trajectory.times)))
    spacing = float(np.median(pairs.second - pairs.first))
    step = max(min(pause, spacing / 2), 2 * MOST_SECONDS / _MOST_LAGS)
    n = int(np.ceil(MOST_SECONDS / step))
    lags = step * np.arange(-n, n + 1)

    curve = unexplained(pairs, trajectory, lags, max(pause, step))
    if np.isnan(curve).all():
        return None
    equal = lags[curve <= np.nanmin(curve) * (1 + 1 / len(pairs.first)) + 1e-9]
    without = float(unexplained(pairs, trajectory, [0.0], max(pause, step))[0])
    if (range_ := float(np.ptp(equal)) / 2 - step) > step:
        return ClockOffset(float(equal.mean()), range_, without, float(np.nanmin(curve)))
    fine = float(lags[np.nanargmin(curve)]) + step * np.linspace(-2, 2, _FINE)
    motions, near = _motions(pairs, trajectory, fine, max(pause, step))
    seconds, then = _lowest(fine, _left(motions, near, pairs.shifts))
    blocks = np.array_split(np.argsort(pairs.first, kind="stable"), _BLOCKS)
    others = [np.setdiff1d(np.arange(len(pairs.first)), block) for block in blocks]
    found = np.array(
        [
            _lowest(fine, _left(motions[:, kept], near[:, kept], pairs.shifts[kept]))[0]
            for kept in others
        ]
    )
    std = np.sqrt((_BLOCKS - 1) / _BLOCKS * np.square(found - found.mean()).sum())
    return ClockOffset(seconds, float(std), without, then)


def _lowest(lags: Array, curve: Array) -> tuple[float, float]:
    """The lag at which a curve is lowest, between its points, and how low it is there."""
    curve = np.nan_to_num(curve, nan=1.0)
    i = int(np.clip(curve.argmin(), 1, len(curve) - 2))
    between = np.clip(parabola_vertex(*curve[i - 1 : i + 2]), -1, 1)
    return float(lags[i] + (lags[1] - lags[0]) * between), float(curve.min())
