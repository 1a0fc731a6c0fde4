"""Pages of all applications, from numbers made by hand: nothing is computed."""

from types import SimpleNamespace

import numpy as np

from servoscope.assessment.figures import list_figures
from servoscope.assessment.page import assessment_first, assessment_sections, assessment_verdict
from servoscope.poses import DISPLAY_UNITS, DOFS
from servoscope.rehearsal.page import write_rehearsal
from servoscope.report.figure import draw_figures
from servoscope.report.page import write_page
from servoscope.scoreboard.methods import METHODS
from servoscope.scoreboard.page import write_scoreboard

HOSTILE = "<script>alert('x')</script>\"&"
UNITS = dict(zip(DOFS, DISPLAY_UNITS, strict=True))
CONDITIONS = ("range_1.0", "gain_0.8")
LOOP = {"success": 1.0, "starts": 8, "moves": 5.0}


def dof_row(dof, tolerance=0.5, end=0.01):
    """The decision on a dof that the loop reads to `end`, and one look to 0.3."""
    return {
        "forecast_rms": 0.5,
        "interval": [0.4, 0.7],
        "reached_rms": 0.48,
        "unit": UNITS[dof],
        "limited_by": "too few images",
        "best_features": ["theta_150", "pci_tx"],
        "advice": [f"take more images {HOSTILE}"],
        "observable": "well",
        "tolerance": tolerance,
        "one_look": {"rms": 0.3, "interval": [0.2, 0.4], "by": "keyframe"},
        "view_limit": 0.001,
        "loop": {"end_rms": end, "success": 1.0, "moves": 5.0},
        "family": "geometric moments",
        "baseline_rms": 14.0,
        "budget": dict.fromkeys(
            ("noise", "pose_labels", "too_few_images", "regressor", "weak_features"), 0.2
        ),
        "learning_curve": {"n_images": [75, 150, 375, 750], "rms": [0.5, 0.4, 0.3, 0.2]},
        "met_in_one_look": None if tolerance is None else tolerance >= 0.3,
        "met_in_loop": None if tolerance is None else tolerance >= end,
    }


def assessed(said="6 of 6 tolerances met in the loop", step="train a model", loop=LOOP, **of_dof):
    """An assessment as JSON."""
    rows = {dof: dof_row(dof, **of_dof) for dof in DOFS}
    forecasts = {
        dof: {"forecast_rms": 0.5 + k / 10, "reached_rms": 0.48 + k / 10}
        for k, dof in enumerate(DOFS)
    }
    regressor = {"regressor": "kernel_ridge", "rms": dict.fromkeys(DOFS, 0.5)}
    return {
        "dofs": rows,
        "warnings": [f"Few images: {HOSTILE}"],
        "conclusion": f"{said}; next: {step}." if step else f"{said}.",
        "loop": loop,
        "images": {"n_train": 60, "n_validation": 15, "n_test": 25},
        "families": {
            name: {"title": name, "n_features": 24, "dofs": forecasts} for name in ("gm", "pci")
        },
        "regressors": [regressor | {"seconds": 1.0, "coverage_95": 0.95}],
        "regressors_on_moments": [],
        "disturbed": {"clean": dict.fromkeys(DOFS, 0.5)},
    }


def assessment_page(folder):
    said = assessed()
    orders = list_figures(said)
    figures = {file.name: file for file in draw_figures(orders, folder / "figures", n_jobs=1)}
    return write_page(
        folder / "assessment.html",
        f"Assessment: {HOSTILE}",
        assessment_verdict(said),
        assessment_first(said, figures),
        assessment_sections(said, figures),
        kind="assessment",
        lead="How accurate each degree of freedom will be.",
    )


def condition(n_arrived, n_wrong=0):
    start = {"shares": [0.5] * 6, "succeeded": True}
    return {
        "success": n_arrived,
        "trials": 4,
        "success_interval": [0.4, 1.0],
        "final_mm_median": 0.02,
        "final_deg_median": 0.003,
        "moves_median": 4.0,
        "wrongly_converged": n_wrong,
        "status_counts": {"converged": 4},
        "starts": [start, start | {"succeeded": False}],
    }


def rehearsal(**results):
    return {
        "model": f"folder/{HOSTILE}",
        "starts": 4,
        "seed": 0,
        "verdict": "Where it arrives.",
        "ranges": {dof: {"value": 25.0, "unit": UNITS[dof]} for dof in DOFS},
        "results": results or dict.fromkeys(CONDITIONS, condition(4)),
        "timings_s": {"total": 1.0},
    }


def rehearsal_page(folder):
    image = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    return write_rehearsal(folder, rehearsal(), dict.fromkeys(("reference", *CONDITIONS), image))


def target(reached, got=5.0):
    return {
        "scene": "textured_plane",
        "condition": "range_1.0",
        "what": "median moves",
        "wanted": "<= 6",
        "got": got,
        "reached": reached,
    }


def scoreboard(*targets):
    method = condition(4) | {"success": 3}
    by_method = dict.fromkeys(METHODS, method)
    return {
        "seed": 0,
        "starts": 4,
        "image_size": 64,
        "machine": {"cores": 2},
        "timings_s": {"total": 1.0},
        "targets": targets,
        "results": {"textured_plane": dict.fromkeys(CONDITIONS, by_method)},
    }


def scoreboard_page(folder):
    runs = [SimpleNamespace(path_mm=[50.0, 5.0, 0.1])]
    trials = {"textured_plane": dict.fromkeys(CONDITIONS, dict.fromkeys(METHODS, runs))}
    return write_scoreboard(folder, scoreboard(target(True), target(False, 9.0)), trials)


PAGES = {"assessment": assessment_page, "rehearsal": rehearsal_page, "scoreboard": scoreboard_page}
