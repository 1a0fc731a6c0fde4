import json
from dataclasses import replace

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.data.splits import split_images
from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLACEMENTS, DOFS
from servoscope.regression import LMRegressor
from servoscope.storage.run_folder import open_run_folder
from servoscope.study import Study, StudyConfig, check_data
from servoscope.study.paper import FAMILIES

QUICK = StudyConfig(hidden=2, restarts=1, n_thresholds=3)


def study_of(data, folder, config=QUICK, **options) -> Study:
    return Study(open_run_folder(folder, {}, resume=True), data, config, **options)


def results(folder) -> dict:
    """The summary without what a clock says."""
    summary = json.loads((folder / "summary.json").read_text())
    del summary["timings_s"]
    return summary


@pytest.fixture(scope="module")
def finished(plane, tmp_path_factory):
    """A finished study of the plane, in one process."""
    study = study_of(plane, tmp_path_factory.mktemp("study") / "run", n_jobs=1)
    study.run()
    return study


def test_the_summary_has_every_table_for_both_protocols_and_forms(finished):
    summary = results(finished.folder.path)
    assert summary["protocols"].keys() == {"paper", "honest"}
    for forms in summary["protocols"].values():
        assert forms.keys() == set(DISPLACEMENTS)
        for unit in forms.values():
            assert unit["table1"].keys() == set(FAMILIES)
            for row in (*unit["table1"].values(), unit["table3"], unit["baseline"]):
                assert row.keys() == set(DOFS)
            assert all(len(set(names)) == 24 for names in unit["table2"].values())
            assert len(unit["mi"]) == 65
            for dof, best in unit["table3"].items():
                assert best["n_features"] == len(best["features"])
                assert set(best["features"]) <= set(unit["table2"][dof])


def test_physical_errors_are_the_scaled_ones_times_the_range(finished, plane):
    forms = results(finished.folder.path)["protocols"]["honest"]
    for displacement, unit in forms.items():
        degrees = np.degrees(plane.ranges(displacement)[5])
        entry = unit["table1"]["gm"]["rz"]
        assert entry["unit"] == "deg"
        assert entry["physical"] == pytest.approx(entry["rms"] * degrees)
    assert forms["pivot"]["table1"]["gm"]["tx"]["unit"] == "mm"
    assert forms["camera"]["ranges"]["tx"]["value"] == pytest.approx(167.35, abs=0.01)


def test_the_baseline_is_the_spread_of_the_test_targets(finished, plane):
    split = finished.split("honest")
    targets = plane.delta_p()
    spread = targets[split.test] - targets[split.train].mean(axis=0)
    expected = 1e3 * np.sqrt(np.mean(spread[:, 0] ** 2))
    unit = results(finished.folder.path)["protocols"]["honest"]["pivot"]
    assert unit["baseline"]["tx"]["physical"] == pytest.approx(expected)


def test_saved_models_reach_the_errors_of_table_3(finished, plane):
    split = finished.split("honest")
    with np.load(finished.folder.path / "models" / "honest_pivot.npz") as arrays:
        saved = dict(arrays)
    features = finished.tables["honest", "pivot"].values[split.test]
    targets = plane.delta_p()[split.test] / plane.ranges()
    error = np.empty_like(targets)
    for i, dof in enumerate(DOFS):
        of_dof = {name[3:]: array for name, array in saved.items() if name.startswith(f"{dof}.")}
        net = LMRegressor.from_arrays(of_dof)
        error[:, i] = net.predict(features[:, of_dof["columns"]]) - targets[:, i]
    table3 = results(finished.folder.path)["protocols"]["honest"]["pivot"]["table3"]
    expected = [table3[dof]["rms"] for dof in DOFS]
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=0)), expected, rtol=1e-9)


def test_honest_features_do_not_depend_on_the_images_that_test(finished, plane, tmp_path):
    split = finished.split("honest")
    images = plane.images.copy()
    images[split.test] = planar_data_set(seed=7).images[split.test]
    study = study_of(replace(plane, images=images), tmp_path / "run")
    tables = study._tables_of(finished.tables["honest", "pivot"].values[:, :24], "honest")
    before = finished.tables["honest", "pivot"].values[split.train]
    np.testing.assert_array_equal(tables["honest", "pivot"][0].values[split.train], before)


def test_the_summary_is_the_same_for_any_number_of_processes(finished, plane, tmp_path):
    study_of(plane, tmp_path / "run", n_jobs=2).run()
    assert results(tmp_path / "run") == results(finished.folder.path)


def test_an_interrupted_study_ends_with_the_same_summary(finished, plane, tmp_path, monkeypatch):
    stages = ("_compute_features", "_assess", "_measure_chance", "_train")
    for stage in stages:
        make = getattr(Study, stage)

        def interrupted(self, *args, make=make):
            make(self, *args)
            raise KeyboardInterrupt

        monkeypatch.setattr(Study, stage, interrupted)
        with pytest.raises(KeyboardInterrupt):
            study_of(plane, tmp_path / "run", n_jobs=1).run()
        monkeypatch.undo()
        assert not (tmp_path / "run" / "summary.json").exists()
    study_of(plane, tmp_path / "run", n_jobs=1).run()
    assert results(tmp_path / "run") == results(finished.folder.path)


def test_a_second_run_does_nothing_again(finished, plane, monkeypatch):
    for stage in ("_compute_features", "_assess", "_measure_chance", "_train"):
        monkeypatch.setattr(Study, stage, lambda *_: pytest.fail("done again"))
    before = results(finished.folder.path)
    study_of(plane, finished.folder.path).run()
    assert results(finished.folder.path) == before


def test_another_seed_gives_another_split_and_other_results(finished, plane, tmp_path):
    config = StudyConfig(seed=1, hidden=4, restarts=1, n_thresholds=2, protocols=("honest",))
    study = study_of(plane, tmp_path / "run", config)
    assert not np.array_equal(study.split("honest").test, finished.split("honest").test)


def test_blocks_are_split_in_the_order_of_the_images_where_no_times_are_known(tmp_path):
    data = planar_data_set(split="blocks")
    split = study_of(data, tmp_path / "run").split("honest")
    assert np.mean(np.diff(split.train) == 1) > 0.8


def test_a_constant_dof_and_a_constant_feature_do_no_harm(tmp_path):
    moving = planar_data_set()
    still = replace(moving, T_world_cam=np.broadcast_to(np.eye(4), (150, 4, 4)))
    config = StudyConfig(hidden=2, restarts=1, n_thresholds=2, protocols=("honest",))
    study_of(still, tmp_path / "run", config, n_jobs=1).run()
    unit = results(tmp_path / "run")["protocols"]["honest"]["pivot"]
    assert unit["mi"]["theta_50"]["rz"] == 0
    assert unit["table1"]["gm"]["rz"]["rms"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("protocols", "least", "share"),
    [(("paper",), 115, "75%"), (("honest",), 144, "60%"), (("paper", "honest"), 144, "60%")],
)
def test_the_fewest_images_are_those_of_the_protocols_that_run(protocols, least, share):
    config = StudyConfig(protocols=protocols)
    check_data(planar_data_set(least), config)
    for protocol in protocols:
        assert len(split_images(least, protocol).train) > 85
    message = f"at least {least} images.*{share} that train.*got {least - 1}"
    with pytest.raises(InvalidInputError, match=message):
        check_data(planar_data_set(least - 1), config)


def test_too_few_images_are_refused_before_anything_is_computed(tmp_path):
    with pytest.raises(InvalidInputError, match=r"at least 144 images.*got 20"):
        study_of(planar_data_set(20), tmp_path / "run")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"protocols": ("fair",)}, "paper, honest, got .'fair'"),
        ({"restarts": 0}, "restarts must be at least 1, got 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        StudyConfig(**options)
