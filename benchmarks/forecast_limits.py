"""What information alone allows, and what learning curves foretell, beside what comes of it.

Not timed: ``python -m benchmarks.forecast_limits DATASET [DATASET ...]`` prints tables of Markdown.
The first compares the entropy power with the test errors of Gaussian processes, on every family and
on the first candidates in ideal-point order. The second takes the learning curve of half of the
training images and asks it for the error at all of them, which is then forecast from all.
"""

from __future__ import annotations

import argparse
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

import servoscope as sv
from benchmarks.entropy_power import entropy_power
from benchmarks.forecast import StudyFeatures, blocks, feature_subsets
from benchmarks.forecast_agreement import BAND, rms
from benchmarks.tables import Findings, as_markdown
from servoscope.data.independence import split_data
from servoscope.poses import DISPLACEMENTS
from servoscope.processes import in_processes
from servoscope.study.information import study_table

LEARNT = ("gm", "pca", "first 65")
"""Features whose learning curves are tried."""


class Ratios(NamedTuple):
    """Figures over what was reached, one for each set of features and dof."""

    single: list[float]
    joint: list[float]
    curve: list[float]
    held: list[bool]


def main() -> None:
    """Print both tables for some data sets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DATASET")
    folders = parser.parse_args().folders
    limits, curves = [], []
    for folder in folders:
        calls = [(folder, form, dof) for form in DISPLACEMENTS for dof in sv.DOFS]
        parts = list(in_processes(measure, calls, -1))
        joined = Ratios(*(list(chain.from_iterable(lists)) for lists in zip(*parts, strict=True)))
        limits += [
            (folder.name, name, *_limit(getattr(joined, name))) for name in Ratios._fields[:2]
        ]
        curves.append((folder.name, *_curve(joined)))
    print(as_markdown(_limits_table(limits)))
    print(f"\n{as_markdown(_curves_table(curves))}")


def measure(folder: Path, form: str, dof: str) -> Ratios:
    """The ratios of one data set, form and dof, over all sets of features."""
    data = sv.PoseImageSet.load(folder)
    split = split_data(data, "honest", 0)
    targets = data.delta_p(form) / data.ranges(form)
    fitted = StudyFeatures().fit(data.images[split.train], targets[split.train])
    table = study_table(fitted.transform(data.images), fitted.names)
    y = targets[:, sv.DOFS.index(dof)]
    groups = blocks(data) if data.split == "blocks" else np.arange(len(data))
    found = Ratios([], [], [], [])
    for name, columns in feature_subsets(table, y, split.train, dof).items():
        X = table.values[:, columns]
        process = sv.GaussianProcess().fit(X[split.train], y[split.train])
        reached = rms(process.predict(X[split.test]) - y[split.test])
        allowed = entropy_power(X[split.train], y[split.train])
        found.single.append(float(allowed.single[0]) / reached)
        found.joint.append(float(allowed.joint[0]) / reached)
        if name in LEARNT:
            ratio, held = _foretold(X[split.train], y[split.train], groups[split.train])
            found.curve.append(ratio)
            found.held.append(held)
    return found


def _foretold(X: np.ndarray, y: np.ndarray, groups: np.ndarray) -> tuple[float, bool]:
    """Error foretold from half of the groups over the forecast from all; whether it is in reach."""
    names = np.random.default_rng(0).permutation(np.unique(groups))
    half = np.isin(groups, names[: len(names) // 2])
    in_blocks = len(names) < len(y)
    known = sv.learning_curve(X[half], y[half], groups=groups[half] if in_blocks else None)
    foretold = known.rms_at(len(y))
    forecast = sv.forecast_errors(X, y, groups=groups if in_blocks else None).rms[0]
    low, high = foretold.interval[:, 0]
    return float(foretold.rms[0] / forecast), bool(low <= forecast <= high)


def _limit(ratios: list[float]) -> tuple[str, ...]:
    low, middle, high = np.quantile(ratios, (0, 0.5, 1))
    above = np.mean(np.array(ratios) > 1)
    return str(len(ratios)), f"{middle:.2f}", f"{low:.2f} to {high:.2f}", f"{above:.0%}"


def _curve(found: Ratios) -> tuple[str, ...]:
    ratio = np.array(found.curve)
    within = np.mean((ratio >= BAND[0]) & (ratio <= BAND[1]))
    return (
        *(str(len(ratio)), f"{np.median(ratio):.2f}"),
        *(f"{ratio.min():.2f} to {ratio.max():.2f}", f"{within:.0%}", f"{np.mean(found.held):.0%}"),
    )


def _limits_table(rows: list[tuple[str, ...]]) -> Findings:
    header = ("data", "from", "cases", "median ratio", "range", "above what was reached")
    job = "Error that information allows, over that of a Gaussian process on test images"
    return Findings("Entropy power", job, header, rows)


def _curves_table(rows: list[tuple[str, ...]]) -> Findings:
    header = ("data", "cases", "median ratio", "range", "within 0.75 to 1.33", "interval holds")
    job = "Error foretold for all training images from half of them, over that forecast from all"
    return Findings("Learning curves", job, header, rows)


if __name__ == "__main__":
    main()
