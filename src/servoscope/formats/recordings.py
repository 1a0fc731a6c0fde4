"""Recordings: images and poses with times of their own, joined in time."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from servoscope.data.clock import (
    LEAST_PAIRS,
    MOST_STD,
    ClockOffset,
    ImagePairs,
    estimate_clock_offset,
)
from servoscope.data.image_motion import image_shifts, shrink_all
from servoscope.data.images import PoseImageSet
from servoscope.data.trajectory import Trajectory, pair_in_time
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.formats.assembly import assemble_data_set
from servoscope.formats.frames import NO_POSE, Drops, Frames
from servoscope.formats.images import to_eight_bits
from servoscope.formats.options import ImportOptions
from servoscope.formats.stamps import stamp_warnings
from servoscope.poses import pose_error

_THUMBNAIL = 64
_RUN = 50  # images that follow each other, in each of which shifts are read
_RUNS, _MORE_RUNS = 6, 24
_STRIDES, _LEAST_SHIFT = (1, 2, 4), 0.7  # images, pixels of a thumbnail
_REPORTED_S = 0.004
_PART_M = 0.5


@dataclass(frozen=True, kw_only=True)
class RecordingOptions(ImportOptions):
    """Options of recordings, besides those of every format.

    Parameters
    ----------
    max_gap_s : float
        Largest gap between an image and the pose nearest in time [s]; images without a pose
        that near are left out.
    pairing : {"interpolate", "nearest"}
        The pose of an image: interpolated between the poses before and after it, or the nearest
        one as it stands.
    clock_offset : float or "estimate", optional
        By how much the stamps of the images are late against those of the poses [s], or estimate,
        which takes what the images say; by default the estimate is only reported.

    Examples
    --------
    >>> RecordingOptions(clock_offset=0.1).clock_offset
    0.1
    """

    max_gap_s: float = 0.02
    pairing: Literal["interpolate", "nearest"] = "interpolate"
    clock_offset: float | Literal["estimate"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_number("max_gap_s", above_zero=False)
        if isinstance(self.clock_offset, str):
            self._check_choice("clock_offset", ("estimate",))
        elif self.clock_offset is not None and not np.isfinite(self.clock_offset):
            raise InvalidInputError(
                f"clock_offset must be a finite number of seconds, got {self.clock_offset}."
            )


def assemble_recording(
    images: Frames,
    trajectory: Trajectory,
    options: RecordingOptions,
    drops: Drops,
    format_name: str,
    on_progress: Callable[[int], object] | None = None,
    *,
    step: float = 0.0,
    called: tuple[str, str] = ("images", "poses"),
    facts: dict[str, Any] | None = None,
) -> PoseImageSet:
    """A data set of images that get the poses of their times.

    Parameters
    ----------
    images : Frames
        With times; their poses are not looked at.
    trajectory : Trajectory
        In the order of time, one pose a stamp.
    options : RecordingOptions
    drops : Drops
    format_name : str
    on_progress : callable, optional
    step : float
        In which the coarser of the stamps are written, [s].
    called : pair of str
        What messages call the images and the poses.
    facts : dict, optional

    Raises
    ------
    DataSetError
        If no image has a pose near in time, or a clock offset was to be estimated and cannot be.

    Warns
    -----
    ServoscopeWarning
        Of an offset of the clocks, of doubtful stamps, and as `assemble_data_set`.
    """
    if images.times is None:
        raise ValueError("images of a recording need times")
    facts = dict(facts or {})
    offset, estimate = _clock_offset(images, images.times, trajectory, options)
    if estimate is not None:
        facts["clock_offset_estimate"] = {"seconds": estimate.seconds, "std": estimate.std}
    facts["clock_offset_s"] = offset
    T, gaps = pair_in_time(trajectory, images.times - offset, options.pairing)
    frames, paired = replace(images, T_world_cam=T), gaps <= options.max_gap_s
    if not paired.any():
        raise DataSetError(
            f"{images.folder}: none of the {called[0]} has a pose in {called[1]} within "
            f"{options.max_gap_s:g} s (the least gap is {gaps.min():.6g} s); check that both count "
            "seconds from the same moment, or raise --max-gap-s."
        )
    for text in stamp_warnings(trajectory, images.times[paired], step):
        _warn(f"{images.folder}: {text}")
    drops.add(NO_POSE, frames.take(~paired).names)
    return assemble_data_set(frames.take(paired), options, drops, format_name, on_progress, facts)


def _clock_offset(
    images: Frames,
    times: NDArray[np.float64],
    trajectory: Trajectory,
    options: RecordingOptions,
) -> tuple[float, ClockOffset | None]:
    """The offset to apply [s], and the estimate; what it is, is said."""
    asked = options.clock_offset
    if isinstance(asked, int | float):
        return float(asked), None
    pairs = _image_pairs(images, times, trajectory, _RUNS if asked is None else _MORE_RUNS)
    found = None if pairs is None else estimate_clock_offset(pairs, trajectory)
    if asked == "estimate" and (found is None or not found.is_believable):
        why = "too few images were taken shortly after each other while the camera moved"
        if found is not None and found.std >= MOST_STD:
            why = f"lags within {1e3 * found.std:.0f} ms explain what the images show as well"
        elif found is not None:
            left = 100 * found.unexplained_then
            why = f"the motions leave {left:.0f} % of the images' shifts unexplained"
        raise DataSetError(
            f"{images.folder}: the clock offset cannot be estimated, since {why}; give it in "
            "seconds, or leave --clock-offset out."
        )
    if found is None or not (asked or (found.is_certain and abs(found.seconds) > _REPORTED_S)):
        return 0.0, found
    where = "behind" if found.seconds > 0 else "ahead of"
    text = (
        f"{images.folder}: images are {1e3 * abs(found.seconds):.1f} +- {1e3 * found.std:.1f} ms "
        f"{where} their poses by what they show ({100 * found.unexplained:.0f} % of their shifts "
        f"are unexplained as stamped, {100 * found.unexplained_then:.0f} % then)"
    )
    if asked == "estimate":
        _warn(f"{text}; that was applied.")
        return found.seconds, found
    _warn(
        f"{text}: poses are up to {_millimetres(trajectory, found.seconds):.2g} mm off. Apply it "
        f"with --clock-offset estimate or --clock-offset {found.seconds:.3f}, or say 0."
    )
    return 0.0, found


def _millimetres(trajectory: Trajectory, seconds: float) -> float:
    """How far the camera moves in so many seconds, [mm], at all but the fastest of its motions."""
    T, _ = pair_in_time(trajectory, trajectory.times + seconds)
    moved = pose_error(trajectory.T_world_cam, T)[0]
    return 1e3 * float(np.percentile(moved, 95))


def _image_pairs(
    images: Frames, times: NDArray[np.float64], trajectory: Trajectory, n_runs: int
) -> ImagePairs | None:
    """Shifts between images that follow each other, in those runs in which the camera moves most.

    None where no run has images at a steady rate, or they cannot be read.
    """
    order = np.argsort(times, kind="stable")
    chosen = _moving_runs(times[order], trajectory, n_runs)
    if not len(chosen):
        return None
    small, at, run = [], [], []
    for k, places in enumerate(chosen):
        for place, decoded in zip(places, images.at(order[places]).images(_THUMBNAIL), strict=True):
            if isinstance(decoded, DataSetError):
                continue
            bits = max(8, int(decoded[1]).bit_length())
            small.append(shrink_all(to_eight_bits(decoded[0][None], bits), _THUMBNAIL)[0])
            at.append(times[order[place]])
            run.append(k)
    if len({image.shape for image in small}) != 1:
        return None
    return _shifts(np.stack(small), np.array(at), np.array(run))


def _shifts(
    small: NDArray[np.float32], at: NDArray[np.float64], run: NDArray[np.intp]
) -> ImagePairs | None:
    found = None
    for stride in _STRIDES:
        first = np.flatnonzero(run[:-stride] == run[stride:])
        if len(first) < LEAST_PAIRS:
            break
        shifts = image_shifts(small[first], small[first + stride])
        found = ImagePairs(at[first], at[first + stride], shifts)
        if np.median(np.abs(shifts).max(axis=1)) > _LEAST_SHIFT:
            break
    return found


def _moving_runs(
    times: NDArray[np.float64], trajectory: Trajectory, n_runs: int
) -> list[NDArray[np.intp]]:
    """Runs of images at a steady rate, those in which the camera moves most, in order of time."""
    if len(times) < LEAST_PAIRS:
        return []
    pauses = np.diff(times)
    steady = pauses <= 2.5 * np.median(pauses)
    pieces = np.split(np.arange(len(times)), np.flatnonzero(~steady) + 1)
    runs = [
        part
        for piece in pieces
        for part in np.array_split(piece, -(-len(piece) // _RUN))
        if len(part) > _STRIDES[-1]
    ]
    T, _ = pair_in_time(trajectory, times)
    metres, radians = pose_error(T[:-1], T[1:])
    path = np.concatenate([[0.0], np.cumsum(metres / _PART_M + radians)])
    moved = np.array([path[run[-1]] - path[run[0]] for run in runs])
    best = np.sort(np.argsort(-moved, kind="stable")[:n_runs])
    return [runs[i] for i in best]


def _warn(text: str) -> None:
    warnings.warn(text, ServoscopeWarning, stacklevel=4)
