"""The tables of runs as CSV, LaTeX and Markdown."""

import csv
import json

import pytest

from servoscope.cli import main
from servoscope.storage.run_folder import open_run_folder

REHEARSAL = {
    "starts": 4,
    "ranges": {"tx": {"value": 20.0, "unit": "mm"}},
    "results": {
        "none": {
            "success": 4,
            "trials": 4,
            "success_interval": [0.6, 1.0],
            "final_mm_median": 0.0123,
            "final_deg_median": 0.0456,
            "moves_median": 3.0,
            "wrongly_converged": 0,
            "status_counts": {"converged": 4},
        }
    },
}


@pytest.fixture
def run(tmp_path):
    folder = open_run_folder(tmp_path / "run", {"command": "rehearse"}).path
    (folder / "rehearsal.json").write_text(json.dumps(REHEARSAL))
    return folder


def export(run, name, capsys, *options):
    code = main(["export", str(run), str(run.parent / name), "--json", *options])
    said = capsys.readouterr()
    return json.loads(said.out) if code == 0 else said.err


def test_a_table_is_csv_latex_and_markdown(run, capsys):
    export(run, "t.csv", capsys)
    with open(run.parent / "t.csv", newline="") as file:
        head, row = csv.reader(file)
    assert head[:3] == ["condition", "arrive", "95 % interval"]
    assert row[:3] == ["none", "4/4", "60% to 100%"]
    export(run, "t.tex", capsys)
    assert r"\begin{tabular}" in (run.parent / "t.tex").read_text()
    export(run, "t.md", capsys)
    assert "| none | 4/4 |" in (run.parent / "t.md").read_text()


def test_nothing_is_replaced_unless_forced(run, capsys):
    (run.parent / "t.csv").write_text("mine")
    assert "--force" in export(run, "t.csv", capsys)
    assert (run.parent / "t.csv").read_text() == "mine"
    export(run, "t.csv", capsys, "--force")
    assert (run.parent / "t.csv").read_text() != "mine"


@pytest.mark.parametrize(
    "content", ["{}", "[]", "not json", '{"results": {"none": 3}, "starts": 1, "ranges": []}']
)
def test_a_damaged_run_is_refused_in_a_line(run, capsys, content):
    (run / "rehearsal.json").write_text(content)
    assert len(export(run, "t.csv", capsys).splitlines()) == 1


def test_what_is_no_finished_run_is_refused(run, tmp_path, capsys):
    (run / "rehearsal.json").unlink()
    assert "not finished" in export(run, "t.csv", capsys)
    (tmp_path / "nothing").mkdir()
    assert len(export(tmp_path / "nothing", "t.csv", capsys).splitlines()) == 1
