"""What an assessment found, as a section of a page and as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from servoscope.assessment.disturbed import TITLES
from servoscope.poses import DOF_LABELS
from servoscope.report.page import Part, Section, heading, paragraph
from servoscope.report.table import NONE, Cell, Table
from servoscope.wording import plain_number

if TYPE_CHECKING:
    from servoscope.report.figure import FigureFile

REGRESSORS = {
    "gaussian_process": "Gaussian process (default)",
    "kernel_ridge": "kernel ridge",
    "levenberg_marquardt": "the paper's nets",
    "bayesian_lm": "nets, Bayesian weight decay",
    "lbfgs": "nets by L-BFGS",
}
"""The regressors in words."""

FEWEST = 12
"""So few forecasts say nothing of how well they agree."""

Row = dict[str, Any]


def assessment_section(assessed: Row, figures: list[FigureFile]) -> Section:
    """Everything that a page shows of an assessment."""
    parts: list[Part] = [paragraph(assessed["conclusion"], "conclusion")]
    parts += [paragraph(warning, "warning") for warning in assessed["warnings"]]
    parts += [decision_table(assessed), *figures]
    parts += [heading("Every family of features"), families_table(assessed)]
    if agreement := describe_agreement(_pairs(assessed)):
        parts.append(agreement)
    if assessed["regressors"]:
        of = "the features chosen for each degree of freedom"
        parts += [heading("Regressors"), _regressors_table(assessed, "regressors", of)]
    if assessed["regressors_on_moments"]:
        of = "the paper's geometric moments"
        parts.append(_regressors_table(assessed, "regressors_on_moments", of))
    parts += [heading("When images are disturbed"), disturbed_table(assessed)]
    return Section("What each degree of freedom will reach", parts, "decision")


def reach_cells(row: Row) -> tuple[str, str, str, str]:
    """Tolerance, one look, end of the loop, and the limit of the view; a dash for none."""
    unit, look, loop = row["unit"], row["one_look"], row["loop"]
    reads = NONE
    if look is not None:
        low, high = map(plain_number, look["interval"])
        reads = f"{plain_number(look['rms'])} {unit} by {look['by']}\n({low} to {high})"
    return (
        _number(row["tolerance"], unit),
        reads,
        _number(None if loop is None else loop["end_rms"], unit),
        _number(row["view_limit"], unit),
    )


def reach_table(assessed: Row) -> Table:
    """What each dof reaches and what the view allows, for a terminal."""
    return Table(
        [
            "dof",
            "tolerance",
            "one look (90 %)",
            "loop ends at",
            "view allows",
            "features limited by",
        ],
        [[dof, *reach_cells(row), row["limited_by"]] for dof, row in assessed["dofs"].items()],
        "RMS error of each degree of freedom",
        align="l",
    )


def decision_table(assessed: Row) -> Table:
    """Everything that is decided on a dof, in a row."""
    images = assessed["images"]
    rendered = f" and {images['n_rendered']} rendered ones" if images.get("n_rendered") else ""
    return Table(
        ["Dof", "Tolerance", "One look", "Loop ends at", "View allows", "Features, forecast",
         "Features, measured", "Observable", "Limited by", "Best features", "What would help"],
        [_decision(dof, row) for dof, row in assessed["dofs"].items()],
        "",
        "RMS errors on new images. One look: of one image, by a keyframe of the view or by "
        "features, whichever erred less on test images, with its 90 % interval. Loop: where the "
        "rehearsed closed loop ends. View: what no estimate from one image goes below (Cramér-Rao "
        "bound of the grey levels at the reference). Features: forecast before anything was "
        "trained, with its 90 % interval, and measured on test images. "
        f"{images['n_train'] + images['n_validation']} images{rendered} to learn from, "
        f"{images['n_test']} to test on{_pooled(images)}.",
        align="lrrrrrrl",
        name="decision-table",
        style="decision",
    )  # fmt: skip


def _pooled(images: Row) -> str:
    """In how many splits features were measured, in words."""
    if images.get("n_splits", 1) == 1:
        return ""
    return (
        f"; features are measured on {images['n_tested']}, of {images['n_tested_groups']} "
        f"independent groups, in {images['n_splits']} splits of the images"
    )


def families_table(assessed: Row) -> Table:
    """Forecast error of every family, and what the chosen ones reached."""
    dofs, families = _dofs(assessed), assessed["families"].values()
    least = {dof: min(family["dofs"][dof]["forecast_rms"] for family in families) for dof in dofs}

    def cell(row: Row, is_least: bool) -> Cell:
        forecast, reached = row["forecast_rms"], row["reached_rms"]
        below = NONE if reached is None else f"{reached:.2g}"
        return Cell(f"{forecast:.2g}", forecast, "best" * is_least, below=below)

    return Table(
        ["Features", "Number", *_heads(assessed)],
        [
            [
                family["title"],
                Cell(str(family["n_features"]), family["n_features"]),
                *(
                    cell(family["dofs"][dof], family["dofs"][dof]["forecast_rms"] == least[dof])
                    for dof in dofs
                ),
            ]
            for family in families
        ],
        "",
        "Forecast (upper) RMS error of every family, and what the chosen ones reached (lower); the "
        "least forecast of each degree of freedom is bold. Features that are fitted to images are "
        "fitted anew for each fold of their forecast.",
        name="families-table",
        style="sortable",
    )


def disturbed_table(assessed: Row) -> Table:
    """Errors when test images are disturbed."""
    return Table(
        ["Disturbance", *_heads(assessed)],
        [
            [TITLES.get(name, name), *(f"{errors[dof]:.2g}" for dof in _dofs(assessed))]
            for name, errors in assessed["disturbed"].items()
        ],
        "",
        "RMS test error of the same models, not trained anew, when test images are disturbed.",
        name="disturbed-table",
    )


def describe_agreement(pairs: NDArray[np.float64]) -> str:
    """How far forecasts agree with what was reached; nothing where there are few.

    Parameters
    ----------
    pairs : ndarray of shape (n_forecasts, 2)
        Forecast and reached errors, in the same unit for all dofs.
    """
    if len(pairs) < FEWEST or not (pairs > 0).all():
        return ""
    ratio = pairs[:, 0] / pairs[:, 1]
    within = np.mean((ratio >= 0.75) & (ratio <= 1.33))
    return (
        f"Of {len(pairs)} forecasts, {100 * within:.0f} % lie within 0.75 and 1.33 of what was "
        f"reached; the median ratio is {np.median(ratio):.2f}, the rank correlation "
        f"{spearmanr(*pairs.T).statistic:.2f}."
    )


def _dofs(assessed: Row) -> list[str]:
    """The dofs that have a forecast."""
    return [dof for dof, row in assessed["dofs"].items() if row["forecast_rms"] is not None]


def _heads(assessed: Row) -> list[str]:
    return [f"{DOF_LABELS[dof]} [{assessed['dofs'][dof]['unit']}]" for dof in _dofs(assessed)]


def _number(value: float | None, unit: str) -> str:
    return NONE if value is None else f"{plain_number(value)} {unit}"


def _met(text: str, met: bool | None) -> Cell:
    if met is None:
        return Cell(text)
    return Cell(text, below="met") if met else Cell(text, mark="missed", below="missed")


def _decision(dof: str, row: Row) -> list[str | Cell]:
    tolerance, look, loop, limit = reach_cells(row)
    forecast = Cell(NONE)
    if row["forecast_rms"] is not None:
        low, high = map(plain_number, row["interval"])
        forecast = Cell(_number(row["forecast_rms"], row["unit"]), below=f"{low} to {high}")
    features = Cell(row.get("family", NONE), below=", ".join(row["best_features"]))
    return [
        DOF_LABELS[dof],
        tolerance,
        _met(look, row["met_in_one_look"]),
        _met(loop, row["met_in_loop"]),
        limit,
        forecast,
        NONE if row["forecast_rms"] is None else _number(row["reached_rms"], row["unit"]),
        row["observable"],
        row["limited_by"],
        features,
        "\n".join(row["advice"]),
    ]


def _regressors_table(assessed: Row, key: str, features: str) -> Table:
    dofs = _dofs(assessed)
    return Table(
        ["Regressor", *_heads(assessed), "Seconds", "In 95 %"],
        [
            [
                REGRESSORS.get(row["regressor"], row["regressor"]),
                *(Cell(f"{row['rms'][dof]:.2g}", row["rms"][dof]) for dof in dofs),
                Cell(f"{row['seconds']:.1f}", row["seconds"]),
                Cell(f"{100 * row['coverage_95']:.0f} %", row["coverage_95"]),
            ]
            for row in assessed[key]
        ],
        "",
        f"RMS test error of regressors on {features}, processor seconds to train all degrees of "
        "freedom, and the share of the test images that lies within the 95 % interval that each "
        "predicts.",
        name=f"{key.replace('_', '-')}-table",
        style="sortable",
    )


def _pairs(assessed: Row) -> NDArray[np.float64]:
    """Forecast and reached errors of all candidates, of those of predicting the mean."""
    return np.array(
        [
            [
                family["dofs"][dof][key] / (assessed["dofs"][dof]["baseline_rms"] or 1.0)
                for key in ("forecast_rms", "reached_rms")
            ]
            for family in assessed["families"].values()
            for dof in _dofs(assessed)
            if family["dofs"][dof]["reached_rms"] is not None
        ]
    ).reshape(-1, 2)
