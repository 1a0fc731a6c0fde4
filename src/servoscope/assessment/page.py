"""What an assessment found, as a verdict, the sections of a page and tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from servoscope.assessment.disturbed import TITLES
from servoscope.assessment.verdict import arrives
from servoscope.data.splits import MOST_IMAGES
from servoscope.poses import DOF_LABELS
from servoscope.report.page import Part, Section, Verdict, paragraph
from servoscope.report.table import NONE, Cell, Table
from servoscope.wording import plain_number

if TYPE_CHECKING:
    from servoscope.report.figure import FigureFile

    Figures = Mapping[str, FigureFile]

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


def assessment_verdict(assessed: Row) -> Verdict:
    """Whether the robot will be accurate enough, and what to do next."""
    said, _, step = assessed["conclusion"].rstrip(".").partition("; next: ")
    state = _state(assessed)
    if state != "open":
        answer = "Yes, accurate enough" if state == "yes" else "No, not accurate enough yet"
        advice = (row["advice"][0] for row in assessed["dofs"].values() if row["advice"])
        return Verdict(f"{answer}: {said}.", f"{step or next(advice, 'take more images')}.", state)
    step = "say which errors are allowed: assess again with --tolerance, such as t=1mm,rz=0.2deg"
    return Verdict(f"No tolerance was given. {said}.", f"{step}.")


def _state(assessed: Row) -> Literal["yes", "no", "open"]:
    if not _dofs(assessed):
        return "no"
    met = "met_in_one_look" if assessed["loop"] is None else "met_in_loop"
    asked = [row[met] for row in assessed["dofs"].values() if row["tolerance"] is not None]
    if not asked:
        return "no" if _is_hopeless(assessed) else "open"
    return "yes" if all(asked) else "no"


def _is_hopeless(assessed: Row) -> bool:
    """Whether neither features nor a keyframe read anything."""
    rows = (assessed["dofs"][dof] for dof in _dofs(assessed))
    return assessed["loop"] is None and all(row["observable"] == "not" for row in rows)


def assessment_first(assessed: Row, figures: Figures) -> list[Part]:
    """The first screen of a page: what has to be known before, the decision, its picture."""
    warnings = [paragraph(warning, "warning") for warning in assessed["warnings"]]
    return [*warnings, decision_table(assessed), *_those(figures, "reach")]


def assessment_sections(assessed: Row, figures: Figures) -> list[Section]:
    """Everything else that a page shows of an assessment."""
    behind: list[Part] = [details_table(assessed), *_those(figures, "budgets")]
    families: list[Part] = [families_table(assessed), *_those(figures, "behind")]
    if agreement := describe_agreement(_pairs(assessed)):
        families.append(agreement)
    sections = [
        Section("What limits each degree of freedom, and what would help", behind, "limits"),
        Section("Every family of features, and more images", families, "families"),
    ]
    regressors = [
        _regressors_table(assessed, key, of)
        for key, of in (
            ("regressors", "the features chosen for each degree of freedom"),
            ("regressors_on_moments", "the paper's geometric moments"),
        )
        if assessed[key]
    ]
    if regressors:
        sections.append(Section("Regressors", regressors, "regressors"))
    disturbed = disturbed_table(assessed)
    return [*sections, Section("When images are disturbed", [disturbed], "disturbed")]


def _those(figures: Figures, name: str) -> list[Part]:
    """A figure, if it was drawn."""
    return [figures[name]] if name in figures else []


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
    """What is needed of each dof, what it reaches, and what would help."""
    return Table(
        ["Dof", "Needed", "Loop ends at", "One look", "View allows", "What would help"],
        [_decision(dof, row, assessed["loop"]) for dof, row in assessed["dofs"].items()],
        "",
        "RMS errors on new images. Loop: where the rehearsed closed loop ends. One look: of one "
        "image, by a keyframe of the view or by features, whichever erred less on test images, "
        "with its 90 % interval. View: no estimate from one image errs less (Cramér-Rao bound).",
        align="lrrrrl",
        name="decision-table",
        style="decision",
    )


def details_table(assessed: Row) -> Table:
    """What informs each dof, what limits it, and everything that would help."""
    images = assessed["images"]
    rendered = f" and {images['n_rendered']} rendered ones" if images.get("n_rendered") else ""
    return Table(
        ["Dof", "One look by", "Features, forecast", "Features, measured", "Observable",
         "Limited by",
         "Best features", "What would help"],
        [_details(dof, row) for dof, row in assessed["dofs"].items()],
        "",
        "RMS errors of features, forecast before anything was trained, with its 90 % interval, and "
        "measured on test images. "
        f"{images['n_train'] + images['n_validation']} images{rendered} to learn from, "
        f"{images['n_test']} to test on{_pooled(images)}{_thinned(images)}.",
        align="llrrl",
        name="details-table",
        style="decision wordy",
    )  # fmt: skip


def _thinned(images: Row) -> str:
    """How many images there were, where not all are used."""
    n_given, n_used = images.get("n_given", 0), images.get("n_used", MOST_IMAGES)
    if n_given <= n_used:
        return ""
    return f"; of {n_given} images {n_used} are used, evenly spread in time"


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


def _decision(dof: str, row: Row, loop: Row | None) -> list[str | Cell]:
    is_met = row["met_in_loop"] if loop is not None else row["met_in_one_look"]
    return [
        DOF_LABELS[dof],
        _number(row["tolerance"], row["unit"]),
        _loop_end(row, loop),
        _look(row),
        _number(row["view_limit"], row["unit"]),
        "nothing more needed" if is_met else "".join(row["advice"][:1]) or NONE,
    ]


def _loop_end(row: Row, loop: Row | None) -> Cell:
    if loop is None or row["loop"] is None:
        return Cell(NONE)
    end = _number(row["loop"]["end_rms"], row["unit"])
    if not arrives(loop):
        n_starts = loop["starts"]
        n_arrived = round(loop["success"] * n_starts)
        return Cell(end, mark="missed", below=f"only {n_arrived} of {n_starts} arrive")
    return _met(end, row["met_in_loop"])


def _look(row: Row) -> Cell:
    if row["one_look"] is None:
        return Cell(NONE)
    low, high = map(plain_number, row["one_look"]["interval"])
    met = _met(_number(row["one_look"]["rms"], row["unit"]), row["met_in_one_look"])
    return replace(met, below=f"{low} to {high}" + f", {met.below}" * bool(met.below))


def _details(dof: str, row: Row) -> list[str | Cell]:
    forecast, reached = Cell(NONE), NONE
    if row["forecast_rms"] is not None:
        low, high = map(plain_number, row["interval"])
        forecast = Cell(_number(row["forecast_rms"], row["unit"]), below=f"{low} to {high}")
        reached = _number(row["reached_rms"], row["unit"])
    return [
        DOF_LABELS[dof],
        NONE if row["one_look"] is None else row["one_look"]["by"],
        forecast,
        reached,
        row["observable"],
        row["limited_by"],
        Cell(row.get("family", NONE), below=", ".join(row["best_features"])),
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
