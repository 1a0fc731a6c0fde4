"""The reference frame, and the frames near it."""

from __future__ import annotations

from itertools import pairwise
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from servoscope.errors import DataSetError
from servoscope.formats.frames import Frames
from servoscope.formats.options import MOST_NEIGHBOURS, ImportOptions
from servoscope.poses import pose_error

_SAMPLES = (1000, 4000, 16_000)
_MOST_PAIRS = 10**8
_PAIRS_AT_ONCE = 10**6


def choose_reference(frames: Frames, options: ImportOptions) -> int:
    """Position of the reference frame among the frames.

    Raises
    ------
    DataSetError
        If no frame has the name or the number that was asked for.
    """
    if options.reference_index is not None:
        found = np.flatnonzero(frames.numbers == options.reference_index).tolist()
        if not found:
            raise DataSetError(
                f"{frames.folder}: frame {options.reference_index} is not among the "
                f"{len(frames)} frames with a usable pose, numbered {frames.numbers.min()} to "
                f"{frames.numbers.max()}; name another reference."
            )
    elif options.reference != MOST_NEIGHBOURS:
        found = _positions_named(frames.names, normalize("NFC", options.reference))
        if len(found) != 1:
            how_many = "several" if found else "none"
            raise DataSetError(
                f"{frames.folder}: {how_many} of the {len(frames)} frames with a usable pose "
                f"have the name {options.reference!r}; names are like {frames.names[0]!r}."
            )
    else:
        found = [most_neighbours(frames.T_world_cam, options.max_mm, options.max_deg)]
    return int(found[0])


def near_reference(
    frames: Frames, reference: int, max_mm: float | None, max_deg: float | None
) -> NDArray[np.bool_]:
    """Which frames lie within the limits around the reference; the reference itself always does.

    Raises
    ------
    DataSetError
        If no other frame does.
    """
    distance, angle = pose_error(frames.T_world_cam[reference], frames.T_world_cam)
    mm, deg = 1e3 * distance, np.degrees(angle)
    near = (mm <= _limit(max_mm)) & (deg <= _limit(max_deg))
    near[reference] = True
    if near.sum() < 2:
        others = np.arange(len(frames)) != reference
        raise DataSetError(
            f"{frames.folder}: no other frame lies within {_limit(max_mm):g} mm and "
            f"{_limit(max_deg):g} deg of the reference {frames.names[reference]} (the least "
            f"distance is {mm[others].min():.1f} mm, the least angle "
            f"{deg[others].min():.1f} deg); widen the limits or check the units."
        )
    return near


def most_neighbours(
    T_world_cam: NDArray[np.float64], max_mm: float | None, max_deg: float | None
) -> int:
    """Position of the pose that has most others within the limits; the first of equals.

    A limit that is None is, for this choice only, the median of what it limits over all pairs:
    the pose in the thick of the others is found without knowing their extent.

    Notes
    -----
    Counting all pairs would take time that grows with the square of the poses. The counts of all
    are estimated from a sample of the others, those that lie more than five standard deviations
    below the best are given up, and the rest are counted among larger samples, at last among all.

    Examples
    --------
    >>> poses = np.stack([np.eye(4)] * 4)
    >>> poses[:, 0, 3] = 0.0, 0.09, 0.18, 0.5
    >>> most_neighbours(poses, max_mm=100, max_deg=5)
    1
    """
    if max_mm is None or max_deg is None:
        sample = T_world_cam[:: 1 + len(T_world_cam) // 500]
        distances, cosines = _distances_and_cosines(sample, sample)
    far = np.median(distances) if max_mm is None else max_mm / 1e3
    least_cosine = np.median(cosines) if max_deg is None else np.cos(np.radians(min(max_deg, 180)))
    candidates, n_poses = np.arange(len(T_world_cam)), len(T_world_cam)
    others = T_world_cam[np.random.default_rng(0).permutation(n_poses)]
    sizes = [size for size in _SAMPLES if size < n_poses] + [n_poses]
    for size, next_size in pairwise(sizes):
        counts = _count_near(T_world_cam[candidates], others[:size], far, least_cosine)
        n_near_best = (counts >= counts.max() - 5 * np.sqrt(size) / 2).sum()
        best_first = candidates[np.lexsort((candidates, -counts))]
        candidates = np.sort(best_first[: min(n_near_best, max(1, _MOST_PAIRS // next_size))])
    counts = _count_near(T_world_cam[candidates], T_world_cam, far, least_cosine)
    return int(candidates[counts.argmax()])


def _count_near(
    T_a: NDArray[np.float64], T_b: NDArray[np.float64], far: float, least_cosine: float
) -> NDArray[np.intp]:
    """How many poses of `T_b` lie within the limits of each of `T_a`."""
    rows, counts = max(1, _PAIRS_AT_ONCE // len(T_b)), []
    for start in range(0, len(T_a), rows):
        distances, cosines = _distances_and_cosines(T_a[start : start + rows], T_b)
        near = (distances <= far + 1e-12) & (cosines >= least_cosine - 1e-12)
        counts.append(near.sum(axis=1))
    return np.concatenate(counts)


def _distances_and_cosines(
    T_a: NDArray[np.float64], T_b: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    distances = cdist(T_a[:, :3, 3], T_b[:, :3, 3])
    traces = T_a[:, :3, :3].reshape(-1, 9) @ T_b[:, :3, :3].reshape(-1, 9).T
    return distances, (traces - 1) / 2


def _positions_named(names: list[str], wanted: str) -> list[int]:
    if wanted in names:
        return [names.index(wanted)]
    return [i for i, name in enumerate(names) if name.endswith(f"/{wanted}")]


def _limit(value: float | None) -> float:
    return np.inf if value is None else value
