"""Packages that add features, regressors, robots and formats: the one of docs/plugins.md."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.cli import main
from servoscope.data.images import PoseImageSet
from servoscope.errors import PluginError, ServoscopeWarning
from servoscope.features.catalogue import FAMILIES, parse_families
from servoscope.pipeline import PosePipeline
from servoscope.regression import REGRESSORS
from servoscope.robots.devices import open_camera

PAGE = Path(__file__).parents[1] / "docs" / "plugins.md"
FENCED = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def install(folder: Path, code: str, groups: dict[str, dict[str, str]], package="acme-vision"):
    """Lay down a distribution as pip would, so that it is found on the path."""
    module = package.replace("-", "_")
    (folder / f"{module}.py").write_text(code)
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines))


def run(path: Path, *arguments: str) -> subprocess.CompletedProcess:
    environment = os.environ | {"PYTHONPATH": str(path)}
    command = [sys.executable, "-m", "servoscope", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def acme(tmp_path_factory) -> Path:
    """The package of the page."""
    folder = tmp_path_factory.mktemp("site")
    blocks = FENCED.findall(PAGE.read_text(encoding="utf-8"))
    code = "\n\n".join(text for kind, text in blocks if kind == "python")
    (points,) = (tomllib.loads(text) for kind, text in blocks if kind == "toml")
    install(folder, code, points["project"]["entry-points"])
    return folder


@pytest.mark.slow
@pytest.mark.filterwarnings("default::servoscope.errors.ServoscopeWarning")
def test_the_page_adds_one_of_each_on_the_command_line(acme, tmp_path, monkeypatch, capsys):
    data = planar_data_set(64, 16)
    images = np.concatenate([data.reference_image[None], data.images])
    poses = np.concatenate([data.T_world_ref[None], data.T_world_cam])
    np.savez(tmp_path / "shots.npz", images=images, T_world_cam=poses)
    shots, cell = str(tmp_path / "shots.npz"), str(tmp_path / "cell")
    done = run(acme, "import", "npz", shots, cell, "--pivot-mm", "550")
    assert (done.returncode, done.stderr.count("\n")) == (0, 0) or done.returncode == 0
    np.testing.assert_array_equal(PoseImageSet.load(Path(cell)).images, data.images)

    monkeypatch.syspath_prepend(str(acme))
    begun = "servoscope.assessment.run.begin_view"  # a keyframe is no plug-in
    monkeypatch.setattr(begun, lambda *_, **__: iter([(None, [])]))
    options = ["--families", "moments,brightness", "--regressor", "linear", "--jobs", "1", "--json"]
    assert main(["assess", cell, *options, "--out", str(tmp_path / "run")]) == 0
    told = json.loads(capsys.readouterr().out)
    assert set(told["assessed"]["families"]) == {"moments", "brightness"}
    pipeline = PosePipeline.load(tmp_path / "run" / "models" / "pipeline")
    assert {one.recipe.regressor for one in pipeline.regressors_.values()} == {"linear"}
    assert np.isfinite(pipeline.predict(data.images[:3])).all()

    model = str(tmp_path / "model")
    options = ["--assessment", str(tmp_path / "run"), "--method", "features", "--out", model]
    assert main(["train", cell, *options, "--jobs", "1", "--json"]) == 0
    trained = json.loads(capsys.readouterr().out)["accuracy"]["pipeline"]["dofs"]
    assert {one["recipe"]["regressor"] for one in trained.values()} == {"linear"}
    main(["position", model, "--robot", f"recorded:{cell}", "--start", "0", "--json"])
    assert json.loads(capsys.readouterr().out)["steps"][0]["stage"] == "features"

    options = ["--robot", "stepper", "--n-images", "2", "--image-size", "32", "--jobs", "1"]
    assert main(["acquire", str(tmp_path / "steps"), "--part", "textured_plane", *options]) == 0
    told = PoseImageSet.load(tmp_path / "steps").T_world_cam[:, :3, 3]
    np.testing.assert_allclose(told, np.round(told, 4), atol=1e-12)


def test_plug_ins_are_found_by_name_and_loaded_when_asked_for(acme, monkeypatch):
    assert "brightness" not in FAMILIES
    monkeypatch.syspath_prepend(str(acme))
    assert "brightness" in FAMILIES
    assert list(FAMILIES)[-1] == "brightness"
    assert not FAMILIES["brightness"].is_learned
    assert "linear" in REGRESSORS
    assert (open_camera("grey:128").read() == 128).all()
    assert parse_families("all")[-1] == "brightness"


@pytest.mark.parametrize(
    ("code", "value", "said"),
    [
        ("import nowhere_to_be_found", "broken_one:Features", "ModuleNotFoundError: No module"),
        ("", "broken_one:Features", "AttributeError"),
        ("Features = 3", "broken_one:Features", "must have fit and transform"),
    ],
)
def test_a_broken_plug_in_is_one_line_that_names_its_package(
    tmp_path, monkeypatch, code, value, said
):
    install(tmp_path, code, {"servoscope.features": {"broken": value}}, "broken-one")
    monkeypatch.syspath_prepend(str(tmp_path))
    sys.modules.pop("broken_one", None)
    with pytest.raises(PluginError, match=r"of the package broken-one 1\.0 cannot") as raised:
        FAMILIES["broken"]
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert FAMILIES["moments"].title == "geometric moments"
    with pytest.warns(ServoscopeWarning, match="^Left out: The plug-in 'broken'"):
        assert "broken" not in parse_families("all")


def test_a_name_that_is_built_in_is_refused(tmp_path, monkeypatch):
    install(tmp_path, "", {"servoscope.features": {"moments": "usurper:Features"}}, "usurper")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(PluginError, match=r"package usurper 1\.0 adds 'moments'.*already; rename"):
        FAMILIES["moments"]


def test_a_broken_format_fails_alone(tmp_path):
    install(tmp_path, "1 / 0", {"servoscope.formats": {"odd": "odd_one:ODD"}}, "odd-one")
    done = run(tmp_path, "import", "odd", "here", str(tmp_path / "out"), "--reference", "a")
    assert done.returncode == 1
    assert "package odd-one 1.0 cannot be loaded (ZeroDivisionError" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert run(tmp_path, "import", "folder", "--help").returncode == 0
