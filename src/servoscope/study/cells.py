"""The paper's statements over many simulated cells: in what share of them each holds, and why."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binomtest, norm, qmc, spearmanr

from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.scene.camera import Lens, Sensor
from servoscope.scene.lighting import Lighting, PointLight
from servoscope.scene.scene import Scene
from servoscope.storage.folders import scratch_folder
from servoscope.storage.run_folder import open_run_folder, read_json
from servoscope.study.agreement import compare_with_paper
from servoscope.study.paper import FAMILIES, StudyConfig
from servoscope.study.results import list_units, mean_rms
from servoscope.study.run import Study

Values = dict[str, Any]

FACTORS = {
    "ambient": ("Share of the light that comes from all around", 0.25, 0.85),
    "lamp_m": ("How far the lamps stand from where they do by default, [m]", 0.0, 0.5),
    "exposure": ("Exposure", 0.7, 1.15),
    "focal_length": ("Focal length, [image widths]", 1.35, 1.95),
    "distortion": ("Distortion of the lens, k1", -0.25, 0.0),
    "sensor": ("Sensor, from clean (0) to poor (1)", 0.0, 1.0),
}
"""What differs between cells beside the part and the seeds: in words, and from where to where."""

CLEAN = Sensor(full_well=40_000.0, read_noise=8.0, blur=0.4 / 256, vignetting=0.02)
POOR = Sensor(full_well=1_500.0, read_noise=40.0, blur=1.5 / 256, vignetting=0.35)

LEVEL = 0.90
"""Of every interval."""

IMAGE_SIZE = 64
"""Of each cell by default, [px]; the paper's are of 256."""


def lighter(config: StudyConfig) -> StudyConfig:
    """Settings under which a cell takes seconds: one trial a net, not three, and fewer subsets."""
    return replace(config, restarts=1, n_thresholds=7)


MOST_CELLS = 1000
"""Cells of one seed."""


@dataclass(frozen=True)
class Cell:
    """A simulated cell: another casting, lights, lens and sensor, and the seed of all draws.

    Parameters
    ----------
    number : int
        From 0.
    factors : dict
        By the names of `FACTORS`.
    seed : int
        Of all the cells.
    """

    number: int
    factors: Mapping[str, float]
    seed: int = 0

    @property
    def own_seed(self) -> int:
        """The variant of the part, and the seed of the poses, the noise, the split and the nets.

        Cells of other seeds have others: a study of them is one of other cells.
        """
        return MOST_CELLS * self.seed + self.number

    def scene(self, image_size: int) -> Scene:
        """What is seen."""
        f = self.factors
        lens = replace(Lens(), focal_length=f["focal_length"], distortion=(f["distortion"], 0.04))
        sensor = replace(_sensor(f["sensor"]), exposure=f["exposure"])
        part = AcquisitionConfig(variant=self.own_seed).scene().part
        return Scene(part, self._lighting(), lens, sensor, image_size)

    def _lighting(self) -> Lighting:
        """Lamps moved by a distance in directions of their own, and as much light in all."""
        rng = np.random.default_rng([self.seed, self.number, 3])
        usual, share = Lighting(), self.factors["ambient"]
        total = usual.ambient + sum(map(_light_of, usual.lamps))
        moved = []
        for lamp in usual.lamps:
            move = rng.normal(size=3)
            move *= self.factors["lamp_m"] / np.linalg.norm(move)
            move[2] = abs(move[2])  # never below the camera
            x, y, z = np.add(lamp.position, move).tolist()
            moved.append(replace(lamp, position=(x, y, z)))
        factor = (1 - share) * total / sum(map(_light_of, moved))
        lamps = tuple(replace(lamp, strength=factor * lamp.strength) for lamp in moved)
        return Lighting(lamps, share * total)


def _light_of(lamp: PointLight) -> float:
    """The radiance that a white plane scatters below the camera."""
    x, y, z = lamp.position
    return lamp.strength * z / float(x * x + y * y + z * z) ** 1.5


@dataclass(frozen=True)
class CellAcquisition(AcquisitionConfig):
    """What images to take in a `Cell`: the paper's poses, another scene."""

    cell: Cell | None = None

    def scene(self) -> Scene:
        """The scene of the cell."""
        return super().scene() if self.cell is None else self.cell.scene(self.image_size)


def _sensor(share: float) -> Sensor:
    """A sensor between the clean and the poor one, each property at equal ratios."""
    return Sensor(
        **{
            name: float(getattr(CLEAN, name) ** (1 - share) * getattr(POOR, name) ** share)
            for name in vars(CLEAN)
        }
    )


def make_cells(n_cells: int, seed: int = 0) -> list[Cell]:
    """Cells whose factors are spread evenly over their ranges (a Latin hypercube).

    Examples
    --------
    >>> cells = make_cells(4)
    >>> np.sort([np.floor(4 * cell.factors["sensor"]) for cell in cells]).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    shares = qmc.LatinHypercube(len(FACTORS), rng=np.random.default_rng([seed, 4])).random(n_cells)
    return [
        Cell(
            number,
            {
                name: low + float(share) * (high - low)
                for share, (name, (_, low, high)) in zip(row, FACTORS.items(), strict=True)
            },
            seed,
        )
        for number, row in enumerate(shares)
    ]


def study_cell(cell: Cell, n_images: int, image_size: int, config: StudyConfig) -> Values:
    """What the study finds in one cell, by one process, as plain JSON values.

    Returns
    -------
    dict
        ``verdicts`` by statement of the paper; ``means``, the mean RMS error of each family over
        the degrees of freedom and the displacement forms, under the paper's protocol.
    """
    start = time.perf_counter()
    seed = cell.own_seed
    with TemporaryDirectory(dir=scratch_folder(), ignore_cleanup_errors=True) as scratch:
        place = Path(scratch)
        config = replace(config, seed=seed)
        asked = CellAcquisition(n_images=n_images, image_size=image_size, seed=seed, cell=cell)
        data = acquire(place / "dataset", asked, n_jobs=1)
        run = open_run_folder(place / "run", {"command": "study", **asdict(config)})
        Study(run, data, config, n_jobs=1).run()
        summary = read_json(run.path / "summary.json")
    units = list_units(summary)
    results = [unit.results for unit in units if unit.protocol == "paper"]
    results = results or [unit.results for unit in units]
    return {
        **_described(cell),
        "verdicts": {one.claim: one.verdict for one in compare_with_paper(summary)},
        "means": {
            family: float(np.mean([mean_rms(one, one["table1"][family]) for one in results]))
            for family in FAMILIES
        },
        "seconds": round(time.perf_counter() - start, 3),
    }


def failed_cell(cell: Cell, reason: str) -> Values:
    """What is said of a cell that could not be studied: it counts nowhere."""
    return {**_described(cell), "verdicts": {}, "means": {}, "seconds": None, "error": reason}


def _described(cell: Cell) -> Values:
    factors = {name: round(value, 6) for name, value in cell.factors.items()}
    return {"number": cell.number, "factors": factors}


def summarise_cells(cells: Sequence[Values]) -> Values:
    """In what share of cells each statement holds, and what the order of the families depends on.

    Parameters
    ----------
    cells : sequence of dict
        Of `study_cell` and `failed_cell`; those that failed count nowhere.

    Returns
    -------
    dict
        ``n_cells``, how many count, and ``n_failed``, how many do not; ``statements``, each with
        how many cells say yes, partly and no, and the ``share`` that say yes with its
        ``interval``; ``second``, how often each family is second; ``depends``, by factor, see
        `association`.
    """
    found = [one for one in cells if one.get("error") is None]
    claims = found[0]["verdicts"] if found else ()
    verdicts = {claim: [one["verdicts"][claim] for one in found] for claim in claims}
    second = [sorted(one["means"], key=one["means"].__getitem__)[1] for one in found]
    ratio = [np.log2(one["means"]["pci"] / one["means"]["pca"]) for one in found]
    return {
        "n_cells": len(found),
        "n_failed": len(cells) - len(found),
        "level": LEVEL,
        "statements": [{"claim": claim, **share_of(said)} for claim, said in verdicts.items()],
        "second": {family: second.count(family) for family in FAMILIES if family in second},
        "pci_before_pca": sum(bool(value < 0) for value in ratio),
        "depends": [
            {"factor": name, **association([one["factors"][name] for one in found], ratio, second)}
            for name in FACTORS
        ],
    }


def share_of(verdicts: Sequence[str]) -> Values:
    """How many verdicts are yes, partly and no, and the share of yes with Wilson's interval.

    Examples
    --------
    >>> found = share_of(["yes"] * 9 + ["partly"])
    >>> found["yes"], found["share"], np.round(found["interval"], 1).tolist()
    (9, 0.9, [0.7, 1.0])
    """
    n_yes, n = verdicts.count("yes"), len(verdicts)
    interval = binomtest(n_yes, n).proportion_ci(LEVEL, method="wilson")
    counts = {said: verdicts.count(said) for said in ("yes", "partly", "no")}
    return {**counts, "share": n_yes / n, "interval": [float(interval.low), float(interval.high)]}


def association(factor: Iterable[float], ratio: Sequence[float], second: Sequence[str]) -> Values:
    """How a factor of the cells goes with the order of PCI and PCA.

    Parameters
    ----------
    factor : iterable of float
        Of each cell.
    ratio : sequence of float
        Logarithm of the error of PCI over that of PCA.
    second : sequence of str
        The family that is second.

    Returns
    -------
    dict
        ``low`` and ``high``: how often each family is second in the lower half of the cells by the
        factor and in the upper one; ``rank_correlation`` of factor and ratio (Spearman), with its
        ``interval`` by Fisher's z (Bonett and Wright, 2000), None of fewer than 5 cells; negative
        where PCI gains on PCA as the factor grows.
    """
    values = np.array(list(factor))
    order = np.argsort(values, kind="stable")
    halves = {"low": order[: len(order) // 2], "high": order[len(order) // 2 :]}
    counts = {
        half: {family: sum(second[i] == family for i in cells) for family in FAMILIES}
        for half, cells in halves.items()
    }
    kept = {half: {f: n for f, n in said.items() if n} for half, said in counts.items()}
    if len(values) < 5:
        return {**kept, "rank_correlation": None, "interval": None}
    rho = float(spearmanr(values, ratio).statistic)
    z, width = np.arctanh(np.clip(rho, -0.999, 0.999)), norm.ppf((1 + LEVEL) / 2)
    width *= np.sqrt((1 + rho**2 / 2) / (len(values) - 3))
    interval = [float(np.tanh(z - width)), float(np.tanh(z + width))]
    return {**kept, "rank_correlation": rho, "interval": interval}
