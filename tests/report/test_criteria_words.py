import json

import numpy as np
import pytest

from servoscope.errors import RunFolderError
from servoscope.files import write_json
from servoscope.report import read_run, write_report
from servoscope.report.criteria import describe_agreement, describe_criteria
from servoscope.report.figures.criteria import draw_criteria, plot_criteria
from servoscope.report.names import CRITERION_NAMES
from servoscope.selection import CRITERIA


def test_every_criterion_has_a_name_and_a_row(compared):
    rows = describe_criteria(compared)["rows"]
    assert [row["title"] for row in rows] == [CRITERION_NAMES[name] for name in CRITERIA]


def test_the_least_of_each_column_is_marked(compared):
    compared["errors"]["mrmr"]["ty"][1] = 0.001
    rows = describe_criteria(compared)["rows"]
    best = np.array([[cell["best"] for cell in row["means"] + row["cells"]] for row in rows])
    assert (best.sum(axis=0) == 1).all()
    assert best[-1].tolist() == [True] * 5 + [False] + [True] * 4
    assert rows[2]["cells"][1] == {"rms": 0.001, "best": True}


def test_cells_are_of_eight_features(compared):
    assert describe_criteria(compared)["rows"][0]["cells"][0]["rms"] == pytest.approx(0.2)


def test_sentence_names_the_criterion_that_errs_least(compared):
    sentence = describe_criteria(compared)["sentence"]
    assert "selected by forecast error: 0.029 of the range" in sentence
    assert "against 0.200 by the published ideal-point rule" in sentence
    assert "All candidates together reach 0.012" in sentence


def test_the_published_rule_is_not_compared_with_itself(compared):
    for errors in compared["errors"]["ideal_point"].values():
        errors[1] = 0.001
    assert "against" not in describe_criteria(compared)["sentence"]


def test_forecasts_are_told_by_rank_ratio_and_share():
    reached = np.arange(1.0, 21.0)
    forecast = reached * np.repeat([0.7, 1.1], [5, 15])
    told = describe_agreement(np.column_stack([forecast, reached]))
    assert "Of 20 forecasts, 75 % lie within 0.75 and 1.33" in told
    assert "median ratio is 1.10, the rank correlation 1.00" in told


def test_few_forecasts_tell_nothing(compared):
    compared["forecasts"] = compared["forecasts"][:11]
    assert describe_criteria(compared)["forecasts"] == ""


def test_nothing_is_told_of_runs_that_did_not_compare():
    assert describe_criteria(None) is None


def test_page_has_the_table_the_figure_and_the_forecasts(make_run, compared):
    run = make_run(protocols=("honest",))
    summary = json.loads((run / "summary.json").read_text())
    write_json(run / "summary.json", {**summary, "criteria": compared})
    page = write_report(run, n_jobs=1).read_text()
    assert 'id="criteria-table"' in page
    assert "the median ratio is 0.90" in page
    assert (run / "figures" / "criteria.png").exists()


@pytest.mark.parametrize("key", ["sizes", "errors", "all_candidates", "forecasts"])
def test_comparison_without_a_part_is_damaged(run_folder, summary, compared, key):
    del compared[key]
    write_json(run_folder / "summary.json", {**summary, "criteria": compared})
    with pytest.raises(RunFolderError, match=f"summary.json is damaged.*{key}"):
        read_run(run_folder)


def test_criteria_are_told_apart_without_colour(compared):
    ax = plot_criteria(
        {name: by_dof["tx"] for name, by_dof in compared["errors"].items()},
        compared["sizes"],
        all_candidates=0.01,
    )
    looks = {(line.get_marker(), line.get_linestyle()) for line in ax.lines}
    assert len(looks) == len(CRITERIA) + 1
    assert [label.get_text() for label in ax.get_xticklabels()] == ["4", "8", "16", "24"]


@pytest.mark.parametrize("n_dofs", [1, 2, 6])
def test_legend_stays_on_the_figure_for_any_number_of_dofs(compared, n_dofs):
    dofs = list(compared["all_candidates"])[:n_dofs]
    compared["all_candidates"] = dict.fromkeys(dofs, 0.1)
    figure = draw_criteria(compared)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    box, whole = legend.get_window_extent(), figure.bbox
    assert box.x0 >= 0
    assert box.x1 <= whole.x1
    lowest = min(ax.xaxis.label.get_window_extent().y0 for ax in figure.axes)
    assert 0 <= box.y0 < box.y1 <= lowest
