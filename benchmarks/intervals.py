"""How often the 90 % interval of a forecast holds what is then measured on test images.

``python -m benchmarks intervals``; with ``--quick`` three sets of each kind: 108 dofs.
The data sets are simulated ones of both parts, and views of the
real sequences about several references and within several limits, where these lie beside the
project (see `real_images`); each is split as `servoscope assess` splits it. The form of the
interval was chosen on the first of them; the others were taken afterwards.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import real_images
from benchmarks.real_images import evenly, read_kitchen_frames
from benchmarks.tables import Findings
from servoscope import AcquisitionConfig, PoseImageSet, TumOptions, acquire, read_tum
from servoscope.assessment.decision import Decision
from servoscope.assessment.rendered import Sample
from servoscope.data.independence import (
    LEAST_IMAGES,
    independent_groups,
    split_groups,
)
from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS, inverse_transform
from servoscope.processes import in_processes
from servoscope.selection.rms_interval import effective_groups

FAMILIES = ("moments", "intensity", "least_squares")
WIDTH = 96
N_FRESH, N_QUICK = 200, 3
MOST_FRAMES = 260
LEAST_FRAMES = 90
PARTS = ("cylinder_head", "textured_plane")
Limits = tuple[tuple[int, int], ...]
DataSet = tuple[str, PoseImageSet, PoseImageSet | None]
"""A title, the images, and others that no split knows."""


@dataclass(frozen=True)
class Plan:
    """Which sets are taken, and by which seed they are split.

    Parameters
    ----------
    title : str
    seed : int
    simulated : tuple of (seed, n_images, image_size)
        Of every part.
    references : dict of tuple of int
        Reference images of each sequence, by their place in it.
    limits : dict of tuple of (mm, deg)
        How far others may be from them.
    """

    title: str
    seed: int
    simulated: tuple[tuple[int, int, int], ...]
    references: dict[str, tuple[int, ...]]
    limits: dict[str, Limits]


CHOSEN_ON = Plan(
    "chosen on",
    0,
    tuple((seed, *size) for seed in range(3) for size in ((150, 96), (300, 64))),
    {"tum_fr1_rpy": (144, 60, 300, 450, 600), "seven_scenes_kitchen": (251, 100, 450, 650, 850)},
    {
        "tum_fr1_rpy": ((150, 20), (200, 30), (400, 45)),
        "seven_scenes_kitchen": ((250, 20), (350, 25), (600, 40)),
    },
)
OTHERS = Plan(
    "others",
    7,
    ((12, 120, 96), (13, 400, 64), *((seed, 200, 64) for seed in (10, 11, *range(20, 28)))),
    {"tum_fr1_rpy": (200, 380, 520), "seven_scenes_kitchen": (180, 350, 550, 750, 880)},
    dict.fromkeys(("tum_fr1_rpy", "seven_scenes_kitchen"), ((200, 25), (300, 35), (500, 50))),
)


@dataclass(frozen=True)
class Outcome:
    """A forecast and what was measured, with their 90 % intervals, in shares of the range.

    Parameters
    ----------
    forecast : float
    interval : (low, high)
        For what is measured.
    measured : float
        Pooled over the splits.
    reached_interval : (low, high)
        For what infinitely many images would show.
    fresh : float or None
        What images show that no split knows.
    n_learned, n_tested : float
        Effective numbers of groups.
    """

    forecast: float
    interval: tuple[float, float]
    measured: float
    reached_interval: tuple[float, float]
    fresh: float | None
    n_learned: float
    n_tested: float

    @property
    def holds(self) -> bool:
        """Whether the interval holds what was measured."""
        return self.interval[0] <= self.measured <= self.interval[1]


def tables(quick: bool) -> Iterator[Findings]:
    """Counts over all degrees of freedom of every kind of data."""
    at_hand = [name for name in CHOSEN_ON.limits if (real_images.SHARED / name).exists()]
    for name in set(CHOSEN_ON.limits) - set(at_hand):
        print(f"{name} is not beside the project: left out", file=sys.stderr)
    print(f"kuka_board: left out, its 28 images are fewer than {LEAST_IMAGES}", file=sys.stderr)
    rows = []
    for plan in (CHOSEN_ON, OTHERS):
        every, n_sets = list[Outcome](), 0
        for kind in ("simulated", *at_hand):
            most = N_QUICK if quick else sys.maxsize
            taken = _simulated(plan, most) if kind == "simulated" else _views(kind, plan, most)
            calls = [(data, plan.seed, fresh) for _, data, fresh in taken]
            found = list[Outcome]()
            for (title, *_), outcomes in zip(taken, in_processes(measure, calls), strict=True):
                held = sum(one.holds for one in outcomes)
                print(f"{kind} {title}: {held} of {len(outcomes)}", file=sys.stderr, flush=True)
                found += outcomes
            rows.append(_row(f"{kind}, {plan.title}", len(taken), found))
            every, n_sets = every + found, n_sets + len(taken)
        rows.append(_row(f"all, {plan.title}", n_sets, every))
    yield Findings(
        "Intervals of the forecast",
        "shares of the degrees of freedom whose measured error the 90 % interval of the forecast "
        f"holds; features {', '.join(FAMILIES)}, Gaussian process; chosen on = the sets that the "
        "form of the interval was chosen on; groups = independent groups that were learned from in "
        "the first split and tested in all, medians; factors = by which the intervals of the "
        "forecast and of what was measured go up and down, medians; fresh = share whose error on "
        f"{N_FRESH} more simulated images the interval of what was measured holds",
        ("data", "sets", "dofs", "groups", "holds", "is lower", "is higher", "factors", "fresh"),
        rows,
    )


def measure(data: PoseImageSet, seed: int, fresh: PoseImageSet | None = None) -> list[Outcome]:
    """Forecast and measured error of every degree of freedom of a data set, split by a seed."""
    groups = independent_groups(data)
    try:
        sample = Sample(data, groups, split_groups(data, groups, seed))
    except InvalidInputError:
        return []
    decision = Decision(sample, FAMILIES, seed=seed, n_jobs=1)
    measured = decision.measure()
    return [
        Outcome(
            float(decision.forecasts[dof].rms[0]),
            decision.interval_of(decision.forecasts[dof], measured),
            measured.rms(dof),
            measured.interval(dof),
            None if fresh is None else _rms_on(fresh, decision, dof),
            effective_groups(groups.labels[sample.split.learned]),
            effective_groups(measured.groups),
        )
        for dof in decision.choice
    ]


def _rms_on(fresh: PoseImageSet, decision: Decision, dof: str) -> float:
    """What the trained choice errs on images that it has not seen."""
    fitted, table = decision.fitted[dof], decision.table
    X = np.hstack([one.transform(fresh.images) for one in table.fitted.values()])
    truth = fresh.delta_p()[:, DOFS.index(dof)] / decision.sample.data.ranges()[DOFS.index(dof)]
    return float(np.sqrt(np.mean((fitted.regressor.predict(X[:, fitted.columns]) - truth) ** 2)))


def _simulated(plan: Plan, most: int) -> list[DataSet]:
    kinds, sets = list(product(PARTS, plan.simulated)), list[DataSet]()
    for k in evenly(np.arange(len(kinds)), most):
        part, (seed, n_images, size) = kinds[k]
        n = n_images + N_FRESH
        config = AcquisitionConfig(n_images=n, image_size=size, part=part, seed=seed)
        with tempfile.TemporaryDirectory() as folder:
            data = acquire(Path(folder) / "data", config)
        title = f"{part}, seed {seed}, {n_images} images"
        sets.append((title, data[:n_images], data[n_images:]))
    return sets


def _views(name: str, plan: Plan, most: int) -> list[DataSet]:
    """The frames of a sequence about each reference and within each limit, if there are enough."""
    (images, poses, times), sets = _read(name), list[DataSet]()
    for reference, (mm, deg) in product(plan.references[name], plan.limits[name]):
        D = inverse_transform(poses[reference]) @ poses
        distance = 1e3 * np.linalg.norm(D[:, :3, 3], axis=1)
        angle = np.degrees(Rotation.from_matrix(D[:, :3, :3]).magnitude())
        near = (distance < mm) & (angle < deg)
        near[reference] = False
        kept = evenly(np.flatnonzero(near), MOST_FRAMES)
        if len(kept) >= LEAST_FRAMES:
            about = poses[reference], images[reference]
            data = PoseImageSet(images[kept], poses[kept], *about, times=times[kept])
            sets.append((f"about image {reference} within {mm} mm and {deg} deg", data, None))
    return [sets[k] for k in evenly(np.arange(len(sets)), most)]


def _read(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All frames of a sequence, small, their poses and times."""
    if name == "seven_scenes_kitchen":
        images, poses, times = read_kitchen_frames()
    else:
        data = read_tum(real_images.SHARED / name, TumOptions(reference_index=144))
        images, poses, times = data.images, data.T_world_cam, data.times
    height = round(images.shape[1] * WIDTH / images.shape[2])
    small = [cv2.resize(i, (WIDTH, height), interpolation=cv2.INTER_AREA) for i in images]
    return np.stack(small), poses, times


def _row(kind: str, n_sets: int, found: list[Outcome]) -> tuple[str, ...]:
    def share(hits: list[bool]) -> str:
        return f"{np.mean(hits):.0%}" if hits else "-"

    intervals = [[one.interval for one in found], [one.reached_interval for one in found]]
    factors = [np.median([np.sqrt(high / low) for low, high in of]) for of in intervals]
    groups = [np.median([getattr(o, n) for o in found]) for n in ("n_learned", "n_tested")]
    return (
        kind,
        str(n_sets),
        str(len(found)),
        " / ".join(f"{n:.0f}" for n in groups),
        share([one.holds for one in found]),
        share([one.measured < one.interval[0] for one in found]),
        share([one.measured > one.interval[1] for one in found]),
        " / ".join(f"{factor:.2f}" for factor in factors),
        share([_holds(one.reached_interval, one.fresh) for one in found if one.fresh is not None]),
    )


def _holds(interval: tuple[float, float], value: float) -> bool:
    return interval[0] <= value <= interval[1]
