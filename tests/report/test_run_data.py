import json

import numpy as np
import pytest

from servoscope.errors import RunFolderError
from servoscope.files import write_arrays, write_json
from servoscope.report import read_run


def test_honest_protocol_and_pivot_form_come_first(run_folder):
    keys = [unit.key for unit in read_run(run_folder).units]
    assert keys == ["honest_pivot", "honest_camera", "paper_pivot", "paper_camera"]


def test_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(RunFolderError, match="is not a run folder"):
        read_run(tmp_path)


def test_unfinished_run_is_told_to_go_on(run_folder):
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
