"""``servoscope sensitivity``, with two of the disturbances."""

import json

from servoscope import cli


def run(folder, *options):
    sizes = ("--n-images", "60", "--n-test", "3", "--image-size", "64", "--jobs", "1")
    what = ("--features", "tchebichef", "--disturbances", "gain", "noise")
    plane = ("--part", "textured_plane")
    return cli.main(["sensitivity", "--out", str(folder), *plane, *what, *sizes, *options])


def test_it_prints_a_table_resumes_and_prints_json(tmp_path, capsys):
    folder = tmp_path / "run"
    assert run(folder) == 0
    printed = capsys.readouterr().out
    assert "tchebichef: strength at which the error has doubled" in printed
    assert "noise" in printed
    assert (folder / "figures" / "sensitivity_tchebichef.png").exists()
    assert "| gain |" in (folder / "sensitivity.md").read_text()
    (folder / "trials" / "noise.json").unlink()
    first = json.loads((folder / "sensitivity.json").read_text())
    assert run(folder, "--resume", "--json") == 0
    again = json.loads(capsys.readouterr().out)
    assert again["features"] == first["features"]
    assert again["timings_s"]["errors_gain"] == first["timings_s"]["errors_gain"]
    growth = again["features"]["tchebichef"]["sensitivity"]["gain"]["tz"]
    assert growth["strengths"][0] == -20.0
    assert run(folder) == 1
    assert "--resume" in capsys.readouterr().err


def test_too_few_images_leave_no_folder(tmp_path, capsys):
    assert run(tmp_path / "run", "--n-images", "5") == 1
    assert "n_images must be a whole number from 50" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
