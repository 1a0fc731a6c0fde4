"""The study over many cells: what differs between them, shares with intervals, associations."""

import json

import numpy as np
import pytest
from scipy.stats import norm

from html_page import check_page
from servoscope.cli import main
from servoscope.commands import run_cells
from servoscope.scene.lighting import Lighting
from servoscope.storage.folders import write_json
from servoscope.storage.run_folder import read_json
from servoscope.study import StudyConfig
from servoscope.study.cells import (
    CLEAN,
    FACTORS,
    POOR,
    Cell,
    association,
    lighter,
    make_cells,
    share_of,
    study_cell,
    summarise_cells,
)
from servoscope.study.cells_page import describe_order

MIDDLE = {name: (low + high) / 2 for name, (_, low, high) in FACTORS.items()}


def light_on_the_plane(lighting: Lighting) -> float:
    """Lambert's law below the camera, where the table has its normal up."""
    lamps = lighting.lamp_rows().astype(float)
    return lighting.ambient + sum(s * z / np.hypot(np.hypot(x, y), z) ** 3 for x, y, z, s in lamps)


def test_cells_are_spread_evenly_and_each_has_another_part_and_seed():
    cells = make_cells(10, seed=3)
    for name, (_, low, high) in FACTORS.items():
        values = np.sort([cell.factors[name] for cell in cells])
        edges = np.linspace(low, high, 11)
        assert ((edges[:-1] <= values) & (values <= edges[1:])).all()
    assert len({cell.scene(32).part.variant for cell in cells}) == 10
    others = make_cells(10, seed=4)
    assert make_cells(10, seed=3) == cells
    for what in (lambda cell: cell.own_seed, lambda cell: cell.scene(32).part.variant):
        assert not set(map(what, cells)) & set(map(what, others))
    assert not {cell.factors["sensor"] for cell in cells} & {c.factors["sensor"] for c in others}


def test_lights_move_but_shine_as_brightly_in_all():
    usual = light_on_the_plane(Lighting())
    for cell in make_cells(6):
        lighting = cell.scene(32).lighting
        assert light_on_the_plane(lighting) == pytest.approx(usual, rel=1e-5)
        assert lighting.ambient == pytest.approx(cell.factors["ambient"] * usual)
        moves = [
            np.linalg.norm(np.subtract(lamp.position, before.position))
            for lamp, before in zip(lighting.lamps, Lighting().lamps, strict=True)
        ]
        assert moves == pytest.approx([cell.factors["lamp_m"]] * 2)


@pytest.mark.parametrize(("share", "end"), [(0.0, CLEAN), (1.0, POOR)])
def test_the_sensor_goes_from_clean_to_poor(share, end):
    sensor = Cell(0, {**MIDDLE, "sensor": share}).scene(32).sensor
    for name in ("full_well", "read_noise", "blur", "vignetting"):
        assert getattr(sensor, name) == pytest.approx(getattr(end, name))


@pytest.mark.parametrize(("k", "n"), [(0, 20), (7, 20), (20, 20)])
def test_the_interval_of_a_share_is_wilsons(k, n):
    z = norm.ppf(0.95)
    middle = (k / n + z**2 / (2 * n)) / (1 + z**2 / n)
    width = z / (1 + z**2 / n) * np.sqrt(k / n * (1 - k / n) / n + z**2 / (4 * n**2))
    found = share_of(["yes"] * k + ["no"] * (n - k))
    assert found["interval"] == pytest.approx([middle - width, middle + width], abs=1e-12)


def test_a_factor_that_decides_the_order_is_found_and_others_are_not_too_often():
    factor = np.linspace(0, 1, 20)
    ratio = np.where(factor > 0.5, -1.0, 1.0) + 0.01 * factor
    found = association(factor, ratio, ["pci" if value < 0 else "pca" for value in ratio])
    assert (found["low"], found["high"]) == ({"pca": 10}, {"pci": 10})
    assert found["interval"][1] < 0
    rng = np.random.default_rng(0)
    unrelated = [association(rng.random(20), rng.random(20), ["pca"] * 20) for _ in range(400)]
    share = np.mean([one["interval"][0] <= 0 <= one["interval"][1] for one in unrelated])
    assert 0.85 < share < 0.95  # of 90 %
    assert association([0, 1, 2], [1, 2, 3], ["pca"] * 3)["interval"] is None


def found_in(cell, *_):
    """A cell in which PCI is before PCA where the sensor is poor."""
    means = {"gm": 0.1, "pca": 0.2, "pci": 0.3 - 0.2 * cell.factors["sensor"]}
    means |= {"lfa35": 0.5, "lfa85": 0.6}
    verdicts = {"one": "yes", "two": "partly" if cell.number % 2 else "no"}
    factors = dict(cell.factors)
    return {"number": cell.number, "factors": factors, "verdicts": verdicts, "means": means,
            "seconds": 1.0}  # fmt: skip


def test_a_run_goes_on_with_the_cells_that_are_left_and_its_page_says_what_was_found(
    tmp_path, monkeypatch, capsys
):
    studied = []

    def fails_at_six(cell, *rest):
        studied.append(cell.number)
        if cell.number == 6:
            raise KeyboardInterrupt
        return found_in(cell)

    run = tmp_path / "run"
    command = ["study", "--cells", "8", "--out", str(run), "--jobs", "1"]
    monkeypatch.setattr(run_cells, "study_cell", fails_at_six)
    assert main(command) == 130
    monkeypatch.setattr(run_cells, "study_cell", found_in)
    capsys.readouterr()
    assert main([*command, "--resume"]) == 0
    assert studied == list(range(7))
    assert "8 of 8" in capsys.readouterr().out
    summary = read_json(run / "summary.json")
    assert summary["found"] == summarise_cells([found_in(cell) for cell in make_cells(8)])
    depends = {row["factor"]: row for row in summary["found"]["depends"]}
    assert depends["sensor"]["rank_correlation"] == pytest.approx(-1)
    assert "sensor" in describe_order(summary["found"])
    (run / "report.html").unlink()
    assert main(["report", str(run), "--jobs", "1"]) == 0
    assert "Of 2 statements of the paper 1 hold" in check_page(run / "report.html").source


def test_a_cell_that_fails_is_a_row_and_counts_nowhere_until_it_is_tried_again(
    tmp_path, monkeypatch, capsys
):
    studied = []

    def two_fail(cell, *_):
        studied.append(cell.number)
        if cell.number in (2, 5):
            raise ValueError("it is dark")
        return found_in(cell)

    run = tmp_path / "run"
    command = ["study", "--cells", "8", "--out", str(run), "--jobs", "1"]
    monkeypatch.setattr(run_cells, "study_cell", two_fail)
    assert main(command) == 1
    shown = capsys.readouterr()
    assert "2 of 8 cells could not be studied, such as cell 2; mend what" in shown.err
    assert "6 of 8 simulated cells" in shown.out
    summary = read_json(run / "summary.json")
    whole = [found_in(cell) for cell in make_cells(8)]
    others = summarise_cells([cell for cell in whole if cell["number"] not in (2, 5)])
    assert summary["found"] == {**others, "n_failed": 2}
    assert summary["found"]["statements"][0] == {"claim": "one", **share_of(["yes"] * 6)}
    reason = "unexpected ValueError: it is dark; --debug shows where it came from"
    assert [one["error"] for one in summary["cells"]] == [
        reason if number in (2, 5) else None for number in range(8)
    ]
    page = check_page(run / "report.html").source
    assert "2 of 8 cells could not be studied" in page
    assert page.count(reason) == 2
    assert main([*command, "--resume", "--debug"]) == 1
    assert studied == [*range(8), 2, 5]
    assert capsys.readouterr().err.count("in two_fail") == 2
    monkeypatch.setattr(run_cells, "study_cell", found_in)
    assert main([*command, "--resume"]) == 0
    assert read_json(run / "summary.json")["found"] == summarise_cells(whole)


@pytest.mark.parametrize("harm", ["", "{", "{}", '{"seconds": 1, "verdicts": {}, "means": {}}'])
def test_a_damaged_cell_is_made_again_and_json_is_all_that_is_printed(
    harm, tmp_path, monkeypatch, capsys
):
    studied = []

    def noted(cell, *_):
        studied.append(cell.number)
        return found_in(cell)

    run = tmp_path / "run"
    command = ["study", "--cells", "4", "--out", str(run), "--jobs", "1", "--json"]
    monkeypatch.setattr(run_cells, "study_cell", noted)
    assert main(command) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == read_json(run / "summary.json")
    (run / "cells" / "0002.json").write_text(harm)
    assert main([*command, "--resume"]) == 0
    assert studied == [0, 1, 2, 3, 2]
    assert json.loads(capsys.readouterr().out)["found"] == found["found"]


def test_a_run_in_which_every_cell_fails_says_so_on_its_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_cells, "study_cell", lambda *_: 1 / 0)
    run = tmp_path / "run"
    assert main(["study", "--cells", "2", "--out", str(run), "--jobs", "1"]) == 1
    assert "2 of 2 cells could not be studied" in capsys.readouterr().err
    assert "No cell could be studied." in check_page(run / "report.html").source


def test_the_report_of_a_damaged_summary_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run_cells, "study_cell", found_in)
    run = tmp_path / "run"
    assert main(["study", "--cells", "2", "--out", str(run), "--jobs", "1"]) == 0
    summary = read_json(run / "summary.json")
    summary["cells"][0]["seconds"] = "long"
    write_json(run / "summary.json", summary)
    capsys.readouterr()
    assert main(["report", str(run), "--jobs", "1"]) == 1
    assert capsys.readouterr().err == (
        f"servoscope: {run / 'summary.json'} is damaged; make the run again with --force.\n"
    )


@pytest.mark.slow
def test_a_cell_gives_a_verdict_on_every_statement_and_an_error_of_every_family():
    config = lighter(StudyConfig(protocols=("honest",), hidden=3))
    (cell,) = make_cells(1)
    found = study_cell(cell, 144, 24, config)
    assert len(found["verdicts"]) >= 12
    assert set(found["verdicts"].values()) <= {"yes", "no", "partly"}
    assert all(0 < mean < 1 for mean in found["means"].values())
