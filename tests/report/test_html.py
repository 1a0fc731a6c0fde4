import re
from html.parser import HTMLParser
from itertools import pairwise

import pytest

from servoscope.errors import RunFolderError
from servoscope.poses import DOFS
from servoscope.report import read_run, write_report
from servoscope.report.facts import collect_facts, describe_command, flatten
from servoscope.report.figures.catalogue import list_figures
from servoscope.report.figures.rendering import FigureFile, draw_figures
from servoscope.report.html import render_page
from servoscope.report.tables import ranking_table, rms_table, stability_table, subset_table

VOID = {"meta", "img", "br", "link", "input", "hr"}


class Page(HTMLParser):
    """Tags with their attributes, and the text; fails on tags that do not nest."""

    def __init__(self, path):
        super().__init__()
        self.tags, self.open, self.text = [], [], []
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def report(shared_run):
    return write_report(shared_run, n_jobs=1)


@pytest.fixture
def page(report):
    return Page(report)


def test_page_holds_every_table(page):
    ids = {attributes.get("id") for attributes in page.all("table")}
    units = [
        f"{protocol}-{form}" for protocol in ("honest", "paper") for form in ("pivot", "camera")
    ]
    tables = ("table1", "table2", "table3", "mi", "redundancy", "bins")
    assert {"result-table1", *(f"{unit}-{table}" for unit in units for table in tables)} <= ids
    assert len(page.all("caption")) == len(page.all("table"))


def test_page_asks_for_nothing_outside_itself(page, report):
    for tag, attributes in page.tags:
        for name in ("src", "href", "srcset", "action"):
            if name in attributes:
                assert attributes[name].startswith(("data:image/png;base64,", "#")), tag
    text = re.sub(r"base64,[\w+/=]+", "", report.read_text())
    assert not re.search(r"https?://|url\(|@import", text)


def test_links_lead_to_places_of_the_page(page):
    ids = {attributes["id"] for _, attributes in page.tags if "id" in attributes}
    assert {link["href"][1:] for link in page.all("a")} <= ids


def test_figures_are_in_the_page_and_in_the_folder_with_an_overview(page, report):
    images = page.all("img")
    files = {path.stem for path in (report.parent / "figures").glob("*.png")}
    assert len(images) == len(files - {"overview"}) == 37
    assert "overview" in files
    assert all(image["alt"] and int(image["width"]) > 100 for image in images)


def test_page_says_its_language_and_counts_headings_without_gaps(page):
    assert page.all("html") == [{"lang": "en"}]
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch(r"h\d", tag)]
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))


def test_hostile_names_are_text(make_run):
    hostile = "<script>alert('x')</script>\"&"
    data = read_run(make_run(kind=hostile))
    orders = list_figures(data)
    files = [FigureFile(order.name, order.caption, b"", 1, 1) for order in orders]
    path = data.path / "report.html"
    path.write_text(render_page(collect_facts(data, files)), encoding="utf-8")
    page = Page(path)
    assert len(page.all("script")) == 1
    assert hostile in "".join(page.text)


def test_one_protocol_makes_a_report(make_run):
    run = make_run(protocols=("paper",))
    page = Page(write_report(run, n_jobs=1))
    sections = [attributes["id"] for attributes in page.all("section")]
    assert sections == [
        "result",
        "agreement",
        "images",
        "paper-pivot",
        "paper-camera",
        "making",
    ]
    assert "flatter the errors" not in "".join(page.text)


def test_processes_make_no_difference(run_folder, tmp_path):
    orders = list_figures(read_run(run_folder))[:4]
    one, two = (draw_figures(orders, tmp_path / str(n), n_jobs=n) for n in (1, 2))
    assert one == two


def test_failed_report_leaves_the_old_one(run_folder):
    (run_folder / "report.html").write_text("old")
    (run_folder / "features.npz").write_bytes(b"")
    with pytest.raises(RunFolderError, match="damaged"):
        write_report(run_folder, n_jobs=1)
    assert (run_folder / "report.html").read_text() == "old"


def test_table1_marks_the_best_family_and_has_the_published_numbers(summary):
    rows = rms_table(summary["protocols"]["paper"]["pivot"])
    assert [row["title"] for row in rows][-2:] == ["Selected", "Baseline"]
    assert all(cell["best"] for cell in rows[0]["cells"])
    assert not any(cell["best"] for row in rows[1:] for cell in row["cells"])
    assert [cell["published"] for cell in rows[0]["cells"]] == [0.07, 0.05, 0.14, 0.05, 0.07, 0.03]
    assert rows[0]["cells"][0]["physical"] == pytest.approx(1.75)


def test_table2_underlines_what_both_lists_hold(summary):
    results = summary["protocols"]["paper"]["pivot"]
    results["table2"]["tx"] = ["e_05", "pci_tx"]
    (first, second, third, *_) = ranking_table(results)
    assert first[0]["ours"] == {"name": "e_05", "family": "pca", "mark": "□", "shared": True}
    assert not second[0]["ours"]["shared"]
    assert third[0]["ours"] is None
    assert not first[0]["published"]["shared"]


def test_table3_has_the_published_sizes(summary):
    rows = subset_table(summary["protocols"]["paper"]["pivot"])
    assert [row["published_n"] for row in rows] == [24, 7, 24, 10, 16, 5]


def test_stability_has_a_row_for_every_number_of_bins(summary):
    results = summary["protocols"]["paper"]["pivot"]
    results["stability"]["ty"][2]["same_steps"] = 4
    rows = stability_table(results)
    assert [row["n_bins"] for row in rows] == list(range(5, 21))
    assert [cell["steps"] for cell in rows[2]["cells"]] == [65, 4, 65, 65, 65, 65]
    assert len(rows[0]["cells"]) == len(DOFS)


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
