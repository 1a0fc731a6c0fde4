"""Criteria side by side: the nets' error against the number of features that each one chose.

Not timed: ``python -m benchmarks.criteria DATASET [--displacement camera] [--figure FILE.png]``
prints tables of Markdown, and draws the curves, a panel a degree of freedom. All criteria choose
among the 65 candidates of the study on the training images of the honest split; all nets are the
study's, stopped on its validation images; errors are those of its test images. Further tables
show how much of the published rule's redundancy is bias, and how many candidates inform more than
chance.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import servoscope as sv
from benchmarks.tables import Findings, as_markdown
from servoscope.data.independence import split_data
from servoscope.data.splits import Split
from servoscope.selection import (
    CRITERIA,
    Candidates,
    MutualInfoSelector,
    information_test,
    redundancy_bias,
)
from servoscope.study.information import CANDIDATES, compute_feature_table
from servoscope.study.paper import N_EIGENVECTORS

COUNTS = (1, 2, 4, 8, 16, 24)
RESTARTS = 3
ALL = "all candidates"

Orders = dict[tuple[str, str], list[int]]
"""Features in the order of selection, by criterion and dof."""

Errors = dict[tuple[str, str, int], float]
"""RMS error on the test images, in units of the range, by criterion, dof and feature count."""

GREYS = ("0.0", "0.45", "0.7")
DASHES = ("-", "--", ":")


def main() -> None:
    """Compare the criteria on one data set."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--displacement", choices=("pivot", "camera"), default="camera")
    parser.add_argument("--figure", type=Path, default=Path("criteria.png"), metavar="FILE")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    data = sv.PoseImageSet.load(options.dataset)
    split = split_data(data, "honest", options.seed)
    X, Y = _samples(data, options.displacement, split)
    orders = _orders(X[split.train], Y[split.train])
    errors = _errors(X, Y, orders, split, options.seed)
    print(as_markdown(_errors_by_count(errors, f"{options.dataset}, {options.displacement} form")))
    in_order = np.sort(split.train)
    for findings in (_bias, _significance):
        print(f"\n{as_markdown(findings(X[in_order], Y[in_order]))}")
    _draw(errors).savefig(options.figure, dpi=200)


def _samples(
    data: sv.PoseImageSet, displacement: str, split: Split
) -> tuple[np.ndarray, np.ndarray]:
    """The candidates of the study and the scaled displacements of all images."""
    basis = sv.compute_image_basis(data.images[split.train], N_EIGENVECTORS)
    moments = sv.GeometricMoments().fit_transform(data.images)
    table, _ = compute_feature_table(data, moments, basis, split.train, displacement)
    targets = data.delta_p(displacement) / data.ranges(displacement)
    moving = np.where(data.moves(displacement), targets, 0.0)
    return table.values[:, table.columns(CANDIDATES)], moving


def _orders(X: np.ndarray, Y: np.ndarray) -> Orders:
    return {
        (criterion, dof): MutualInfoSelector(max(COUNTS), criterion).fit(X, y).ranking_.tolist()
        for criterion in CRITERIA
        for dof, y in zip(sv.DOFS, Y.T, strict=True)
    }


def _errors(X: np.ndarray, Y: np.ndarray, orders: Orders, split: Split, seed: int) -> Errors:
    """Train each subset once, whichever criteria and counts share it."""
    subsets = {
        (*key, n): (key[1], tuple(sorted(order[:n])))
        for key, order in orders.items()
        for n in COUNTS
    }
    everything = tuple(range(X.shape[1]))
    subsets |= {(ALL, dof, X.shape[1]): (dof, everything) for dof in sv.DOFS}
    distinct = list(dict.fromkeys(subsets.values()))
    table = sv.FeatureTable(X, tuple(map(str, range(X.shape[1]))), ("own",) * X.shape[1])
    settings = {"restarts": RESTARTS}
    jobs = [
        (sv.Recipe("own", tuple(map(str, subset)), "levenberg_marquardt", settings), dof)
        for dof, subset in distinct
    ]
    nets = sv.fit_all(table, Y, split, jobs, seed=seed)
    rms = {subset: net.test_rms for subset, net in zip(distinct, nets, strict=True)}
    return {key: rms[subset] for key, subset in subsets.items()}


def _errors_by_count(errors: Errors, data: str) -> Findings:
    rows = []
    lines = dict.fromkeys((n, criterion) for criterion, _, n in errors)
    for n, criterion in sorted(lines, key=lambda line: line[0]):
        own = [errors[criterion, dof, n] for dof in sv.DOFS]
        rows.append((str(n), criterion, *(f"{e:.3f}" for e in (*own, np.mean(own)))))
    header = ("features", "criterion", *sv.DOFS, "mean")
    job = f"RMS error on the test images, 1 being the range; {data}; best of {RESTARTS} nets"
    return Findings("Criteria", job, header, rows)


def _bias(X: np.ndarray, Y: np.ndarray) -> Findings:
    """Redundancy of the published rule's choice at some steps, and how much of it is bias."""
    rows = []
    for dof, y in zip(sv.DOFS, Y.T, strict=True):
        ranking = CRITERIA["ideal_point"](Candidates(X, y), max(COUNTS))
        bias = redundancy_bias(X, ranking)
        cells = [f"{ranking.redundancy[n - 1]:.2f} ({bias[n - 1]:.2f})" for n in COUNTS[1:]]
        rows.append((dof, *cells))
    header = ("dof", *(f"step {n}" for n in COUNTS[1:]))
    job = (
        "Redundancy of the feature that the ideal-point rule selects, of which bias (Miller-Madow)"
    )
    return Findings("Bias", f"{job}, [bits]", header, rows)


def _significance(X: np.ndarray, Y: np.ndarray) -> Findings:
    """How many candidates inform of each dof by the two tests that suit samples and sequences."""
    rows = []
    for null in ("chi_square", "shifts"):
        test = information_test(X, Y, null=null)
        rows.append((null, *map(str, test.significant.sum(axis=0))))
    job = f"Candidates of {X.shape[1]} that inform more than chance, 5 % of the findings wrong"
    return Findings("Significance", job, ("null", *sv.DOFS), rows)


def _draw(errors: Errors) -> Figure:
    """Error against the number of features, a panel a degree of freedom."""
    figure, panels = plt.subplots(2, 3, figsize=(9, 5.4), sharex=True, layout="constrained")
    for dof, ax in zip(sv.DOFS, panels.flat, strict=True):
        for i, criterion in enumerate(CRITERIA):
            ax.plot(
                COUNTS,
                [errors[criterion, dof, n] for n in COUNTS],
                color=GREYS[i % len(GREYS)],
                linestyle=DASHES[i // len(GREYS) % len(DASHES)],
                marker="os^Dvx*"[i % 7],
                markersize=3.5,
                linewidth=1.1,
                label=criterion,
            )
        (reached,) = (error for (name, d, _), error in errors.items() if (name, d) == (ALL, dof))
        ax.axhline(reached, color="0.0", linewidth=0.6, label=ALL)
        ax.set(title=dof, xscale="log", xticks=COUNTS, xticklabels=COUNTS, ylim=(0, None))
        ax.minorticks_off()
    for ax in panels[:, 0]:
        ax.set_ylabel("RMS error [of range]")
    for ax in panels[-1]:
        ax.set_xlabel("number of features")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


if __name__ == "__main__":
    main()
