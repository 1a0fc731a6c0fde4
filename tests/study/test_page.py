import json
import re

import pytest

from browser import PHONE, SHEET, bottom_of, chromium, opened, printed, sticks_out
from html_page import Page, check_page
from servoscope.commands.run_study import print_run
from servoscope.errors import RunFolderError
from servoscope.report.figure import FigureFile
from servoscope.storage.folders import write_json
from servoscope.study.figures import list_figures
from servoscope.study.page import describe_command, flatten, write_report, write_run_page
from servoscope.study.results import OF_CHANCE, list_units, read_run
from servoscope.study.tables import errors_table, ranking_table, stability_table, subset_table


@pytest.fixture(scope="module")
def report(honest_run):
    """A drawn report, of one protocol."""
    return write_report(honest_run, n_jobs=1)


@pytest.fixture(scope="module")
def page(report):
    return Page(report)


def page_without_pictures(run):
    """The page of a run, whose figures are not drawn."""
    data = read_run(run)
    files = [FigureFile(o.name, o.caption, b"", 1, 1) for o in list_figures(data)]
    return write_run_page(run / "report.html", data, files)


def test_page_holds_every_table(shared_run):
    page = Page(page_without_pictures(shared_run))
    ids = {attributes.get("id") for attributes in page.all("table")}
    units = [
        f"{protocol}-{form}" for protocol in ("honest", "paper") for form in ("pivot", "camera")
    ]
    tables = ("table1", "table2", "table3", "mi", "redundancy", "bins")
    assert {"result-table1", *(f"{unit}-{table}" for unit in units for table in tables)} <= ids
    assert len(page.all("caption")) == len(page.all("table"))


def test_page_can_be_read_by_anybody(report):
    check_page(report)


def test_page_fits_a_phone_and_its_verdict_the_first_sheet(report):
    with chromium() as browser, opened(browser, report, PHONE) as tab:
        for summary in tab.locator("summary").all():
            summary.click()
        assert sticks_out(tab) <= 0
        tab.emulate_media(media="print")
        tab.set_viewport_size(SHEET)
        assert bottom_of(tab, "#verdict") < SHEET["height"]


def test_page_is_few_full_sheets_without_what_is_another_protocol(report):
    with chromium() as browser, opened(browser, report) as tab:
        texts, used = printed(tab)
        assert "Next:" in texts[0]
        assert "unfold it to print it" in texts[-1]
        assert len(used) <= 12
        assert min(used[:-1]) > 0.6


def test_figures_are_in_the_page_and_in_the_folder_with_an_overview(page, report):
    images = page.all("img")
    files = {path.stem for path in (report.parent / "figures").glob("*.png")}
    assert len(images) == len(files - {"overview"}) == 20
    assert "overview" in files
    assert all(image["alt"] and int(image["width"]) > 100 for image in images)


def test_hostile_names_are_text(make_run):
    hostile = "<script>alert('x')</script>\"&"
    page = Page(page_without_pictures(make_run(kind=hostile)))
    assert len(page.all("script")) == 1
    assert hostile in "".join(page.text)


def test_one_protocol_makes_a_report(make_run):
    page = Page(page_without_pictures(make_run(protocols=("paper",))))
    sections = [attributes["id"] for attributes in page.all("section")]
    assert sections[:4] == ["verdict", "result", "agreement", "images"]
    assert sections[4:] == ["paper-pivot", "paper-camera", "making"]
    assert "flatter the errors" not in "".join(page.text)


def test_page_marks_chance_without_colour(report):
    page = report.read_text()
    marked = re.findall(r'<span class="chance">\((\d\.\d{3})\)</span>', page)
    assert len(marked) == 2 * 384


def test_report_of_an_older_run_leaves_these_parts_out(make_run):
    run = make_run(protocols=("honest",))
    summary = json.loads((run / "summary.json").read_text())
    for results in summary["protocols"]["honest"].values():
        for key in OF_CHANCE:
            del results[key]
    write_json(run / "summary.json", summary)
    page = page_without_pictures(run).read_text()
    assert "honest-pivot-mi" in page
    for part in ("honest-pivot-redundancy", 'class="chance"', "criteria-table"):
        assert part not in page


def test_page_has_the_criteria_their_figure_and_the_forecasts(make_run, compared):
    run = make_run(protocols=("honest",))
    summary = json.loads((run / "summary.json").read_text())
    write_json(run / "summary.json", {**summary, "criteria": compared})
    page = page_without_pictures(run).read_text()
    assert 'id="criteria-table"' in page
    assert "Criteria side by side" in page
    assert "the median ratio is 0.90" in page


def test_every_table_is_written_in_latex_too(report):
    latex = (report.parent / "tables.tex").read_text()
    assert latex.count(r"\begin{tabular}") == latex.count(r"\bottomrule") == 2 * 6
    assert r"\textbf{0.070} (0.07)" in latex


def test_failed_report_leaves_the_old_one(run_folder):
    (run_folder / "report.html").write_text("old")
    (run_folder / "features.npz").write_bytes(b"")
    with pytest.raises(RunFolderError, match="damaged"):
        write_report(run_folder, n_jobs=1)
    assert (run_folder / "report.html").read_text() == "old"


@pytest.fixture
def unit(summary):
    return next(unit for unit in list_units(summary) if unit.key == "paper_pivot")


def test_table1_marks_the_best_family_and_has_the_published_numbers(unit):
    table = errors_table(unit)
    assert [row[0].text.split("\n")[0] for row in table.rows][-2:] == ["Selected", "Baseline"]
    assert all(cell.mark == "best" for cell in table.rows[0][1:-1])
    assert not any(cell.mark for row in table.rows[1:] for cell in row)
    published = ["(0.07)", "(0.05)", "(0.14)", "(0.05)", "(0.07)", "(0.03)"]
    assert [cell.beside for cell in table.rows[0][1:-1]] == published
    assert table.rows[0][1].below == "1.75 mm"


def test_table2_underlines_what_both_lists_hold(unit):
    unit.results["table2"]["tx"] = ["e_05", "pci_tx"]
    first, second, third, *_ = ranking_table(unit).rows
    assert (first[1].text, first[1].mark) == ("□ e_05", "shared")
    assert second[1].mark == ""
    assert third[1].text == ""
    assert first[2].mark == ""


def test_table3_has_the_published_sizes(unit):
    sizes = [row[3].beside for row in subset_table(unit).rows]
    assert sizes == ["(24)", "(7)", "(24)", "(10)", "(16)", "(5)"]


def test_stability_has_a_row_for_every_number_of_bins(unit):
    unit.results["stability"]["ty"][2]["same_steps"] = 4
    rows = stability_table(unit, 10).rows
    assert [row[0].value for row in rows] == list(range(5, 21))
    assert [cell.value for cell in rows[2][1:]] == [65, 4, 65, 65, 65, 65]


def test_command_makes_the_run_again():
    study = {
        "command": "study",
        "seed": 3,
        "protocols": ["honest"],
        "acquisition": {"n_images": 400, "image_size": 128},
    }
    assert describe_command(study) == (
        "servoscope study --seed 3 --n-images 400 --image-size 128 --protocol honest"
    )
    assess = {"command": "assess", "dataset": "my desk", "protocols": ["paper", "honest"]}
    assert describe_command(assess) == "servoscope assess 'my desk' --seed 0 --protocol both"
    assert describe_command({}) is None


def test_settings_are_flattened():
    assert flatten({"a": {"b": [1, 2]}}) == [("a.b", "1, 2")]


def test_a_study_is_printed_unit_by_unit_with_where_its_report_is(summary, tmp_path, capsys):
    for unit in list_units(summary):
        unit.results["ranges"]["tz"]["value"] = None
    print_run(summary, tmp_path, json=False)
    printed = capsys.readouterr().out
    assert printed.index("Honest protocol, displacement about the pivot") < printed.index("Paper's")
    (still, *_) = (line for line in printed.splitlines() if "Baseline" in line)
    cells = [cell.strip() for cell in still.strip("\u2502").split("\u2502")]
    assert [cell == "–" for cell in cells] == [False, False, False, True, *[False] * 4]
    assert printed.splitlines()[-1] == f"report: {tmp_path / 'report.html'}"
