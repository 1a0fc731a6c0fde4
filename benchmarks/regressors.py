"""The regressors on the study's features: error, coverage of their 95 % intervals, time.

``python -m benchmarks.regressors DATASET ... [--seeds N] [--form FORM] [--markdown]`` takes data
sets that are there; as one of the benchmarks it takes a simulated one of its own.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import servoscope as sv
from benchmarks.tables import Findings, as_markdown, as_text
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.independence import split_data
from servoscope.features import compute_image_basis
from servoscope.pipeline import Fitted
from servoscope.poses import DISPLACEMENTS
from servoscope.study.information import CANDIDATES, compute_feature_table
from servoscope.study.paper import FAMILIES, N_EIGENVECTORS

FEATURES = {
    "24 moments": FAMILIES["gm"].recipe,
    "24 eigenfeatures": FAMILIES["pca"].recipe,
    "all 65": CANDIDATES,
}

HEADER = ("features", "regressor", *sv.DOFS, "mean", "covered", "width / RMS", "fit s")


def tables(quick: bool) -> Iterator[Findings]:
    """One table, of a simulated set."""
    n_images, size = (300, 64) if quick else (1000, 256)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "simulated"
        acquire(path, AcquisitionConfig(n_images=n_images, image_size=size))
        yield findings(path)


def findings(folder: Path, seeds: Sequence[int] = (0,), form: str = "pivot") -> Findings:
    """Every regressor on every set of features of a data set, averaged over splits."""
    data = sv.PoseImageSet.load(folder)
    moments = sv.GeometricMoments().fit_transform(data.images)
    measured = [_scores(data, moments, seed, form) for seed in seeds]
    rows = [
        (features, regressor, *_row([scores[features] for scores in measured], regressor))
        for features in measured[0]
        for regressor in sv.REGRESSORS
    ]
    job = (
        f"RMS of targets scaled by the range, on test images, {form} form, {len(data)} images, "
        f"honest split, mean of {len(seeds)}; covered: share of test images in their 95 % "
        "interval; width / RMS: mean width of that interval, 3.92 where errors are normal and "
        "known; fit: processor seconds a dof"
    )
    return Findings(f"Regressors, {folder.name}", job, HEADER, rows)


def _scores(
    data: sv.PoseImageSet, moments: np.ndarray, seed: int, form: str
) -> dict[str, list[Fitted]]:
    """Scores by set of features, for one split."""
    split = split_data(data, "honest", seed)
    basis = compute_image_basis(data.images[split.train], N_EIGENVECTORS)
    table, _ = compute_feature_table(data, moments, basis, split.train, form)
    targets = data.delta_p(form) / data.ranges(form)
    return {
        features: sv.fit_all(table, targets, split, _jobs(recipe))
        for features, recipe in FEATURES.items()
    }


def _jobs(recipe: sv.Recipe) -> list[tuple[sv.Recipe, str]]:
    """Every regressor on its features, for every dof."""
    return [
        (replace(recipe, regressor=regressor), dof)
        for regressor in sv.REGRESSORS
        for dof in sv.DOFS
    ]


def _row(measured: Sequence[Sequence[Fitted]], regressor: str) -> tuple[str, ...]:
    """A regressor's cells: errors by dof and their mean, coverage, width and seconds."""
    scores = [score for split in measured for score in split if score.recipe.regressor == regressor]
    errors = {
        dof: np.mean([score.test_rms for score in scores if score.dof == dof]) for dof in sv.DOFS
    }
    widths = [score.interval_width / score.test_rms for score in scores]
    return (
        *(f"{error:.3f}" for error in errors.values()),
        f"{np.mean(list(errors.values())):.4f}",
        f"{np.mean([score.coverage for score in scores]):.1%}",
        f"{np.median(widths):.2f}",
        f"{np.mean([score.fit_seconds for score in scores]):.2f}",
    )


def main() -> None:
    """Print a table for each data set."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.regressors", description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DATASET")
    parser.add_argument("--seeds", type=int, default=1, help="splits to average over")
    parser.add_argument("--form", choices=DISPLACEMENTS, default="pivot")
    parser.add_argument("--markdown", action="store_true")
    options = parser.parse_args()
    show = as_markdown if options.markdown else as_text
    for folder in options.folders:
        print(show(findings(folder, range(options.seeds), options.form)), "\n", flush=True)


if __name__ == "__main__":
    main()
