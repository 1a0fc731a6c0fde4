import json
from dataclasses import replace

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.data.independence import split_data
from servoscope.poses import DISPLACEMENTS, DOFS
from servoscope.selection import mutual_information
from servoscope.storage.run_folder import open_run_folder
from servoscope.study import Study, StudyConfig

N_IMAGES = 160
QUICK = StudyConfig(hidden=1, restarts=1, n_thresholds=3)


def finished_study(data, folder) -> Study:
    study = Study(open_run_folder(folder, {}), data, QUICK, n_jobs=1)
    study.run()
    return study


def results(study) -> dict:
    return json.loads((study.folder.path / "summary.json").read_text())["protocols"]


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> Study:
    return finished_study(planar_data_set(N_IMAGES), tmp_path_factory.mktemp("study") / "run")


@pytest.fixture(scope="module")
def other_held_out(study, tmp_path_factory) -> Study:
    """The study of the same training images, with others that decide and test."""
    data, other = study.data, planar_data_set(N_IMAGES, seed=7)
    split = study.split("honest")
    held_out = np.concatenate([split.validation, split.test])
    images, poses = data.images.copy(), data.T_world_cam.copy()
    images[held_out], poses[held_out] = other.images[held_out], other.T_world_cam[held_out]
    data = replace(data, images=images, T_world_cam=poses)
    return finished_study(data, tmp_path_factory.mktemp("study") / "run")


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
def test_honest_selection_knows_nothing_of_the_images_held_out(study, other_held_out, displacement):
    before, after = (results(s)["honest"][displacement] for s in (study, other_held_out))
    for chosen in ("mi", "mi_null_level", "ranking", "table2", "stability"):
        assert after[chosen] == before[chosen]
    for dof in DOFS:
        subsets, others = (
            [(point["thresholds"], point["n_features"]) for point in unit["sweep"][dof]]
            for unit in (before, after)
        )
        assert others == subsets
    assert after["table1"] != before["table1"]


def test_the_papers_selection_sees_the_images_that_test(study, other_held_out):
    before, after = (results(s)["paper"]["pivot"] for s in (study, other_held_out))
    # Moments are of one image each: only the images that are assessed can change theirs.
    assert after["mi"]["m00_50"] != before["mi"]["m00_50"]
    assert after["ranking"] != before["ranking"]


@pytest.mark.parametrize("displacement", DISPLACEMENTS)
@pytest.mark.parametrize("protocol", ["paper", "honest"])
def test_information_is_of_all_images_for_the_paper_and_else_of_those_that_train(
    study, protocol, displacement
):
    samples = slice(None) if protocol == "paper" else study.split("honest").train
    X = study.tables[protocol, displacement].values[samples, :65]
    Y = study.data.delta_p(displacement)[samples]
    unit = results(study)[protocol][displacement]
    reported = [[row[dof] for dof in DOFS] for row in unit["mi"].values()]
    np.testing.assert_allclose(reported, mutual_information(X, Y), atol=1e-12)
    assert unit["mi_null_level"] == pytest.approx(81 / (2 * len(X) * np.log(2)))


def test_the_paper_trains_on_75_percent_and_decides_on_the_images_that_test(study):
    split = study.split("paper")
    assert len(split.train) == 0.75 * N_IMAGES
    np.testing.assert_array_equal(split.validation, split.test)
    assert np.sort(np.concatenate([split.train, split.test])).tolist() == list(range(N_IMAGES))


def test_both_protocols_test_on_the_same_images(study):
    paper, honest = study.split("paper"), study.split("honest")
    np.testing.assert_array_equal(paper.test, honest.test)
    np.testing.assert_array_equal(
        paper.train, np.sort(np.concatenate([honest.train, honest.validation]))
    )


def test_only_the_honest_protocol_decides_by_other_errors_than_it_reports(study):
    points = {
        protocol: [
            point for unit in forms.values() for sweep in unit["sweep"].values() for point in sweep
        ]
        for protocol, forms in results(study).items()
    }
    assert all(point["validation_rms"] == point["rms"] for point in points["paper"])
    assert all(point["validation_rms"] != point["rms"] for point in points["honest"])


@pytest.mark.parametrize("protocol", ["paper", "honest"])
def test_shots_of_one_pose_are_in_one_part(protocol):
    data = planar_data_set(40)
    often = np.repeat(np.arange(40), 3)
    data = replace(data, images=data.images[often], T_world_cam=data.T_world_cam[often], names=())
    split = split_data(data, protocol, 0)
    assert not set(often[split.train]) & set(often[split.test])
