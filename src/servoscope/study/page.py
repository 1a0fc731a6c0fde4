"""The report of a run, and what it says: one HTML file, written from the run folder alone."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from servoscope import __version__
from servoscope.assessment.figures import list_figures as assessment_figures
from servoscope.assessment.page import (
    assessment_first,
    assessment_sections,
    assessment_verdict,
    describe_agreement,
)
from servoscope.poses import DISPLAY_UNITS, DOF_LABELS, DOFS
from servoscope.report.figure import FigureFile, draw_figures
from servoscope.report.page import (
    Part,
    Section,
    Verdict,
    bullets,
    heading,
    pairs,
    paragraph,
    write_page,
)
from servoscope.report.table import Cell, Table, write_tables
from servoscope.study.agreement import (
    Finding,
    compare_with_paper,
    explain_differences,
    stands_in_for_paper,
)
from servoscope.study.figures import list_figures
from servoscope.study.paper import FAMILIES
from servoscope.study.results import RunData, Unit, mean_rms, moving_dofs, read_run
from servoscope.study.tables import (
    CRITERIA,
    PARTS,
    SHOWN,
    criteria_table,
    errors_table,
    has_chance,
    steps_of,
    study_tables,
)
from servoscope.wording import listing

WELL, ROUGHLY = 0.25, 0.6
"""Shares of the baseline error below which a degree of freedom is observable well, or roughly."""

SENTENCES = {
    "well": "{} observable well from one image",
    "roughly": "{} observable roughly",
    "hardly": "{} hardly observable",
    "not": "{} not observable: the mean does as well",
    "still": "{} never moved",
}


def describe_accuracy(unit: Unit) -> list[str]:
    """Sentences on what the best family and the selected features reach."""
    results = unit.results
    errors = results["table1"][results["best_family"]]
    grades: dict[str, list[str]] = {grade: [] for grade in SENTENCES}
    for dof in DOFS:
        grades[_grade(errors[dof], results["baseline"][dof])].append(dof)
    parts = [
        SENTENCES[grade].format(_subject(dofs, errors, grade))
        for grade, dofs in grades.items()
        if dofs
    ]
    text = "; ".join(parts)
    return [f"{text[0].upper()}{text[1:]}.", _best_family(unit), _meaning(unit)]


def _grade(error: dict[str, Any], baseline: dict[str, Any]) -> str:
    if baseline["rms"] <= 1e-9:
        return "still"
    share = error["rms"] / baseline["rms"]
    if share >= 1.0:
        return "not"
    return "well" if share <= WELL else "roughly" if share <= ROUGHLY else "hardly"


def _subject(dofs: list[str], errors: dict[str, Any], grade: str) -> str:
    if grade == "still":
        return listing([DOF_LABELS[dof] for dof in dofs])
    subjects = [
        DOF_LABELS[dof]
        + f" (to {errors[dof]['physical']:.2g} {errors[dof]['unit']})" * (grade != "not")
        for dof in dofs
    ]
    return f"{listing(subjects)} {'is' if len(dofs) == 1 else 'are'}"


def _best_family(unit: Unit) -> str:
    results, best = unit.results, unit.results["best_family"]
    mean, selected, baseline = (
        mean_rms(results, row)
        for row in (results["table1"][best], results["table3"], results["baseline"])
    )
    n_images = results["n_images"]
    decide = (
        f"the {n_images['validation']} images that decide"
        if unit.protocol == "honest"
        else f"the {n_images['test']} test images themselves"
    )
    return (
        f"These are the errors of {FAMILIES[best].title}, the family chosen because it erred least "
        f"on {decide}, on average {mean:.3f} of the range; the subsets selected by mutual "
        f"information reach {selected:.3f}, and always predicting the mean {baseline:.3f}."
    )


def _meaning(unit: Unit) -> str:
    if unit.protocol == "honest":
        return "Errors are of test images that had no part in training or in any decision."
    return "Errors are of test images that also decided when training stops, as published."


PUBLISHED_REDUNDANCY = (
    "The paper gives 0.4 bits, for the PCI vector of Tz at step 8 for Rx. Seven unrelated features "
    "would show 7 × 0.058 = 0.41 bits by chance alone, with its 1000 images and 10 bins."
)


def describe_chance(results: dict[str, Any]) -> str:
    """How much of the redundancy is bias, on the average of the dofs that move."""
    steps, dofs = steps_of(results), moving_dofs(results)
    sentences = []
    for step in steps:
        at_step = [results["redundancy_bias"][dof][step - 1] for dof in dofs]
        redundancy, bias, unrelated = (
            float(np.mean([of_dof[part] for of_dof in at_step])) for part in PARTS
        )
        share = f" ({100 * bias / redundancy:.0f} %)" if redundancy > 0 else ""
        sentences.append(
            f"At step {step} the selected feature shares {redundancy:.2f} bits with those before "
            f"it, on the average of the degrees of freedom, of which {bias:.2f} are bias{share}; "
            f"unrelated features would show {unrelated:.2f}."
        )
    return " ".join([*sentences, *[PUBLISHED_REDUNDANCY] * (8 in steps)])


def describe_criteria(compared: dict[str, Any]) -> str:
    """Which criterion of selection errs least."""
    place = compared["sizes"].index(SHOWN)
    means = {
        name: float(np.mean(list(by_dof.values()), axis=0)[place])
        for name, by_dof in compared["errors"].items()
    }
    best = min(means, key=means.__getitem__)
    published = (
        ""
        if best == "ideal_point" or "ideal_point" not in means
        else f", against {means['ideal_point']:.3f} by the published ideal-point rule"
    )
    everything = np.mean(list(compared["all_candidates"].values()))
    return (
        f"With {SHOWN} features the error is least when they are selected by "
        f"{CRITERIA.get(best, best)}: {means[best]:.3f} of the range on the average of the "
        f"degrees of freedom{published}. All candidates together reach {everything:.3f}."
    )


def describe_forecasts(forecasts: list[dict[str, Any]]) -> str:
    """How far the forecasts agree with the nets; nothing where there are few."""
    pairs = np.array([(pair["forecast"], pair["reached"]) for pair in forecasts]).reshape(-1, 2)
    agreement = describe_agreement(pairs)
    return agreement and (
        "Errors were also forecast, before training, for the nets of moments, eigenfeatures, "
        f"pose-image covariance and the minimum subsets of Table III. {agreement}"
    )


FIGURE_KINDS = ("eigenvectors", "pci", "covariance", "filtered", "lfa", "best", "plane", "sweep")

VERDICTS = {"yes": Cell("yes", mark="best"), "no": Cell("no", mark="missed")}

Figures = Mapping[str, FigureFile]


def write_report(run: Path, *, n_jobs: int = -1, svg: bool = False) -> Path:
    """Write ``report.html``, ``tables.tex`` and ``figures/`` into a run folder.

    Parameters
    ----------
    run : Path
        A finished run folder.
    svg : bool
        Write each figure as SVG as well.

    Returns
    -------
    Path
        The report: one file that needs neither a network nor the rest of the folder.

    Raises
    ------
    RunFolderError
        If it is not a run folder, not finished, damaged, or was written by another version.
    """
    run = Path(run)
    data = read_run(run)
    orders = assessment_figures(data.assessed) if data.assessed else []
    orders += list_figures(data)
    files = draw_figures(orders, run / "figures", n_jobs=n_jobs, svg=svg)
    n_bins = data.settings.get("n_bins")
    tables = [table for unit in data.units for table in study_tables(unit, n_bins)]
    if tables:
        write_tables(run / "tables.tex", tables)
    return write_run_page(run / "report.html", data, files)


def write_run_page(path: Path, run: RunData, files: list[FigureFile]) -> Path:
    """Write the page of a run whose figures are drawn."""
    figures = {file.name: file for file in files}
    name = name_data_set(run.summary["dataset"]["source"])
    height, width = run.summary["dataset"]["image_shape"]
    n_images = f"{run.summary['dataset']['n_images']} images of {width} × {height} px"
    if run.assessed is not None:
        kind, verdict = "assessment", assessment_verdict(run.assessed)
        first = assessment_first(run.assessed, figures)
        sections = assessment_sections(run.assessed, figures)
        lead = (
            "How accurately each degree of freedom of the camera can be read from an image, what "
            f"limits it, and what would help: {n_images} at known displacements."
        )
    else:
        kind, verdict = "study", _study_verdict(run)
        first = [errors_table(run.units[0], "result"), figures["reference"]]
        sections = []
        lead = (
            "Which image features inform how far a camera is from its reference view, and how "
            f"accurately: {n_images} at known displacements, four families of features, one small "
            "net for each degree of freedom."
        )
    sections += _study_sections(run, figures) if run.units else []
    left_out = None if run.units else run.summary.get("study_left_out")
    sections.append(_making(run, left_out))
    title = f"{kind.capitalize()}: {name}"
    return write_page(path, title, verdict, first, sections, kind=kind, lead=lead)


def _study_verdict(run: RunData) -> Verdict:
    accuracy, *_ = describe_accuracy(run.units[0])
    step = "assess images of your own robot and view: servoscope assess FOLDER."
    return Verdict(accuracy, step)


def _study_sections(run: RunData, figures: Figures) -> list[Section]:
    findings = compare_with_paper(run.summary)
    sections = [_result(run, figures, findings), _agreement(run, findings)]
    if compared := run.summary.get("criteria"):
        parts: list[Part] = [
            f"{describe_criteria(compared)} Honest protocol, displacement about the pivot.",
            criteria_table(compared),
            figures["criteria"],
        ]
        if forecasts := describe_forecasts(compared["forecasts"]):
            parts.append(forecasts)
        sections.append(Section("Criteria of selection side by side", parts, "criteria"))
    sections.append(Section("The images", [figures["slices"]], "images"))
    main, *others = (_unit_section(run, unit, figures) for unit in run.units)
    return [*sections, main, *(replace(other, is_appendix=True) for other in others)]


def _result(run: RunData, figures: Figures, findings: list[Finding]) -> Section:
    unit = run.units[0]
    verdicts = [finding.verdict for finding in findings]
    published = (
        "of a real cylinder head under the same poses."
        if stands_in_for_paper(run.summary)
        else "of other images and give a scale only."
    )
    hold = Markup(
        '<p class="quiet">{}. The published numbers are {} {} of {} statements of the paper hold '
        'here, {} hold in part: <a href="#agreement">what agrees with the paper</a>.</p>'
    ).format(unit.title, published, verdicts.count("yes"), len(verdicts), verdicts.count("partly"))
    said: list[Part] = [*describe_accuracy(unit), hold]
    if run.assessed is None:  # the table and the picture are on the first screen
        return Section("The result", [*said, figures["errors"]], "result")
    parts = [*said, figures["reference"], errors_table(unit, "result"), figures["errors"]]
    return Section("The paper's study", parts, "result")


def _agreement(run: RunData, findings: list[Finding]) -> Section:
    intro = (
        "Statements of Wells and Torras, Assessing Image Features for Vision-Based Robot "
        "Positioning (2001), against the numbers of this run."
    )
    if not stands_in_for_paper(run.summary):
        intro += (
            " The images are not those of the paper's scene: only its general statements are "
            "compared."
        )
    table = Table(
        ["The paper says", "Here", "Numbers"],
        [
            [
                finding.claim,
                VERDICTS.get(finding.verdict, Cell(finding.verdict, mark="partly")),
                "\n".join(finding.evidence),
            ]
            for finding in findings
        ],
        "",
        "Each statement, and whether this run bears it out.",
        align="l",
        style="findings",
    )
    reasons = bullets(explain_differences(run.summary))
    parts: list[Part] = [intro, table, heading("Why they may differ"), reasons]
    return Section("What agrees with the paper and what does not", parts, "agreement")


def _unit_section(run: RunData, unit: Unit, figures: Figures) -> Section:
    errors, ranking, subsets, information, *others = study_tables(unit, run.settings.get("n_bins"))
    names = [f"{unit.key}_{kind}" for kind in FIGURE_KINDS]
    parts: list[Part] = [_protocol(run, unit)]
    parts += [heading("Errors by family"), errors, heading("Selected features"), ranking]
    parts += [heading("Minimum subsets"), subsets, heading("Figures")]
    parts += [figures[name] for name in names if name in figures]
    parts += [heading("Mutual information"), information]
    if has_chance(unit.results):
        parts += [heading("Chance in the redundancy"), describe_chance(unit.results)]
        parts += [others[0], figures[f"{unit.key}_redundancy"]]
    return Section(unit.title, [*parts, heading("Numbers of bins"), others[-1]], unit.name)


def _protocol(run: RunData, unit: Unit) -> str:
    n, dataset = unit.results["n_images"], run.summary["dataset"]
    if unit.protocol == "honest":
        said = (
            f"{n['train']} images train, {n['validation']} decide when training stops and which "
            f"subset is best, and {n['test']} test; nothing is fitted to or decided on the test "
            "images."
        )
    else:
        said = (
            f"As published: {n['train']} images train; {n['test']} others both decide and test, so "
            "that the errors are flattered."
        )
    split = "by blocks of time" if dataset["split"] == "blocks" else "at random"
    about = (
        f"about a point {dataset['pivot_mm']:.0f} mm ahead on the optical axis"
        if unit.displacement == "pivot"
        else "about the camera, so that rotating about the pivot also moves it sideways"
    )
    ranges = ", ".join(
        f"{DOF_LABELS[dof]} none (it never moves)"
        if of["value"] is None
        else f"{DOF_LABELS[dof]} ±{of['value']:.4g} {of['unit']}"
        for dof, of in ((dof, unit.results["ranges"][dof]) for dof in DOFS)
    )
    return (
        f"{said} Images are split {split}. Displacements are taken {about}; the ranges that errors "
        f"are divided by are {ranges}."
    )


def _making(run: RunData, left_out: str | None) -> Section:
    parts: list[Part] = []
    if left_out is not None:
        said = f"The study of Wells and Torras (2001) is left out. {left_out}"
        parts.append(paragraph(said, "quiet"))
    if command := describe_command(run.settings):
        code = Markup("<pre><code>{}</code></pre>").format(command)
        parts += ["To make the run again:", code]
    packages = ("numpy", "scipy", "scikit-learn", "matplotlib")
    versions = {
        "servoscope, the run": run.summary.get("servoscope", "unknown"),
        "servoscope, this page": __version__,
        "Python": platform.python_version(),
        **{package: version(package) for package in packages},
    }
    timings = {name.replace("_", " "): float(s) for name, s in run.summary["timings_s"].items()}
    timings["total"] = timings.pop("total")
    tables = {
        "Time by stage [s]": timings.items(),
        "Settings": flatten(run.settings),
        "Data set": flatten(run.summary["dataset"]["source"]),
        "Versions": versions.items(),
    }
    return Section("How it was made", [*parts, pairs(tables)], "making")


def name_data_set(source: dict[str, Any]) -> str:
    """What the images are of, or the folder that they came from.

    Examples
    --------
    >>> name_data_set({"format": "tum", "folder": "/data/desk"})
    'desk'
    """
    folder = Path(str(source.get("folder", ""))).name
    return str(source.get("kind") or folder or "a data set")


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
