"""Families of features side by side: errors in clean and in disturbed images.

Not timed: ``python -m benchmarks.families DATASET [--seeds N] [--displacement camera] [--figure
FILE.png]`` prints tables of Markdown, and draws the errors. Features are fitted to the training
images of the honest split, and so are the regressors, one a degree of freedom: the default, a
Gaussian process, which learns from the validation images as well, and the paper's nets, which
those images stop. Errors are those of the test images, of targets in units of the range; the same
regressors are then shown the test images with one disturbance each.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import servoscope as sv
from benchmarks.family_features import PUBLISHED, FamilySamples, compute_families
from benchmarks.family_figure import draw_errors
from benchmarks.tables import Findings, as_markdown
from servoscope.data.independence import split_data
from servoscope.features.catalogue import default_families
from servoscope.processes import one_blas_thread
from servoscope.scene.disturbances import SINGLE_DISTURBANCES

CONDITIONS = ("clean", *SINGLE_DISTURBANCES)
MAX_SAMPLES = 5000
"""So many that no image is left out, copies included."""

NONE = "none: the mean"
"""A family of no features, which answers the mean of the training images."""

N_COMPARED = 4
"""New families that are put beside the paper's best."""

REGRESSORS = {
    "gaussian_process": lambda: sv.GaussianProcess(max_samples=MAX_SAMPLES),
    "nets": sv.LMRegressor,
}

Errors = dict[tuple[str, str], np.ndarray]
"""RMS errors of shape (n_seeds, n_conditions, 6), by family and regressor."""


def main() -> None:
    """Compare the families on one data set."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.families", description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--seeds", type=int, default=1, help="splits to average over")
    parser.add_argument("--displacement", choices=("pivot", "camera"), default="pivot")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    options = parser.parse_args()
    data = sv.PoseImageSet.load(options.dataset)
    errors = measure(data, range(options.seeds), options.displacement)
    what = (
        f"{options.dataset.name}, {len(data)} images, {options.displacement} form, honest split, "
        f"seeds {', '.join(map(str, range(options.seeds)))}"
    )
    print(f"{what}\n")
    for findings in (_clean(errors), _disturbed(errors), _worst(errors), _ratios(errors)):
        print(f"{as_markdown(findings)}\n")
    if options.figure is not None:
        means = {
            name: dict(zip(CONDITIONS, of_seeds.mean(axis=(0, 2)), strict=True))
            for name, of_seeds in _of(errors, "gaussian_process").items()
        }
        draw_errors(means, PUBLISHED).savefig(options.figure, dpi=200)


def measure(data: sv.PoseImageSet, seeds: Sequence[int], displacement: str) -> Errors:
    """Errors of every family with every regressor, for the splits of some seeds."""
    targets = data.delta_p(displacement) / data.ranges(displacement)
    targets = np.where(data.moves(displacement), targets, 0.0)
    by_seed: dict[tuple[str, str], list[np.ndarray]] = {}
    for seed in seeds:
        split = split_data(data, "honest", seed)
        parts = targets[split.train], targets[split.validation], targets[split.test]
        of_mean = np.sqrt(np.mean((parts[2] - parts[0].mean(axis=0)) ** 2, axis=0))
        for regressor in REGRESSORS:
            by_seed.setdefault((NONE, regressor), []).append(np.tile(of_mean, (len(CONDITIONS), 1)))
        for name, samples in compute_families(data, targets, split, seed).items():
            print(f"seed {seed}: {name}", file=sys.stderr, flush=True)
            for regressor in REGRESSORS:
                found = _errors(samples, *parts, regressor)
                by_seed.setdefault((name, regressor), []).append(found)
    return {key: np.array(found) for key, found in by_seed.items()}


def _errors(
    samples: FamilySamples, train: np.ndarray, validation: np.ndarray, test: np.ndarray, name: str
) -> np.ndarray:
    """RMS errors by condition and degree of freedom."""
    errors = np.empty((len(CONDITIONS), len(sv.DOFS)))
    for dof in range(len(sv.DOFS)):
        y = np.tile(train[:, dof], samples.copies)
        columns = samples.columns(samples.train, y, dof)
        with one_blas_thread():
            regressor = REGRESSORS[name]().fit(
                samples.train[:, columns], y, samples.validation[:, columns], validation[:, dof]
            )
            for row, condition in enumerate(CONDITIONS):
                missed = regressor.predict(samples.tests[condition][:, columns]) - test[:, dof]
                errors[row, dof] = np.sqrt(np.mean(missed**2))
    return errors


def _of(errors: Errors, regressor: str) -> dict[str, np.ndarray]:
    """Those with one regressor by family, the least mean error in clean images first."""
    found = {name: of_seeds for (name, one), of_seeds in errors.items() if one == regressor}
    return dict(sorted(found.items(), key=lambda item: item[1][:, 0].mean()))


def _clean(errors: Errors) -> Findings:
    """Errors in clean images."""
    rows = []
    for name, of_seeds in _of(errors, "gaussian_process").items():
        clean = of_seeds[:, 0]
        rows.append(
            (
                name,
                _origin(name),
                *(f"{error:.4f}" for error in clean.mean(axis=0)),
                f"{clean.mean():.4f}",
                " ".join(f"{error:.4f}" for error in clean.mean(axis=1)),
                f"{errors[name, 'nets'][:, 0].mean():.4f}",
            )
        )
    header = ("family", "", *sv.DOFS, "mean", "mean by seed", "mean, nets")
    job = "RMS error of a Gaussian process on clean test images; last, of the paper's nets"
    return Findings("Clean images", job, header, rows)


def _disturbed(errors: Errors) -> Findings:
    """Mean errors under each disturbance."""
    rows = [
        (name, *(f"{error:.3f}" for error in of_seeds.mean(axis=(0, 2))))
        for name, of_seeds in _of(errors, "gaussian_process").items()
    ]
    job = "Mean RMS error of the same Gaussian process on disturbed test images"
    return Findings("Disturbed images", job, ("family", *CONDITIONS), rows)


def _worst(errors: Errors) -> Findings:
    """What grows most under gain and under covering."""
    rows = [
        (
            name,
            _worst_dofs(of_seeds, "gain"),
            _worst_dofs(of_seeds, "covering"),
            _worst_dofs(errors[name, "nets"], "covering"),
        )
        for name, of_seeds in _of(errors, "gaussian_process").items()
    ]
    header = ("family", "gain", "covering", "covering, nets")
    job = "Error in units of that in clean images, of the dof where it grows most, by seed"
    return Findings("What a disturbance does to the worst dof", job, header, rows)


def _worst_dofs(of_seeds: np.ndarray, condition: str) -> str:
    clean = np.maximum(of_seeds[:, 0], np.finfo(float).tiny)
    ratios = of_seeds[:, CONDITIONS.index(condition)] / clean
    worst = ratios.argmax(axis=1)
    return ", ".join(
        f"{row[dof]:.2f} {sv.DOFS[dof]}" for row, dof in zip(ratios, worst, strict=True)
    )


def _ratios(errors: Errors) -> Findings:
    """How the best new families with the default regressor compare with the paper's best."""
    new = {
        name: of_seeds[:, 0].mean(axis=0)
        for name, of_seeds in _of(errors, "gaussian_process").items()
        if name not in (*PUBLISHED, NONE)
    }
    rows = [
        (
            name,
            label,
            *(f"{ratio:.2f}" for ratio in clean / best),
            f"{clean.mean() / best.mean():.2f}",
        )
        for name, clean in list(new.items())[:N_COMPARED]
        for label, best in _published_bests(errors).items()
    ]
    header = ("family", "of the error of", *sv.DOFS, "mean")
    job = "Clean error with the Gaussian process as a share of that of the paper's families"
    return Findings("Beside the paper's families", job, header, rows)


def _published_bests(errors: Errors) -> Mapping[str, np.ndarray]:
    """Errors by dof of the best of the paper's families, on the mean and for each dof."""
    found = {}
    for regressor, title in (("gaussian_process", "same regressor"), ("nets", "nets")):
        clean = {
            name: of_seeds[:, 0].mean(axis=0)
            for name, of_seeds in _of(errors, regressor).items()
            if name in PUBLISHED
        }
        best = min(clean, key=lambda name: clean[name].mean())
        found[f"{best}, {title}"] = clean[best]
        found[f"best for each dof, {title}"] = np.min(list(clean.values()), axis=0)
    return found


def _origin(name: str) -> str:
    """Whether it is the paper's, and whether `assess` tries it."""
    marks = ["paper's"] * (name in PUBLISHED) + ["assess"] * (name in default_families())
    return ", ".join(marks)


if __name__ == "__main__":
    main()
