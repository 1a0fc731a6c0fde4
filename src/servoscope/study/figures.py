"""Which figures a study has, and what stands under each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from servoscope.features.moments import PAPER_SLICES
from servoscope.poses import DOFS
from servoscope.report.figure import Caption, FigureOrder
from servoscope.study import charts
from servoscope.study.agreement import stands_in_for_paper
from servoscope.study.paper import TABLE3
from servoscope.study.results import RunData, Unit

SIGNED = "Pale is positive, dark negative, middle grey zero; each panel has its own scale."

CAPTIONS = {
    "reference": Caption(
        "Reference image",
        "The view that the camera is to return to.",
        "The reference image, in grey.",
    ),
    "errors": Caption(
        "Errors of every family",
        "Each mark is the error of nets that take one family; dashes, where there are any, are "
        "the published errors. Under each degree of freedom stands the error of the best family.",
        "A chart of RMS test errors by degree of freedom, one mark for each family.",
    ),
    "overview": Caption(
        "Overview",
        "The reference image, its slices, and the errors of every family.",
        "The reference image and its slices beside a chart of RMS errors by degree of freedom.",
    ),
    "slices": Caption(
        "Reference image and intensity slices",
        "The pixels of each interval of grey levels, stretched to show their differences; all "
        "others are white. The geometric moments are taken of each slice.",
        "The reference image and the parts of it that fall in three intervals of grey levels.",
        3,
    ),
    "eigenvectors": Caption(
        "First twelve eigenvectors of the training images",
        f"In order of variance. {SIGNED} They are the same for both forms of the displacement.",
        "Twelve signed pictures, from broad patterns to finer ones.",
        4,
    ),
    "pci": Caption(
        "Pose-image covariance vectors",
        f"How each pixel varies with each degree of freedom. {SIGNED}",
        "Six signed pictures, one for each degree of freedom.",
        5,
    ),
    "covariance": Caption(
        "Pose-LFA covariance, from 85 eigenvectors",
        "Covariance of the output of the receptive field at each pixel with each degree of "
        f"freedom. {SIGNED}",
        "Six signed pictures of fine structure, one for each degree of freedom.",
        6,
    ),
    "filtered": Caption(
        "Pose-LFA covariance, filtered, with the chosen locations",
        "Magnitude of the covariance gathered by a centre-weighted mask; bright is much. "
        "Crosses mark the twelve receptive fields chosen for each degree of freedom.",
        "Six grey pictures with twelve crosses each, on their brightest spots.",
        7,
    ),
    "lfa": Caption(
        "First receptive field chosen for each degree of freedom",
        f"Its weight at each pixel. {SIGNED}",
        "Six signed pictures, each with one strong spot.",
        8,
    ),
    "best": Caption(
        "Each degree of freedom against the feature selected first for it",
        "One dot an image. A narrow band means that this feature alone nearly determines the "
        "displacement; a cloud, that it does not.",
        "Six scatter plots of a displacement against a feature.",
        9,
    ),
    "plane": Caption(
        "Selection plane at step 4",
        "Each candidate by its information about the degree of freedom (up) and the sum of its "
        "information about the three features selected before (right). Curves join equal "
        "distances to the ideal point, on the left edge at the height of the best candidate; the "
        "nearest is circled and named. Circles are moments, squares eigenfeatures, triangles PCI.",
        "Six scatter plots of candidates with contours around the ideal point at the top left.",
        10,
    ),
    "redundancy": Caption(
        "How much of the redundancy is bias",
        "Sum of the information of the feature that the ideal-point rule selects at each step "
        "about those selected before it. Dashed, shaded: the bias in it by the number of occupied "
        "cells (Miller-Madow), which is too little where there are few images. Dotted: what as "
        "many unrelated features would show by chance.",
        "Six charts of redundancy against step, which grows nearly in proportion, and two curves "
        "of bias that grow with it.",
    ),
    "criteria": Caption(
        "Criteria side by side",
        "RMS test error of nets against the number of features that each criterion selected; the "
        "level line is the error with all candidates. Same images, same nets for every criterion.",
        "Charts of error against number of features, one for each degree of freedom, with a line "
        "for each criterion.",
    ),
    "sweep": Caption(
        "RMS error against the threshold of mutual information",
        "The number at each marker counts the ranked features whose information is above the "
        "threshold. Left axis: share of the range; right axis: mm or degrees. Solid: test images; "
        "dashed, where there is such a curve: validation images, which decide. Dotted line, where "
        "there is one: the least error published.",
        "Six line charts of error against threshold.",
        11,
    ),
}


def list_figures(run: RunData) -> list[FigureOrder]:
    """All figures of a study; those of a unit are named ``{protocol}_{displacement}_...``."""
    if not run.units:
        return []
    image, first = run.features["reference_image"], run.units[0].results
    published = stands_in_for_paper(run.summary)
    draw: dict[str, Callable[[], Figure]] = {
        "reference": partial(charts.draw_reference, image),
        "slices": partial(charts.draw_slices, image, PAPER_SLICES),
        "errors": partial(charts.draw_family_errors, first, published=published),
        "overview": partial(charts.draw_overview, image, PAPER_SLICES, first, published=published),
    }
    if compared := run.summary.get("criteria"):
        draw["criteria"] = partial(charts.draw_criteria, compared)
    orders = _orders("", draw)
    protocols: set[str] = set()
    for unit in run.units:
        if unit.protocol not in protocols:  # they are the same for every form
            vectors = run.pictures[unit.key]["eigenvectors"]
            eigenvectors = partial(charts.draw_eigenvectors, vectors)
            orders += _orders(f"{unit.key}_", {"eigenvectors": eigenvectors})
        protocols.add(unit.protocol)
        orders += _orders(f"{unit.key}_", _of_unit(run, unit))
    return orders


def _orders(prefix: str, draw: dict[str, Callable[[], Figure]]) -> list[FigureOrder]:
    return [FigureOrder(f"{prefix}{kind}", CAPTIONS[kind], one) for kind, one in draw.items()]


def _of_unit(run: RunData, unit: Unit) -> dict[str, Callable[[], Figure]]:
    shown, results = run.pictures[unit.key], unit.results
    published = {dof: TABLE3[dof]["rms"] for dof in DOFS if stands_in_for_paper(run.summary)}
    draw: dict[str, Callable[[], Figure]] = {
        "pci": partial(charts.draw_signed, shown["pci"], "pci_"),
        "covariance": partial(charts.draw_signed, shown["covariance"]),
        "filtered": partial(charts.draw_locations, shown["filtered"], shown["locations"]),
        "lfa": partial(charts.draw_signed, shown["lfa"]),
        "best": _best_features(run, unit),
        "plane": _planes(run, unit),
        "sweep": partial(
            charts.draw_sweeps,
            results["sweep"],
            results["ranges"],
            published,
            decided_on_test=unit.protocol == "paper",
        ),
    }
    if "redundancy_bias" in results:
        draw["redundancy"] = partial(charts.draw_redundancies, results["redundancy_bias"])
    return draw


def _best_features(run: RunData, unit: Unit) -> Callable[[], Figure]:
    columns = {str(name): i for i, name in enumerate(run.features["names"])}
    first = {dof: unit.results["ranking"][dof][0]["feature"] for dof in DOFS}
    table = run.features[unit.key]
    values = {dof: table[:, columns[name]] for dof, name in first.items()}
    delta_p = run.features[f"delta_p_{unit.displacement}"]
    return partial(charts.draw_best_features, values, first, delta_p)


def _planes(run: RunData, unit: Unit) -> Callable[[], Figure]:
    information = unit.results["mi"]
    names = list(information)
    relevance = {dof: np.array([information[name][dof] for name in names]) for dof in DOFS}
    steps = {dof: run.selection[f"{unit.key}_{dof}"] for dof in DOFS}
    redundancy = {dof: table[min(charts.STEP, len(table)) - 1] for dof, table in steps.items()}
    return partial(charts.draw_selection_planes, relevance, redundancy, names)
