import json

import numpy as np
import pytest

from servoscope.errors import RunFolderError
from servoscope.poses import DOFS
from servoscope.storage.folders import write_arrays, write_json
from servoscope.study.results import OF_CHANCE, list_units, mean_rms, moving_dofs, read_run
from servoscope.study.tables import errors_table


def test_honest_protocol_and_pivot_form_come_first(run_folder):
    keys = [unit.key for unit in read_run(run_folder).units]
    assert keys == ["honest_pivot", "honest_camera", "paper_pivot", "paper_camera"]


def test_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(RunFolderError, match="is not a run folder"):
        read_run(tmp_path)


def test_unfinished_run_can_be_resumed(run_folder):
    (run_folder / "summary.json").unlink()
    with pytest.raises(RunFolderError, match=r"not finished.*--resume"):
        read_run(run_folder)


@pytest.mark.parametrize("name", ["config.json", "summary.json"])
def test_other_version_is_refused(run_folder, name):
    value = json.loads((run_folder / name).read_text())
    write_json(run_folder / name, {**value, "version": 99})
    with pytest.raises(RunFolderError, match="version 99"):
        read_run(run_folder)


@pytest.mark.parametrize("name", ["features.npz", "selection.npz", "vectors/paper_camera.npz"])
@pytest.mark.parametrize("damage", ["cut", "gone", "not an archive"])
def test_damaged_arrays_are_named(run_folder, name, damage):
    path = run_folder / name
    content = path.read_bytes()
    path.unlink()
    if damage != "gone":
        path.write_bytes(content[: len(content) // 2] if damage == "cut" else b"nonsense")
    with pytest.raises(RunFolderError, match=rf"{path.name} is damaged.*--force") as caught:
        read_run(run_folder)
    assert "\n" not in str(caught.value)


def test_missing_array_is_named(run_folder):
    with np.load(run_folder / "features.npz") as file:
        kept = {name: file[name] for name in file.files if name != "delta_p_camera"}
    write_arrays(run_folder / "features.npz", kept)
    with pytest.raises(RunFolderError, match="delta_p_camera"):
        read_run(run_folder)


@pytest.mark.parametrize("key", ["table1", "table3", "baseline", "mi", "stability", "ranges"])
def test_summary_without_a_result_is_refused(run_folder, summary, key):
    del summary["protocols"]["paper"]["pivot"][key]
    write_json(run_folder / "summary.json", summary)
    with pytest.raises(RunFolderError, match=f"summary.json is damaged.*{key}"):
        read_run(run_folder)


@pytest.mark.parametrize("key", ["protocols", "dataset", "timings_s"])
def test_summary_of_another_shape_is_refused(run_folder, summary, key):
    write_json(run_folder / "summary.json", {**summary, key: []})
    with pytest.raises(RunFolderError, match=r"summary\.json is damaged"):
        read_run(run_folder)


def test_summary_without_protocols_is_refused(run_folder, summary):
    write_json(run_folder / "summary.json", {**summary, "protocols": {}})
    with pytest.raises(RunFolderError, match="no protocol"):
        read_run(run_folder)


@pytest.mark.parametrize("key", OF_CHANCE)
def test_run_that_holds_only_a_part_of_what_is_chance_is_damaged(run_folder, summary, key):
    del summary["protocols"]["paper"]["pivot"][key]
    write_json(run_folder / "summary.json", summary)
    with pytest.raises(RunFolderError, match=f"summary.json is damaged.*{key}.*--force") as caught:
        read_run(run_folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["sizes", "errors", "all_candidates", "forecasts"])
def test_comparison_without_a_part_is_damaged(run_folder, summary, compared, key):
    del compared[key]
    write_json(run_folder / "summary.json", {**summary, "criteria": compared})
    with pytest.raises(RunFolderError, match=f"summary.json is damaged.*{key}"):
        read_run(run_folder)


@pytest.fixture
def unit(summary):
    """A unit in which tz and rx never moved."""
    (unit, *_) = list_units(summary)
    for dof in ("tz", "rx"):
        unit.results["ranges"][dof]["value"] = None
        for row in (*unit.results["table1"].values(), unit.results["table3"]):
            row[dof] |= {"rms": 0.0, "physical": 0.0}
        unit.results["baseline"][dof] |= {"rms": 0.0, "physical": 0.0}
    return unit


def test_the_mean_is_of_the_dofs_that_moved(unit):
    assert moving_dofs(unit.results) == ["tx", "ty", "ry", "rz"]
    assert mean_rms(unit.results, unit.results["baseline"]) == pytest.approx(0.577)


def test_nothing_that_moved_has_no_error(unit):
    for dof in DOFS:
        unit.results["ranges"][dof]["value"] = None
    assert mean_rms(unit.results, unit.results["baseline"]) == 0.0
    assert errors_table(unit).rows[0][-1].beside == ""


def test_table1_marks_nothing_where_nothing_moved_and_averages_alike(unit):
    first = errors_table(unit).rows[0]
    assert [cell.text for cell in first[3:5]] == ["–", "–"]
    assert [cell.mark for cell in first[1:-1]] == ["best", "best", "", "", "best", "best"]
    assert first[-1].beside == f"({first[-1].value:.2f})"
