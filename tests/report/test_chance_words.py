import json
import re

import pytest

from servoscope.errors import RunFolderError
from servoscope.files import write_json
from servoscope.poses import DOFS
from servoscope.report import read_run, write_report
from servoscope.report.chance import describe_chance
from servoscope.report.figures.redundancy import draw_redundancies, plot_redundancy
from servoscope.report.run_data import OF_CHANCE
from servoscope.report.tables import information_table
from servoscope.study.paper import table2


@pytest.fixture
def results(summary):
    return summary["protocols"]["honest"]["pivot"]


def cell_of(results, name, dof):
    (row,) = [row for row in information_table(results) if row["name"] == name]
    return row["cells"][DOFS.index(dof)]


def test_values_that_are_no_more_than_chance_are_marked_and_counted(results):
    first = table2("rz")[0]
    assert not cell_of(results, first, "rz")["chance"]
    assert cell_of(results, "e_34", "rz")["chance"]
    told = describe_chance(results)
    assert (told["n_values"], told["n_chance"]) == (65 * 6, 65 * 6 - 6)


def test_every_value_has_its_corrected_one(results):
    assert cell_of(results, "e_34", "tx")["corrected"] == -0.002


def test_sentence_tells_the_mean_of_the_dofs_at_steps_8_and_24(results):
    for step in (7, 23):
        chance = {"redundancy": 3.1, "bias": 0.3, "unrelated": 2.0}
        results["redundancy_bias"]["tx"][step] = chance
    sentence = describe_chance(results)["sentence"]
    assert "step 8 the selected feature shares 1.10 bits" in sentence
    assert "of which 0.40 are bias (36 %); unrelated features would show 0.80." in sentence
    assert "step 24 the selected feature shares 2.43 bits" in sentence
    assert "7 × 0.058 = 0.41" in sentence


def test_the_corrected_rule_is_compared_with_the_published_one(results):
    row = describe_chance(results)["rows"][DOFS.index("tz")]
    published, corrected = results["table2"]["tz"], results["table2_corrected"]["tz"]
    assert published[3] != corrected[3]
    assert row["same_steps"] == 3
    assert row["n_shared"] == len(set(published) & set(corrected))
    assert [item["name"] for item in row["features"]] == corrected[:8]


def test_dofs_that_never_move_and_steps_that_were_not_made_are_left_out(results):
    results["ranges"]["tx"]["value"] = None
    results["redundancy_bias"]["ry"] = results["redundancy_bias"]["ry"][:10]
    told = describe_chance(results)
    assert told["steps"] == [8]
    assert [row["dof"] for row in told["rows"]] == ["Ty", "Tz", "Rx", "Ry", "Rz"]


def test_nothing_is_said_where_nothing_moves(results):
    for dof in DOFS:
        results["ranges"][dof]["value"] = None
    assert describe_chance(results)["sentence"] == ""


def test_page_marks_chance_without_colour(make_run):
    page = write_report(make_run(protocols=("honest",)), n_jobs=1).read_text()
    marked = re.findall(r'<span class="chance">\((\d\.\d{3})\)</span>', page)
    assert len(marked) == 2 * 384
    assert page.count("the 384 of 390 values that do not differ from chance") == 2


def test_report_of_an_older_run_leaves_these_parts_out(make_run):
    run = make_run(protocols=("honest",))
    summary = json.loads((run / "summary.json").read_text())
    for results in summary["protocols"]["honest"].values():
        for key in OF_CHANCE:
            del results[key]
    write_json(run / "summary.json", summary)
    page = write_report(run, n_jobs=1).read_text()
    assert "honest-pivot-mi" in page
    for part in ("honest-pivot-redundancy", 'class="chance"', 'class="corrected"', "criteria"):
        assert part not in page.split("</style>")[1]


@pytest.mark.parametrize("key", OF_CHANCE)
def test_run_that_holds_only_a_part_of_it_is_damaged(run_folder, summary, key):
    del summary["protocols"]["paper"]["pivot"][key]
    write_json(run_folder / "summary.json", summary)
    with pytest.raises(RunFolderError, match=f"summary.json is damaged.*{key}.*--force") as caught:
        read_run(run_folder)
    assert "\n" not in str(caught.value)


def test_redundancy_and_bias_are_told_apart_without_colour():
    parts = {"redundancy": 0.1, "bias": 0.05, "unrelated": 0.08}
    steps = [{part: slope * i for part, slope in parts.items()} for i in range(4)]
    ax = plot_redundancy(steps, dof="tx")
    redundancy, bias, unrelated = ax.lines
    assert redundancy.get_ydata() == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert bias.get_ydata() == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert unrelated.get_ydata() == pytest.approx([0.0, 0.08, 0.16, 0.24])
    assert len({line.get_linestyle() for line in ax.lines}) == 3
    assert ax.get_ylabel() == "[bits]"


def test_every_dof_has_its_panel(results):
    titles = [ax.get_title() for ax in draw_redundancies(results["redundancy_bias"]).axes]
    assert titles == ["Tx", "Ty", "Tz", "Rx", "Ry", "Rz"]
