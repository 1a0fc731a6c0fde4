"""``servoscope rehearse`` and ``servoscope sensitivity --on``, on a small model."""

import json

import pytest

from rehearsal_sample import model
from servoscope import cli


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("rehearse") / "model"
    model().save(path)
    return path


def run(folder, out, *options):
    sizes = ("--starts", "1", "--jobs", "1", "--conditions", "range_1.0", "gain_0.8")
    return cli.main(["rehearse", str(folder), "--out", str(out), *sizes, *options])


def test_it_prints_a_table_and_a_verdict_writes_a_page_and_goes_on(folder, tmp_path, capsys):
    out = tmp_path / "run"
    assert run(folder, out) == 0
    printed = capsys.readouterr().out
    assert "1/1" in printed
    assert "arrive under" in printed
    page = (out / "rehearsal.html").read_text()
    assert "gain_0.8" in page
    assert page.count("data:image/png") == 3
    for name in ("success", "starts", "examples"):
        assert (out / "figures" / f"{name}.png").exists()
    first = json.loads((out / "rehearsal.json").read_text())
    (out / "trials" / "gain_0.8.json").unlink()
    assert run(folder, out, "--resume", "--json") == 0
    again = json.loads(capsys.readouterr().out)
    assert again["results"] == first["results"]
    assert again["verdict"] == first["verdict"]
    assert run(folder, out) == 1
    assert "--resume" in capsys.readouterr().err


def test_an_unknown_condition_leaves_no_folder(folder, tmp_path, capsys):
    assert (
        cli.main(["rehearse", str(folder), "--out", str(tmp_path / "r"), "--conditions", "x"]) == 1
    )
    assert "range_1.0" in capsys.readouterr().err
    assert not (tmp_path / "r").exists()


def test_what_is_no_model_is_said_in_one_line(tmp_path, capsys):
    assert cli.main(["rehearse", str(tmp_path), "--out", str(tmp_path / "r")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_sensitivity_of_a_model_of_one_s_own(folder, tmp_path, capsys):
    what = ["--on", str(folder), "--n-test", "1", "--disturbances", "hand_eye_tx", "--jobs", "1"]
    out = tmp_path / "run"
    assert cli.main(["sensitivity", "--out", str(out), *what]) == 0
    assert "model: strength at which the error has doubled" in capsys.readouterr().out
    results = json.loads((out / "sensitivity.json").read_text())
    assert results["features"]["model"]["sensitivity"]["hand_eye_tx"]["tx"]["unit"] == "mm"
    assert (out / "figures" / "sensitivity_model.png").exists()


@pytest.mark.parametrize("n_test", ["0", "-3"])
def test_no_tests_are_refused_in_a_line(folder, tmp_path, capsys, n_test):
    what = ["--on", str(folder), "--n-test", n_test, "--out", str(tmp_path / "run")]
    assert cli.main(["sensitivity", *what]) == 1
    assert cli.main(["sensitivity", *what[2:]]) == 1
    err = capsys.readouterr().err
    assert "n_test must be a whole number from 1," in err
    assert "n_test must be a whole number from 2," in err
    assert err.count("\n") == 2
    assert not (tmp_path / "run").exists()


def test_a_range_beyond_all_sense_is_refused_in_a_line(folder, tmp_path, capsys):
    assert run(folder, tmp_path / "run", "--range-mm", "100000") == 1
    err = capsys.readouterr().err
    assert "range_mm must be above 0 and at most 200" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "run").exists()
