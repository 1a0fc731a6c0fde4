"""Which figures a run has, and what stands under each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from servoscope.features.moments import PAPER_SLICES
from servoscope.poses import DOFS
from servoscope.report.agreement import stands_in_for_paper
from servoscope.report.figures import (
    assessment,
    criteria,
    overview,
    pictures,
    redundancy,
    selection,
    sweep,
)
from servoscope.report.figures.captions import CAPTIONS
from servoscope.report.figures.rendering import FigureOrder
from servoscope.report.run_data import RunData, Unit
from servoscope.study.paper import TABLE3


def list_figures(run: RunData) -> list[FigureOrder]:
    """All figures of a run; those of a unit are named ``{protocol}_{displacement}_...``."""
    return [*_of_assessment(run), *(_of_study(run) if run.units else [])]


def _of_assessment(run: RunData) -> list[FigureOrder]:
    if run.assessed is None:
        return []
    rows, families = run.assessed["dofs"], run.assessed["families"]
    if not assessment.moving(rows):
        return []
    draw: dict[str, Callable[[], Figure]] = {
        "reach": partial(assessment.draw_reach, rows),
        "budgets": partial(assessment.draw_budgets, rows),
        "behind": partial(assessment.draw_behind, families, rows),
    }
    return [FigureOrder(kind, CAPTIONS[kind], drawing) for kind, drawing in draw.items()]


def _of_study(run: RunData) -> list[FigureOrder]:
    image = run.features["reference_image"]
    first = run.units[0].results
    slices = partial(pictures.draw_slices, image, PAPER_SLICES)
    published = stands_in_for_paper(run.summary)
    errors = partial(overview.draw_family_errors, first, published=published)
    summary = partial(overview.draw_overview, image, PAPER_SLICES, first, published=published)
    orders = [
        FigureOrder("reference", CAPTIONS["reference"], partial(pictures.draw_reference, image)),
        FigureOrder("slices", CAPTIONS["slices"], slices),
        FigureOrder("errors", CAPTIONS["errors"], errors),
        FigureOrder("overview", CAPTIONS["overview"], summary),
    ]
    if compared := run.summary.get("criteria"):
        draw_criteria = partial(criteria.draw_criteria, compared)
        orders.append(FigureOrder("criteria", CAPTIONS["criteria"], draw_criteria))
    protocols: set[str] = set()
    for unit in run.units:
        if unit.protocol not in protocols:
            orders.append(_eigenvectors(run, unit))
        protocols.add(unit.protocol)
        orders += _of_unit(run, unit)
    return orders


def _of_unit(run: RunData, unit: Unit) -> list[FigureOrder]:
    shown = run.pictures[unit.key]
    draw: dict[str, Callable[[], Figure]] = {
        "pci": partial(pictures.draw_signed, shown["pci"], "pci_"),
        "covariance": partial(pictures.draw_signed, shown["covariance"]),
        "filtered": partial(pictures.draw_locations, shown["filtered"], shown["locations"]),
        "lfa": partial(pictures.draw_signed, shown["lfa"]),
        "best": _best_features(run, unit),
        "plane": _planes(run, unit),
        "sweep": partial(
            sweep.draw_sweeps,
            unit.results["sweep"],
            unit.results["ranges"],
            {dof: float(TABLE3[dof]["rms"]) for dof in DOFS if stands_in_for_paper(run.summary)},
            decided_on_test=unit.protocol == "paper",
        ),
    }
    if "redundancy_bias" in unit.results:
        by_dof = unit.results["redundancy_bias"]
        draw["redundancy"] = partial(redundancy.draw_redundancies, by_dof)
    return [
        FigureOrder(f"{unit.key}_{kind}", CAPTIONS[kind], drawing) for kind, drawing in draw.items()
    ]


def _eigenvectors(run: RunData, unit: Unit) -> FigureOrder:
    """The eigenvectors of a protocol, which are the same for every form."""
    draw = partial(pictures.draw_eigenvectors, run.pictures[unit.key]["eigenvectors"])
    return FigureOrder(f"{unit.key}_eigenvectors", CAPTIONS["eigenvectors"], draw)


def _best_features(run: RunData, unit: Unit) -> Callable[[], Figure]:
    columns = {str(name): i for i, name in enumerate(run.features["names"])}
    first = {dof: unit.results["ranking"][dof][0]["feature"] for dof in DOFS}
    table = run.features[unit.key]
    values = {dof: table[:, columns[name]] for dof, name in first.items()}
    delta_p = run.features[f"delta_p_{unit.displacement}"]
    return partial(selection.draw_best_features, values, first, delta_p)


def _planes(run: RunData, unit: Unit) -> Callable[[], Figure]:
    information = unit.results["mi"]
    names = list(information)
    relevance = {dof: np.array([information[name][dof] for name in names]) for dof in DOFS}
    steps = {dof: run.selection[f"{unit.key}_{dof}"] for dof in DOFS}
    redundancy = {dof: table[min(selection.STEP, len(table)) - 1] for dof, table in steps.items()}
    return partial(selection.draw_selection_planes, relevance, redundancy, names)
