"""How often the 90 % interval of a forecast holds what the test images then show.

``python -m benchmarks intervals``. The data sets are simulated ones of both parts, and views of the
real sequences about several references and within several limits, where these lie beside the
project (see `real_images`); each is split as `servoscope assess` splits it. The form of the
interval was chosen on the first of them, split three times; the others were taken afterwards.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, product
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from benchmarks import real_images
from benchmarks.real_images import evenly, read_kitchen_frames
from benchmarks.tables import Findings
from servoscope import AcquisitionConfig, PoseImageSet, TumOptions, acquire, read_tum
from servoscope.data.independence import (
    LEAST_IMAGES,
    independent_groups,
    split_groups,
)
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.pipeline import (
    Candidate,
    FeatureTable,
    Recipe,
    choose,
    fit_all,
    forecast_all,
)
from servoscope.poses import DOFS, inverse_transform
from servoscope.selection.rms_interval import effective_groups

FAMILIES = ("moments", "intensity", "least_squares")
WIDTH = 96
MOST_FRAMES = 260
LEAST_FRAMES = 90
PARTS = ("cylinder_head", "textured_plane")
Limits = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Plan:
    """Which sets are taken, and how they are split.

    Parameters
    ----------
    title : str
    splits : sequence of int
        Seeds.
    simulated : tuple of (seed, n_images, image_size)
        Of every part.
    references : dict of tuple of int
        Reference images of each sequence, by their place in it.
    limits : dict of tuple of (mm, deg)
        How far others may be from them.
    """

    title: str
    splits: Sequence[int]
    simulated: tuple[tuple[int, int, int], ...]
    references: dict[str, tuple[int, ...]]
    limits: dict[str, Limits]


CHOSEN_ON = Plan(
    "chosen on",
    range(3),
    tuple((seed, *size) for seed in range(3) for size in ((150, 96), (300, 64))),
    {"tum_fr1_rpy": (144, 60, 300, 450, 600), "seven_scenes_kitchen": (251, 100, 450, 650, 850)},
    {
        "tum_fr1_rpy": ((150, 20), (200, 30), (400, 45)),
        "seven_scenes_kitchen": ((250, 20), (350, 25), (600, 40)),
    },
)
OTHERS = Plan(
    "others",
    (7,),
    ((12, 120, 96), (13, 400, 64), *((seed, 200, 64) for seed in (10, 11, *range(20, 28)))),
    {"tum_fr1_rpy": (200, 380, 520), "seven_scenes_kitchen": (180, 350, 550, 750, 880)},
    dict.fromkeys(("tum_fr1_rpy", "seven_scenes_kitchen"), ((200, 25), (300, 35), (500, 50))),
)


@dataclass(frozen=True)
class Outcome:
    """A forecast, its intervals for a test and for infinitely many images, and what was measured.

    Errors are in shares of the range.
    """

    forecast: float
    interval: tuple[float, float]
    of_many: tuple[float, float]
    measured: float
    n_learned: float
    n_tested: float

    @property
    def holds(self) -> bool:
        """Whether the interval for a test holds what was measured."""
        return self.interval[0] <= self.measured <= self.interval[1]


def tables(quick: bool) -> Iterator[Findings]:
    """Counts over all degrees of freedom of every kind of data."""
    at_hand = [name for name in CHOSEN_ON.limits if (real_images.SHARED / name).exists()]
    for name in set(CHOSEN_ON.limits) - set(at_hand):
        print(f"{name} is not beside the project: left out", file=sys.stderr)
    print(f"kuka_board: left out, its 28 images are fewer than {LEAST_IMAGES}", file=sys.stderr)
    rows = []
    with threadpool_limits(1):
        for plan in (CHOSEN_ON, OTHERS):
            every, n_sets = list[Outcome](), 0
            splits = plan.splits[:1] if quick else plan.splits
            for kind in ("simulated", *at_hand):
                sets = _simulated(plan) if kind == "simulated" else _views(kind, plan)
                found, n = list[Outcome](), 0
                for title, data in islice(sets, 2 if quick else None):
                    outcomes = [one for seed in splits for one in measure(data, seed)]
                    held = sum(one.holds for one in outcomes)
                    print(f"{kind} {title}: {held} of {len(outcomes)}", file=sys.stderr, flush=True)
                    found += outcomes
                    n += 1
                rows.append(_row(f"{kind}, {plan.title}", n, found))
                every, n_sets = every + found, n_sets + n
            rows.append(_row(f"all, {plan.title}", n_sets, every))
    yield Findings(
        "Intervals of the forecast",
        "shares of the degrees of freedom whose measured error the 90 % interval of the forecast "
        f"holds; features {', '.join(FAMILIES)}, Gaussian process; chosen on = the sets that the "
        "form of the interval was chosen on, three splits each; groups = independent groups that "
        "were learned from and tested, medians; factor = by which the interval goes up and down, "
        "median; of many = the interval for infinitely many images, which does not know that the "
        "test images are few",
        ("data", "sets", "dofs", "groups", "holds", "is lower", "is higher", "factor", "of many"),
        rows,
    )


def measure(data: PoseImageSet, seed: int) -> list[Outcome]:
    """Forecast and measured error of every degree of freedom for one split of a data set."""
    independence = independent_groups(data)
    try:
        split = split_groups(data, independence, seed)
    except InvalidInputError:
        return []
    learned, tested = (independence.labels[part] for part in (split.learned, split.test))
    groups = None if len(np.unique(learned)) == len(learned) else independence.labels
    targets = np.where(mask_of(data.dofs), data.delta_p() / data.ranges(), 0.0)
    moving = [dof for i, dof in enumerate(DOFS) if np.ptp(targets[split.learned, i]) > 0]
    table = FeatureTable.fit(
        data.images, targets, FAMILIES, split.learned, groups=groups, n_folds=3, n_jobs=1
    )
    recipes = {name: Recipe(name, settings={"max_iter": 15}) for name in table.fitted}
    jobs = [(recipe, dof) for recipe in recipes.values() for dof in moving]
    forecasts = iter(forecast_all(table, targets, groups, jobs, n_jobs=1))
    candidates = {
        name: Candidate(recipe, len(table.columns(recipe)), {d: next(forecasts) for d in moving})
        for name, recipe in recipes.items()
    }
    chosen = {dof: candidates[name] for dof, name in choose(candidates).items()}
    jobs = [(one.recipe, dof) for dof, one in chosen.items()]
    fitted = fit_all(table, targets, split, jobs, seed=seed, n_jobs=1)
    found = []
    for one in fitted:
        forecast = chosen[one.dof].forecasts[one.dof]
        found.append(
            Outcome(
                float(forecast.rms[0]),
                tuple(forecast.interval_of_test(learned, tested)[:, 0]),
                tuple(forecast.interval[:, 0]),
                one.test_rms,
                effective_groups(learned),
                effective_groups(tested),
            )
        )
    return found


def _simulated(plan: Plan) -> Iterator[tuple[str, PoseImageSet]]:
    for part in PARTS:
        for seed, n_images, size in plan.simulated:
            config = AcquisitionConfig(n_images=n_images, image_size=size, part=part, seed=seed)
            with tempfile.TemporaryDirectory() as folder:
                data = acquire(Path(folder) / "data", config, n_jobs=1)
            yield f"{part}, seed {seed}, {n_images} images", data


def _views(name: str, plan: Plan) -> Iterator[tuple[str, PoseImageSet]]:
    """The frames of a sequence about each reference and within each limit, if there are enough."""
    images, poses, times = _read(name)
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
            yield f"about image {reference} within {mm} mm and {deg} deg", data


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
        return f"{np.mean(hits):.0%}"

    factors = [np.sqrt(one.interval[1] / one.interval[0]) for one in found]
    groups = [np.median([getattr(o, n) for o in found]) for n in ("n_learned", "n_tested")]
    return (
        kind,
        str(n_sets),
        str(len(found)),
        " / ".join(f"{n:.0f}" for n in groups),
        share([one.holds for one in found]),
        share([one.measured < one.interval[0] for one in found]),
        share([one.measured > one.interval[1] for one in found]),
        f"{np.median(factors):.2f}",
        share([one.of_many[0] <= one.measured <= one.of_many[1] for one in found]),
    )
