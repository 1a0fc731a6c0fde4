from dataclasses import replace

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.poses import DOFS
from servoscope.selection import CRITERIA, MutualInfoSelector
from servoscope.storage.run_folder import open_run_folder
from servoscope.study import Study, StudyConfig, criteria
from servoscope.study.criteria import UNIT, compare_criteria
from servoscope.study.information import CANDIDATES
from servoscope.study.networks import subset_recipe, train_nets

SIZES = (2, 3)
QUICK = StudyConfig(hidden=2, restarts=1, n_thresholds=3, protocols=("honest",))


def finished(data, folder):
    study = Study(open_run_folder(folder, {}), data, QUICK, n_jobs=1)
    study.run()
    return study


@pytest.fixture(scope="module", autouse=True)
def few_sizes():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(criteria, "SIZES", SIZES)
        yield


@pytest.fixture(scope="module")
def study(plane, tmp_path_factory):
    return finished(plane, tmp_path_factory.mktemp("criteria") / "run")


@pytest.fixture(scope="module")
def compared(study):
    return compare_criteria(study)


def test_every_criterion_has_an_error_for_every_dof_and_size(compared):
    assert tuple(compared["errors"]) == tuple(CRITERIA)
    for by_dof in compared["errors"].values():
        assert tuple(by_dof) == DOFS
        assert all(len(errors) == len(SIZES) for errors in by_dof.values())


def test_every_criterion_selects_on_the_images_that_train(study, compared):
    table, train = study.tables[UNIT], study.split("honest").train
    X, y = table.values[np.ix_(train, table.columns(CANDIDATES))], study.targets("pivot")[train, 4]
    for name in set(CRITERIA) - {"forecast"}:
        order = MutualInfoSelector(max(SIZES), name).fit(X, y).ranking_
        assert compared["selected"][name]["ry"] == [table.names[i] for i in order]


def test_errors_are_those_of_test_images(study, compared):
    table, split = study.tables[UNIT], study.split("honest")
    columns = [table.names.index(name) for name in compared["selected"]["jmi"]["rx"][:3]]
    targets = study.targets("pivot")
    job = (subset_recipe(table, np.sort(columns)), "rx")
    (net,) = train_nets(table, targets, split, [job], QUICK, n_jobs=1)
    predicted = net.regressor.predict(table.values[np.ix_(split.test, net.columns)])
    expected = np.sqrt(np.mean((predicted - targets[split.test, 3]) ** 2))
    assert compared["errors"]["jmi"]["rx"][SIZES.index(3)] == pytest.approx(expected, rel=1e-9)


def test_the_stage_is_done_once(study, compared, monkeypatch):
    monkeypatch.setattr(criteria, "_compare", lambda _: pytest.fail("done again"))
    assert compare_criteria(study) == compared


@pytest.fixture
def only_jmi(monkeypatch):
    monkeypatch.setattr(criteria, "CRITERIA", {"jmi": CRITERIA["jmi"]})


@pytest.mark.usefixtures("only_jmi")
def test_the_number_of_processes_makes_no_difference(study, compared):
    in_two = Study(study.folder, study.data, QUICK, n_jobs=2)
    candidates = [study.tables[UNIT].names[i] for i in study.tables[UNIT].columns(CANDIDATES)]
    orders = criteria._rank(in_two)
    assert set(orders) == {("jmi", dof) for dof in DOFS}
    for (_, dof), order in orders.items():
        assert [candidates[i] for i in order] == compared["selected"]["jmi"][dof]


def test_a_study_without_the_honest_protocol_is_not_compared(plane, tmp_path):
    config = replace(QUICK, protocols=("paper",))
    study = Study(open_run_folder(tmp_path / "run", {}), plane, config)
    assert compare_criteria(study) is None


@pytest.mark.usefixtures("only_jmi")
def test_dofs_that_never_move_are_left_out(tmp_path):
    data = planar_data_set()
    poses = data.T_world_cam.copy()
    poses[:, 2, 3] = data.T_world_ref[2, 3]
    poses[:, :3, :3] = data.T_world_ref[:3, :3]
    compared = compare_criteria(finished(replace(data, T_world_cam=poses), tmp_path / "run"))
    for by_dof in (*compared["errors"].values(), compared["all_candidates"]):
        assert list(by_dof) == ["tx", "ty"]
    assert {pair["dof"] for pair in compared["forecasts"]} == {"tx", "ty"}


def test_nothing_is_compared_where_nothing_moves(tmp_path):
    data = planar_data_set()
    still = replace(data, T_world_cam=np.broadcast_to(np.eye(4), (150, 4, 4)))
    study = Study(open_run_folder(tmp_path / "run", {}), still, QUICK)
    assert compare_criteria(study) is None


def test_forecasts_stand_beside_what_the_study_reached(study, compared):
    results = criteria.read_json(study.folder.path / "models" / "honest_pivot.json")
    pairs = {(pair["features"], pair["dof"]): pair for pair in compared["forecasts"]}
    assert len(pairs) == len(compared["forecasts"]) == 4 * 6
    assert pairs["pca", "rz"]["reached"] == results["table1"]["pca"]["rz"]["rms"]
    assert pairs["selected", "tx"]["reached"] == results["table3"]["tx"]["rms"]
    assert all(0 < pair["forecast"] < 1 for pair in pairs.values())


@pytest.mark.parametrize(("split", "in_blocks"), [("random", False), ("blocks", True)])
def test_forecasts_leave_out_blocks_of_a_sequence(study, monkeypatch, split, in_blocks):
    left_out = []

    def forecast(X, y, groups):
        left_out.append(groups)
        return 0.1

    monkeypatch.setattr(criteria, "_forecast", forecast)
    other = Study(study.folder, replace(study.data, split=split), QUICK, n_jobs=1)
    criteria.compare_forecasts(other, UNIT)
    assert all((groups is not None) == in_blocks for groups in left_out)
    if in_blocks:
        train = other.split("honest").train
        assert len(left_out[0]) == len(train)
        np.testing.assert_array_equal(np.argsort(left_out[0], kind="stable"), np.arange(len(train)))
