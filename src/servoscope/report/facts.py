"""What the page shows, as plain values for the template."""

from __future__ import annotations

import base64
import platform
import shlex
from importlib.metadata import version
from pathlib import Path
from typing import Any

from servoscope import __version__
from servoscope.poses import DISPLAY_UNITS, DOFS
from servoscope.report.agreement import compare_with_paper, stands_in_for_paper
from servoscope.report.averages import mean_rms
from servoscope.report.chance import describe_chance
from servoscope.report.criteria import describe_criteria
from servoscope.report.decision import describe_assessment
from servoscope.report.figures.rendering import FigureFile
from servoscope.report.names import DOF_LABELS, DOF_UNITS, FORM_NAMES, PROTOCOL_NAMES
from servoscope.report.reasons import explain_differences
from servoscope.report.run_data import RunData, Unit
from servoscope.report.tables import (
    information_table,
    ranking_table,
    rms_table,
    stability_table,
    subset_table,
)
from servoscope.report.verdict import describe_accuracy

ASSESSMENT_KINDS = ("reach", "budgets", "behind")

FIGURE_KINDS = ("eigenvectors", "pci", "covariance", "filtered", "lfa", "best", "plane", "sweep")


def collect_facts(run: RunData, files: list[FigureFile]) -> dict[str, Any]:
    """Everything the template needs, from a run and its drawn figures."""
    figures = {file.name: describe_figure(file) for file in files}
    name = name_data_set(run.summary["dataset"]["source"])
    return {
        "title": f"{'Study' if run.assessed is None else 'Assessment'}: {name}",
        "data": describe_data(run),
        "assessed": None
        if run.assessed is None
        else describe_assessment(
            run.assessed, [figures[kind] for kind in ASSESSMENT_KINDS if kind in figures]
        ),
        "study_left_out": run.summary.get("study_left_out"),
        **(describe_study(run, figures) if run.units else {"first": None}),
        "timings": describe_timings(run.summary["timings_s"]),
        "settings": flatten(run.settings),
        "source": flatten(run.summary["dataset"]["source"]),
        "versions": describe_versions(run),
        "command": describe_command(run.settings),
        "dofs": [DOF_LABELS[dof] for dof in DOFS],
        "dof_units": [DOF_UNITS[dof] for dof in DOFS],
    }


def describe_study(run: RunData, figures: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """What the paper's study found."""
    units = [describe_unit(unit, figures) for unit in run.units]
    return {
        "verdict": describe_accuracy(run.units[0]),
        "reference": figures["reference"],
        "slices": figures["slices"],
        "errors": figures["errors"],
        "first": units[0],
        "units": units,
        "stands_in_for_paper": stands_in_for_paper(run.summary),
        "findings": compare_with_paper(run.summary),
        "criteria": describe_criteria(run.summary.get("criteria")),
        "criteria_figure": figures.get("criteria"),
        "reasons": explain_differences(run.summary),
    }


def name_data_set(source: dict[str, Any]) -> str:
    """What the images are of, or the folder that they came from.

    Examples
    --------
    >>> name_data_set({"format": "tum", "folder": "/data/desk"})
    'desk'
    """
    folder = Path(str(source.get("folder", ""))).name
    return str(source.get("kind") or folder or "a data set")


def describe_figure(file: FigureFile) -> dict[str, Any]:
    """A figure with its pixels in the page itself."""
    data = base64.b64encode(file.png).decode("ascii")
    return {
        "uri": f"data:image/png;base64,{data}",
        "width": file.width,
        "height": file.height,
        "caption": file.caption,
    }


def describe_unit(unit: Unit, figures: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The tables and figures of one protocol and displacement form."""
    names = [f"{unit.key}_{kind}" for kind in FIGURE_KINDS]
    return {
        "key": unit.key.replace("_", "-"),
        "protocol": unit.protocol,
        "displacement": unit.displacement,
        "title": f"{PROTOCOL_NAMES[unit.protocol]}, displacement {FORM_NAMES[unit.displacement]}",
        "ranges": [unit.results["ranges"][dof] for dof in DOFS],
        "n_images": unit.results["n_images"],
        "null_level": unit.results["mi_null_level"],
        "table1": rms_table(unit.results),
        "table2": ranking_table(unit.results),
        "table3": subset_table(unit.results),
        "mean_selected": mean_rms(unit.results, unit.results["table3"]),
        "mi": information_table(unit.results),
        "chance": describe_chance(unit.results),
        "redundancy_figure": figures.get(f"{unit.key}_redundancy"),
        "stability": stability_table(unit.results),
        "figures": [figures[name] for name in names if name in figures],
    }


def describe_data(run: RunData) -> dict[str, Any]:
    """What was studied."""
    dataset = run.summary["dataset"]
    height, width = dataset["image_shape"]
    return {
        "n_images": dataset["n_images"],
        "size": f"{width} × {height} px",
        "pivot_mm": dataset["pivot_mm"],
        "split": "by blocks of time" if dataset["split"] == "blocks" else "at random",
        "n_bins": run.settings.get("n_bins"),
    }


def describe_timings(timings: dict[str, float]) -> list[tuple[str, float]]:
    """Stages with their seconds, the total last."""
    stages = [(name.replace("_", " "), float(s)) for name, s in timings.items() if name != "total"]
    return [*stages, ("total", float(timings["total"]))]


def describe_versions(run: RunData) -> list[tuple[str, str]]:
    """What wrote the run, and what wrote the page."""
    packages = ("numpy", "scipy", "scikit-learn", "matplotlib")
    return [
        ("servoscope, the run", str(run.summary.get("servoscope", "unknown"))),
        ("servoscope, this page", __version__),
        ("Python", platform.python_version()),
        *((package, version(package)) for package in packages),
    ]


def describe_command(settings: dict[str, Any]) -> str | None:
    """The command line that makes the run again, if a command made it."""
    options: dict[str, Any] = {"seed": settings.get("seed", 0)}
    acquisition = settings.get("acquisition", {})
    if settings.get("command") == "study":
        words = ["servoscope", "study"]
        options |= {f"n-{k}" if k == "images" else k: v for k, v in _images(acquisition).items()}
    elif settings.get("command") == "assess":
        words = ["servoscope", "assess", str(settings.get("dataset"))]
        options |= _asked(settings)
    else:
        return None
    protocols = settings.get("protocols", [])
    options["protocol"] = protocols[0] if len(protocols) == 1 else "both"
    for option, value in options.items():
        words += [f"--{option}", str(value)]
    if settings.get("study"):
        words.append("--study")
    return shlex.join(words)


def flatten(values: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested settings as rows of a table.

    Examples
    --------
    >>> flatten({"seed": 0, "camera": {"width": 64}})
    [('seed', '0'), ('camera.width', '64')]
    """
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, dict):
            rows += flatten(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            rows.append((f"{prefix}{key}", ", ".join(map(str, value))))
        else:
            rows.append((f"{prefix}{key}", str(value)))
    return rows


def _asked(settings: dict[str, Any]) -> dict[str, str]:
    """What an assessment was asked for besides its data set."""
    options = {}
    for option in ("tolerance", "pose_error"):
        if settings.get(option):
            options[option.replace("_", "-")] = ",".join(
                f"{dof}={value:g}{DISPLAY_UNITS[DOFS.index(dof)]}"
                for dof, value in settings[option].items()
            )
    if settings.get("families"):
        options["families"] = ",".join(settings["families"])
    if settings.get("regressor", "gaussian_process") != "gaussian_process":
        options["regressor"] = settings["regressor"]
    return options


def _images(acquisition: dict[str, Any]) -> dict[str, Any]:
    return {"images": acquisition.get("n_images"), "image-size": acquisition.get("image_size")}
