"""``servoscope assess`` as its users meet it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from html_page import check_page
from planar import planar_data_set, planar_images
from servoscope.cli import main
from servoscope.data.images import PoseImageSet
from servoscope.pipeline import PosePipeline
from servoscope.poses import DISPLAY_FACTORS, DOFS, poses_from_displacements
from servoscope.storage.run_folder import open_run_folder, read_json
from servoscope.study import Study, StudyConfig
from small_keyframe import quick_fits
from small_study import make_small

FAMILIES = ("--families", "moments,log_polar")
KEYS = {"forecast_rms", "interval", "reached_rms", "unit", "limited_by", "best_features", "advice"}


def assess(data, folder: Path, *options: str) -> tuple[int, Path]:
    data.save(folder / "data")
    run = folder / "run"
    command = ["assess", str(folder / "data"), "--out", str(run), "--families", "moments"]
    return main([*command, "--protocol", "honest", "--jobs", "1", *options]), run


@pytest.fixture(scope="module", autouse=True)
def _small():
    with quick_fits(), pytest.MonkeyPatch.context() as patch:
        make_small(patch.setattr)
        yield


@pytest.fixture
def without_view(monkeypatch):
    """No keyframe is fitted, where it is not the matter."""
    begun = "servoscope.assessment.run.begin_view"
    monkeypatch.setattr(begun, lambda *_, **__: iter([(None, [])]))


@pytest.fixture
def without_page(monkeypatch):
    """No figures are drawn, where nobody looks at them."""
    monkeypatch.setattr("servoscope.commands.run_study.write_report", lambda *_, **__: None)


ASKED = (*FAMILIES, "--study", "--want", "t=1mm,rz=60deg")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run with a study."""
    folder = tmp_path_factory.mktemp("assess")
    code, run = assess(planar_data_set(144, 24), folder, *ASKED)
    assert code == 0
    return run


@pytest.mark.slow
def test_json_has_the_decision_of_every_dof(finished, capsys):
    command = ["assess", str(finished.parent / "data"), "--out", str(finished), "--resume"]
    assert main([*command, "--protocol", "honest", *ASKED, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert next(iter(told)) == "assessment"
    assert list(told["assessment"]) == list(DOFS)
    for dof, row in told["assessment"].items():
        assert row.keys() >= KEYS
        assert row["unit"] == ("mm" if dof[0] == "t" else "deg")
        assert row["interval"][0] < row["forecast_rms"] < row["interval"][1]
        assert row["advice"]
    assert told["assessment"]["tx"]["tolerance"] == 1.0
    assert told["protocols"]["honest"]["pivot"]["table1"]


@pytest.mark.slow
def test_its_study_is_the_study_of_these_images(finished, tmp_path):
    data, config = PoseImageSet.load(finished.parent / "data"), StudyConfig(protocols=("honest",))
    Study(open_run_folder(tmp_path / "study", {}), data, config, n_jobs=1).run()
    alone, beside = (read_json(run / "summary.json") for run in (tmp_path / "study", finished))
    assert beside["protocols"] == alone["protocols"]


@pytest.mark.usefixtures("without_view", "without_page")
def test_the_pipeline_of_the_choice_is_saved_with_what_is_known_of_it(tmp_path):
    data = planar_data_set(80, 16)
    code, run = assess(data, tmp_path)
    assert code == 0
    summary = json.loads((run / "summary.json").read_text())
    assert (summary["protocols"], summary["assessed"]["regressors"]) == ({}, [])
    pipeline = PosePipeline.load(run / "models" / "pipeline")
    told = pipeline.describe()
    assert told["fingerprint"] == PoseImageSet.load(tmp_path / "data").fingerprint()
    assert len(told["groups"]) == 80
    units = dict(zip(DOFS, DISPLAY_FACTORS, strict=True))
    for dof, row in summary["assessment"].items():
        assert told["forecast"][dof] * units[dof] == pytest.approx(row["forecast_rms"])
        assert told["measured"][dof] * units[dof] == pytest.approx(row["split_rms"])
        low, high = row["reached_interval"]
        assert low < row["reached_rms"] < high
    test = pipeline.split_.test
    error = pipeline.predict(data.images[test]) - data.delta_p()[test]
    rms = np.sqrt(np.mean(error**2, axis=0))
    np.testing.assert_allclose(rms, [told["measured"][dof] for dof in DOFS], rtol=1e-3)


@pytest.mark.slow
def test_the_report_opens_with_the_decision(finished):
    page = check_page(finished / "report.html").source
    tables = [page.index(f'id="{name}"') for name in ("decision-table", "result-table1")]
    assert tables == sorted(tables)
    assert page.index("decision-table") < page.index("<img")
    assert "Wells and Torras" in page
    assert {"reach.png", "budgets.png", "behind.png"} <= {
        figure.name for figure in (finished / "figures").iterdir()
    }


@pytest.mark.usefixtures("without_view")
@pytest.mark.slow
def test_the_terminal_shows_the_decision_and_where_the_report_is(tmp_path, capsys):
    code, run = assess(planar_data_set(60, 16), tmp_path, "--study")
    out = capsys.readouterr().out
    assert code == 0
    assert "RMS error of each degree of freedom" in out
    assert "The paper's study is left out. A study needs at least 144 images" in out
    assert str(run / "report.html") in out.replace("\n", "")
    summary = json.loads((run / "summary.json").read_text())
    assert summary["protocols"] == {}
    assert "at least 144 images" in summary["study_left_out"]
    assert "at least 144 images" in (run / "report.html").read_text()
    assert main(["report", str(run), "--jobs", "1"]) == 0
    capsys.readouterr()
    assert main(["info", str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["finished"] is True


@pytest.mark.filterwarnings("default::servoscope.errors.ServoscopeWarning")
def test_of_constant_images_it_says_that_nothing_can_be_learned(tmp_path, capsys):
    data = planar_data_set(60, 16)
    frozen = replace(data, images=np.repeat(data.images[:1], 60, axis=0))
    code, run = assess(frozen, tmp_path, "--json")
    assert code == 0
    out, err = capsys.readouterr()
    assert "59 repeated (000001, 000002, ...)" in err
    told = json.loads(out)
    assert told["assessed"]["conclusion"] == "Nothing can be learned from these images."
    for row in told["assessment"].values():
        assert row["limited_by"] == "images do not change"
        assert row["advice"][0].startswith("nothing can be learned")
    assert "Nothing can be learned" in (run / "report.html").read_text()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--want", "tx=1"], "written like tx=0.5mm"),
        (["--want", "tx=1deg"], "tolerance of tx is in mm"),
        (["--pose-error", "x"], "written like"),
        (["--families", "gabor"], "families must be all or taken from moments"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, capsys, options, said):
    planar_data_set(60, 16).save(tmp_path / "data")
    out = tmp_path / "run"
    assert main(["assess", str(tmp_path / "data"), "--out", str(out), *options]) == 1
    err = capsys.readouterr().err
    assert said in err
    assert len(err.splitlines()) == 1
    assert not out.exists()


@pytest.mark.usefixtures("without_view", "without_page")
@pytest.mark.slow
def test_the_study_of_what_turns_out_a_sequence_is_not_split_at_random(tmp_path, capsys):
    data = planar_data_set(160, 16)
    turns = np.linspace(0, 2 * np.pi, 160)[:, None] * [1, 2, 3, 2, 1, 3] + np.arange(6)
    delta_p = 0.9 * data.ranges() * np.sin(turns)
    path = replace(
        data,
        images=planar_images(delta_p, 16, seed=0),
        T_world_cam=poses_from_displacements(data.T_world_ref, delta_p, data.pivot),
    )
    code, run = assess(path, tmp_path, "--dofs", "tx")
    assert code == 0
    assert json.loads((run / "summary.json").read_text())["dataset"]["split"] == "blocks"


@pytest.mark.usefixtures("without_view", "without_page")
def test_what_is_known_of_one_dof_leaves_the_simulated_errors_of_the_others(tmp_path, capsys):
    known = {"repeatability_mm": 0.5, "repeatability_deg": 0.5}
    data = planar_data_set(60, 16, source=known)
    code, _ = assess(data, tmp_path, *FAMILIES, "--pose-error", "tx=1mm", "--json")
    assert code == 0
    told = json.loads(capsys.readouterr().out)["assessment"]
    for dof, label in zip(DOFS, (1.0, *[0.5] * 5), strict=True):
        share = told[dof]["budget"]["pose_labels"]
        assert share == pytest.approx((label / told[dof]["forecast_rms"]) ** 2, rel=1e-6)


@pytest.mark.usefixtures("without_view", "without_page")
def test_dofs_that_are_named_are_assessed_alone(tmp_path, capsys):
    options = ["--dofs", "tx,rz", "--tolerance", "t=1mm", "--json"]
    code, run = assess(planar_data_set(64, 16), tmp_path, *options)
    assert code == 0
    told = json.loads(capsys.readouterr().out)
    for dof, row in told["assessment"].items():
        is_asked = dof in ("tx", "rz")
        assert (row["forecast_rms"] is not None) == is_asked
        assert (row["limited_by"] == "not asked for") != is_asked
        assert (row["tolerance"] is not None) == (dof == "tx")
    pipeline = PosePipeline.load(run / "models" / "pipeline")
    assert tuple(pipeline.regressors_) == ("tx", "rz")
    (tmp_path / "other").mkdir()
    assert assess(planar_data_set(64, 16), tmp_path / "other", "--dofs", "tx,yaw")[0] == 1
    assert "each named once, got tx,yaw" in capsys.readouterr().err
