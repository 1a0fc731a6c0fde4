"""``servoscope train --assessment``: what is assessed is what is trained, and what drives."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from servoscope.cli import main
from servoscope.commands.train import read_assessment
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import independent_groups, mark_sequence
from servoscope.errors import DataSetError
from servoscope.pipeline import PosePipeline
from servoscope.poses import poses_from_displacements
from servoscope.positioning.training import Assessed
from small_keyframe import quick_fits


def in_order() -> PoseImageSet:
    """80 images of a camera that sways about the reference."""
    time = np.linspace(0, 2 * np.pi, 80)[:, None]
    delta_p = RANGES * np.sin([1.0, 1.7, 2.3, 0.8, 1.3, 2.9] * time + np.arange(6))
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), 16, 0)
    poses = poses_from_displacements(np.eye(4), delta_p, PIVOT)
    return PoseImageSet(images[:-1], poses, np.eye(4), images[-1], pivot=PIVOT)


@pytest.fixture(scope="module")
def assessed(tmp_path_factory):
    """A data set whose images come in a sequence, and its assessment."""
    folder = tmp_path_factory.mktemp("assessed")
    in_order().save(folder / "data")
    command = ["assess", str(folder / "data"), "--out", str(folder / "run"), "--jobs", "1"]
    with quick_fits():
        assert main([*command, "--families", "moments"]) == 0
    return folder


def train(folder, *options):
    return main(["train", str(folder / "data"), "--out", str(folder / "model"), *options])


def test_the_split_and_the_groups_are_those_of_the_assessment(assessed, monkeypatch, capsys):
    given = {}

    def train_model(data, **options):
        given.update(options, data=data)
        raise DataSetError("Enough is known.")

    monkeypatch.setattr("servoscope.positioning.training.train", train_model)
    assert train(assessed, "--assessment", str(assessed / "run")) == 1
    assert "Enough is known." in capsys.readouterr().err
    pipeline = PosePipeline.load(assessed / "run" / "models" / "pipeline")
    found, data = given["assessment"], given["data"]
    assert data.split == "blocks"
    np.testing.assert_array_equal(found.pipeline.split_.test, pipeline.split_.test)
    np.testing.assert_array_equal(found.pipeline.split_.learned, pipeline.split_.learned)
    np.testing.assert_array_equal(found.groups, independent_groups(data).labels)
    assert not set(found.groups[found.pipeline.split_.test]) & set(
        found.groups[found.pipeline.split_.learned]
    )
    written = json.loads((assessed / "run" / "assessment.json").read_text())
    assert found.record["fingerprint"] == data.fingerprint()
    assert found.record["loop"] == written["loop"]
    for dof, row in found.record["dofs"].items():
        assert row["recipe"]["features"] == "moments"
        for name in ("forecast_rms", "reached_rms", "one_look", "loop", "view_limit"):
            assert row[name] == written["dofs"][dof][name]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--assessment", "RUN"], "RUN is an assessment of another data set"),
        (["--assessment", "RUN", "--add", "DATA"], "--assessment is of one data set"),
        (["--assessment", "DATA"], "is not a run folder"),
        (["--assessment", "NOWHERE"], "is not a run folder"),
    ],
)
def test_an_assessment_of_something_else_is_refused_in_one_line(
    assessed, tmp_path, capsys, options, said
):
    data = in_order()
    replace(data, images=255 - data.images).save(tmp_path / "data")
    places = {"RUN": assessed / "run", "DATA": tmp_path / "data", "NOWHERE": tmp_path / "nowhere"}
    assert train(tmp_path, *(str(places.get(option, option)) for option in options)) == 1
    err = [line for line in capsys.readouterr().err.splitlines() if "sequence" not in line]
    assert said.replace("RUN", str(places["RUN"])) in err[-1]
    assert not (tmp_path / "model").exists()


def without(*names):
    def damage(run):
        for name in names:
            shutil.rmtree(run / name) if (run / name).is_dir() else (run / name).unlink()

    return damage


def changed(**values):
    def damage(run):
        written = json.loads((run / "assessment.json").read_text())
        (run / "assessment.json").write_text(json.dumps(written | values))

    return damage


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (without("assessment.json"), "not a finished run of assess"),
        (without("models"), "holds no models/pipeline"),
        (without("models/pipeline/arrays.npz"), "arrays.npz"),
        (changed(dofs={}), "is damaged"),
        (changed(dofs=3), "is damaged"),
        (lambda run: (run / "assessment.json").write_text("{"), "assessment.json"),
    ],
)
def test_a_damaged_assessment_is_refused_in_one_line(assessed, tmp_path, damage, said):
    run = tmp_path / "run"
    shutil.copytree(assessed / "run", run)
    damage(run)
    data = mark_sequence(PoseImageSet.load(assessed / "data"))
    with pytest.raises(Exception, match=said) as caught:
        read_assessment(run, data)
    assert "servoscope.errors" in type(caught.value).__module__
    assert "\n" not in str(caught.value)


def test_dofs_are_those_of_the_assessment(assessed, tmp_path, monkeypatch, capsys):
    given = []

    def train_model(data, **_):
        given.append(data.dofs)
        raise DataSetError("Enough is known.")

    monkeypatch.setattr("servoscope.positioning.training.train", train_model)
    pipeline = PosePipeline.load(assessed / "run" / "models" / "pipeline")
    for dof in ("ty", "tz", "rx", "ry"):
        del pipeline.regressors_[dof]
    monkeypatch.setattr(
        "servoscope.commands.train.read_assessment",
        lambda *_: Assessed(pipeline, np.arange(80), {}),
    )
    options = ["--assessment", str(assessed / "run")]
    assert train(assessed, *options) == train(assessed, *options, "--dofs", "rz,tx") == 1
    assert given == [("tx", "rz")] * 2
    assert train(assessed, *options, "--dofs", "tx,ty") == 1
    assert "assessment of tx, rz, but --dofs asks for tx, ty" in capsys.readouterr().err
    assert len(given) == 2
