"""Errors forecast before training beside those that were reached on test images.

``python -m benchmarks.forecast [DATASET ...] [--seeds N] [--figure FILE]`` takes data sets that are
there; as one of the benchmarks it takes a simulated one of its own.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import servoscope as sv
from benchmarks.forecast_agreement import (
    FAMILIES,
    SIZES,
    Point,
    agreement,
    plot_agreement,
    pooled,
    rms,
)
from benchmarks.tables import Findings, as_text
from benchmarks.timing import Contender, Table, race
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.independence import split_data
from servoscope.data.splits import Split
from servoscope.features import compute_image_basis
from servoscope.pipeline import FeatureTable
from servoscope.poses import DISPLACEMENTS
from servoscope.processes import in_processes
from servoscope.selection import Fold, MutualInfoSelector, cut_folds, forecast_from_folds
from servoscope.selection.rms_interval import rms_interval
from servoscope.study.information import CANDIDATES, lfa_window, study_table
from servoscope.study.paper import FAMILIES as PAPER_FAMILIES

N_BLOCKS = 20


class StudyFeatures:
    """The 65 candidates of the study and the features of LFA, as one family."""

    def fit(self, images, delta_p):
        """Fit every family to the training images."""
        basis = compute_image_basis(images, 85)
        window = lfa_window(images.shape[1:])
        self.families = {
            "gm": sv.GeometricMoments(),
            "pca": sv.Eigenfeatures(35, basis=basis),
            "pci": sv.PoseImageCovariance(),
            "lfa35": sv.LocalFeatureAnalysis(35, window=window, basis=basis),
            "lfa85": sv.LocalFeatureAnalysis(85, window=window, basis=basis),
        }
        for family in self.families.values():
            family.fit(images, delta_p)
        return self

    def transform(self, images):
        """One row an image."""
        return np.column_stack([family.transform(images) for family in self.families.values()])

    @property
    def names(self) -> tuple[str, ...]:
        """As `FeatureTable` has them."""
        return tuple(
            name.replace("lfa", key)
            for key, family in self.families.items()
            for name in family.get_feature_names_out()
        )


def tables(quick: bool) -> Iterator[Table | Findings]:
    """The time that a forecast takes, and agreement, on a simulated set."""
    n_images, size = (300, 64) if quick else (1000, 256)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "simulated"
        acquire(path, AcquisitionConfig(n_images=n_images, image_size=size))
        yield timings(path)
        yield agreement(measure_all([path], n_seeds=1))


def timings(folder: Path) -> Table:
    """Of a forecast from the 65 candidates for all dofs."""
    data = sv.PoseImageSet.load(folder)
    targets = data.delta_p() / data.ranges()
    fitted = StudyFeatures().fit(data.images, targets)
    table = study_table(fitted.transform(data.images), fitted.names)
    X = table.values[:, table.columns(CANDIDATES)]
    contenders = [
        Contender("forecast_errors", lambda: sv.forecast_errors(X, targets)),
        Contender("learning_curve", lambda: sv.learning_curve(X, targets)),
        Contender(
            "forward_selection of 24, one dof", lambda: sv.forward_selection(X, targets[:, 0])
        ),
    ]
    job = f"{X.shape[1]} features, 6 targets, {len(X)} images, one process (target: 2 s)"
    return Table("Forecast", job, race(contenders, repeats=3))


def measure_all(folders: Sequence[Path], n_seeds: int) -> list[Point]:
    """The points of all data sets, splits and forms."""
    calls = [(f, seed, form) for f in folders for seed in range(n_seeds) for form in DISPLACEMENTS]
    return [point for points in in_processes(measure, calls, -1) for point in points]


def measure(folder: Path, seed: int, form: str) -> list[Point]:
    """Every family and subset, for every dof of one data set, split and form."""
    data = sv.PoseImageSet.load(folder)
    split = split_data(data, "honest", seed)
    runs = blocks(data) if data.split == "blocks" else None
    targets = data.delta_p(form) / data.ranges(form)
    images, known = data.images[split.train], targets[split.train]
    fitted = StudyFeatures().fit(images, known)
    table = study_table(fitted.transform(data.images), fitted.names)
    groups = None if runs is None else runs[split.train]
    folds = [
        Fold(
            out,
            StudyFeatures()
            .fit(np.delete(images, out, 0), np.delete(known, out, 0))
            .transform(images),
        )
        for out in cut_folds(known, groups, n_folds=5)
    ]
    points = []
    for j, dof in enumerate(sv.DOFS):
        subsets = feature_subsets(table, targets[:, j], split.train, dof)
        errors = _errors(table.values, targets[:, j], split, runs, subsets.values(), folds)
        points += [
            Point(folder.name, seed, form, features, dof, **found)
            for features, found in zip(subsets, errors, strict=True)
        ]
    return points


def blocks(data: sv.PoseImageSet) -> np.ndarray:
    """The run of a sequence that each image belongs to, as the split by blocks has them."""
    times = np.arange(len(data)) if data.times is None else data.times
    runs = np.empty(len(data), int)
    for i, run in enumerate(np.array_split(np.argsort(times, kind="stable"), N_BLOCKS)):
        runs[run] = i
    return runs


def feature_subsets(
    table: FeatureTable, target: np.ndarray, train: np.ndarray, dof: str
) -> dict[str, np.ndarray]:
    """Columns of the families, and of the first candidates in ideal-point order."""
    subsets = {
        family: table.columns(PAPER_FAMILIES[family].recipe.for_dof(dof)) for family in FAMILIES
    }
    candidates = table.columns(CANDIDATES)
    selector = MutualInfoSelector(n_features=len(candidates))
    order = selector.fit(table.values[np.ix_(train, candidates)], target[train]).ranking_
    return subsets | {f"first {size}": candidates[order[:size]] for size in SIZES}


def _errors(X, y, split: Split, runs, subsets, folds) -> Iterator[dict[str, float]]:
    """What was forecast and reached with each subset of columns, as `Point` has it."""
    groups, unseen_groups = (None if runs is None else runs[r] for r in (split.train, split.test))
    known, unseen = y[split.train], y[split.test]
    table = FeatureTable(X, tuple(map(str, range(X.shape[1]))), ("own",) * X.shape[1])
    recipes = [
        sv.Recipe("own", tuple(map(str, columns)), "levenberg_marquardt") for columns in subsets
    ]
    jobs = [(recipe, "dof") for recipe in recipes]
    nets = sv.fit_all(table, y[:, None], split, jobs, dofs=("dof",), n_jobs=1)
    for columns, net in zip(subsets, nets, strict=True):
        A, B = X[np.ix_(split.train, columns)], X[np.ix_(split.test, columns)]
        plain = sv.forecast_errors(A, known, groups=groups)
        refitted = forecast_from_folds(folds, known, columns=columns, groups=groups)
        process = (sv.GaussianProcess().fit(A, known).predict(B) - unseen)[:, None]
        yield {
            "forecast": float(plain.rms[0]),
            "forecast_spread": float(plain.interval[1, 0] / plain.rms[0]),
            "crossfit": float(refitted.rms[0]),
            "crossfit_spread": float(refitted.interval[1, 0] / refitted.rms[0]),
            "gp": rms(process),
            "gp_spread": float(rms_interval(process, unseen_groups)[1, 0] / rms(process)),
            "nets": net.test_rms,
        }


def main() -> None:
    """Print the agreement on data sets, and draw it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.forecast", description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DATASET")
    parser.add_argument("--seeds", type=int, default=1, help="how many splits of each")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    options = parser.parse_args()
    points = measure_all(options.folders, options.seeds)
    print(as_text(agreement(points)))
    if options.figure is not None:
        import matplotlib.pyplot as plt

        names = list(dict.fromkeys(p.data for p in points))
        figure, panels = plt.subplots(
            1, len(names), figsize=(4.2 * len(names), 4), squeeze=False, layout="constrained"
        )
        for name, ax in zip(names, panels[0], strict=True):
            shown = pooled([p for p in points if p.data == name])
            plot_agreement(shown, "crossfit", ax=ax).set_title(name)
        figure.savefig(options.figure, dpi=150)


if __name__ == "__main__":
    main()
