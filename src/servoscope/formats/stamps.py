"""Time stamps of images and poses: whether they are seconds, and what is doubtful about them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from reprlib import repr as brief

import numpy as np
from numpy.typing import NDArray

from servoscope.data.trajectory import Trajectory
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.poses import pose_error

_SINCE_1970 = 1e11
_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}
_USUAL_S = 0.05
_LONGEST_PAUSE_S = 20_000.0
_LONG_PAUSE_S = 1000.0
_SAME_M, _SAME_RAD = 1e-4, 1e-4
_LEAST_MM, _LEAST_DEG = 1.0, 0.1
_FASTEST_M_PER_S = 30.0


def check_seconds(times: NDArray[np.float64], where: str) -> None:
    """Check that stamps are seconds.

    Raises
    ------
    DataSetError
        If they would be in a far future, or whole numbers more than some hours apart.

    Warns
    -----
    ServoscopeWarning
        If they are whole numbers some thousand apart: a time lapse, or microseconds.
    """
    stamp = float(np.median(times))
    pause = float(np.median(np.diff(np.sort(times)))) if len(times) > 1 else 0.0
    is_far = abs(stamp) >= _SINCE_1970
    if not is_far and pause > _LONG_PAUSE_S and (times == np.round(times)).all():
        if pause <= _LONGEST_PAUSE_S:
            warnings.warn(
                f"{where}: stamps are whole numbers, {pause:.6g} apart, and taken as seconds; if "
                "they are microseconds, divide them.",
                ServoscopeWarning,
                stacklevel=4,
            )
            return
        is_far = True
    if is_far:
        unit = _unit_of(abs(stamp), pause)
        raise DataSetError(
            f"{where}: stamps must be seconds, but those like {stamp:.0f}, {pause:.6g} apart, are "
            f"in {unit}; divide them by {_UNITS[unit]:.0e} (in import log: --time-unit {unit})."
        )


def _unit_of(stamp: float, pause: float) -> str:
    """The unit in which stamps are as far apart as those of images are, or else of this century."""
    if pause:
        return min(_UNITS, key=lambda unit: abs(np.log(pause / _UNITS[unit] / _USUAL_S)))
    return min(_UNITS, key=lambda unit: abs(np.log(stamp / _UNITS[unit] / 1.7e9)))


def resolution(texts: Sequence[str], where: str = "Stamps") -> float:
    """The step in which stamps are written, [s]: the finest of them all.

    Raises
    ------
    DataSetError
        If one is written with an exponent beyond all clocks.

    Examples
    --------
    >>> resolution(["12", "12.25"]), resolution(["1.30503e+09"])
    (0.01, 10000.0)
    """
    try:
        return 10.0 ** min(Decimal(text).as_tuple().exponent for text in texts)  # type: ignore[operator]
    except (InvalidOperation, OverflowError) as error:
        raise DataSetError(
            f"{where}: stamps must be seconds without large exponents, got {brief(texts[0])}; "
            "mend the line, or leave it out with --skip-bad."
        ) from error


def without_equal_stamps(
    trajectory: Trajectory, where: str, *, skip_bad: bool
) -> tuple[Trajectory, NDArray[np.float64]]:
    """Poses in the order of time, one a stamp, and the stamps that were left out.

    Raises
    ------
    DataSetError
        If different poses have one stamp, unless they are to be left out: which is right is not
        known.
    """
    order = np.argsort(trajectory.times, kind="stable")
    times, T = trajectory.times[order], trajectory.T_world_cam[order]
    equal = np.flatnonzero(np.diff(times) == 0)
    metres, radians = pose_error(T[equal], T[equal + 1])
    other = (metres > _SAME_M) | (radians > _SAME_RAD)
    conflicts = np.unique(times[equal[other]])
    if conflicts.size and not skip_bad:
        raise DataSetError(
            f"{where}: {conflicts.size} stamps stand for different poses, up to "
            f"{1e3 * metres.max():.6g} mm and {np.degrees(radians.max()):.3g} deg apart (the first "
            f"is {conflicts[0]:.6f}); write all decimals of the stamps, or leave such poses out "
            "with --skip-bad."
        )
    kept = ~np.isin(times, conflicts)
    kept[equal + 1] = False
    return Trajectory(times[kept], T[kept]), conflicts


def stamp_warnings(trajectory: Trajectory, times: NDArray[np.float64], step: float) -> list[str]:
    """What is doubtful about the stamps of a trajectory in order and of its images.

    Parameters
    ----------
    trajectory : Trajectory
        In the order of time, with one pose a stamp.
    times : ndarray of shape (n_images,)
        [s].
    step : float
        In which the coarser of the two are written, [s].
    """
    texts = []
    _, counts = np.unique(times, return_counts=True)
    if n_shared := int(counts[counts > 1].sum()):
        texts.append(
            f"{n_shared} of {len(times)} images share their stamp with another, and so their pose; "
            "write all decimals of the stamps."
        )
    if len(trajectory.times) < 2:
        return texts
    T, pauses = trajectory.T_world_cam, np.diff(trajectory.times)
    metres, radians = pose_error(T[:-1], T[1:])
    speed, turn = metres / pauses, radians / pauses
    jumps = np.flatnonzero((speed > _FASTEST_M_PER_S) & (metres > 0.05))
    if jumps.size:
        at = jumps[metres[jumps].argmax()]
        texts.append(
            f"The pose jumps {jumps.size} times, by up to {1e3 * metres[at]:.6g} mm within "
            f"{pauses[at]:.3g} s (at {trajectory.times[at]:.6f}): a placeholder, or a tracker that "
            "was lost; remove such poses."
        )
    mm = 1e3 * np.percentile(speed, 95) * step / 2
    deg = np.degrees(np.percentile(turn, 95)) * step / 2
    if mm > _LEAST_MM or deg > _LEAST_DEG:
        texts.append(
            f"Stamps are written in steps of {step:g} s: if they were rounded, poses are up to "
            f"{mm:.3g} mm and {deg:.3g} deg off; write all their decimals."
        )
    return texts
