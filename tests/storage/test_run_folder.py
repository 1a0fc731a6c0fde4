import json
from pathlib import Path

import pytest

from servoscope.errors import FolderExistsError, FolderInUseError, RunFolderError
from servoscope.storage.run_folder import (
    is_run,
    open_run_folder,
    owned_run_folder,
    read_arrays,
    read_settings,
)


def test_a_finished_stage_is_not_done_again_for_the_same_inputs(tmp_path):
    done = []
    for inputs in ({"seed": 0}, {"seed": 0}, {"seed": 1}):
        run = open_run_folder(tmp_path / "run", {}, resume=True)
        run.run_stage("features", inputs, lambda inputs=inputs: done.append(inputs["seed"]))
    assert done == [0, 1]


def test_a_stage_that_failed_is_done_again(tmp_path):
    run = open_run_folder(tmp_path / "run", {})
    with pytest.raises(KeyboardInterrupt):
        run.run_stage("features", 0, lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    done = []
    run.run_stage("features", 0, lambda: done.append(1))
    assert done == [1]


def test_a_stage_that_is_redone_and_fails_is_not_finished_any_more(tmp_path):
    run = open_run_folder(tmp_path / "run", {})
    run.run_stage("features", "old", lambda: None)
    with pytest.raises(OSError, match="disk"):
        run.run_stage("features", "new", lambda: (_ for _ in ()).throw(OSError("disk")))
    done = []
    run.run_stage("features", "old", lambda: done.append(1))
    assert done == [1]


def test_timings_add_up_to_their_total(tmp_path):
    run = open_run_folder(tmp_path / "run", {})
    run.run_stage("a", 0, lambda: None)
    run.run_stage("b", 0, lambda: None)
    timings = run.timings()
    assert timings.keys() == {"a", "b", "total"}
    assert timings["total"] == pytest.approx(timings["a"] + timings["b"])


def test_a_run_is_not_overwritten_unasked(tmp_path):
    open_run_folder(tmp_path / "run", {"seed": 0})
    with pytest.raises(FolderExistsError, match=r"--resume.*--force"):
        open_run_folder(tmp_path / "run", {"seed": 0})


def test_a_run_resumes_only_with_its_own_settings(tmp_path):
    open_run_folder(tmp_path / "run", {"seed": 0, "protocols": ("paper",)})
    open_run_folder(tmp_path / "run", {"seed": 0, "protocols": ("paper",)}, resume=True)
    with pytest.raises(RunFolderError, match="made with seed 0, not 1"):
        open_run_folder(tmp_path / "run", {"seed": 1, "protocols": ("paper",)}, resume=True)


def test_what_differs_is_named_to_the_depth_where_it_does(tmp_path):
    made = {"command": "study", "acquisition": {"n_images": 9, "part": "head"}}
    open_run_folder(tmp_path / "run", made)
    others = {**made, "acquisition": {"n_images": 8, "part": "head"}}
    with pytest.raises(RunFolderError, match="made with n_images 9, not 8; repeat"):
        open_run_folder(tmp_path / "run", others, resume=True)
    with pytest.raises(RunFolderError, match="made by 'study', not 'assess'; name another folder"):
        open_run_folder(tmp_path / "run", {**made, "command": "assess"}, resume=True)


def test_force_removes_the_run_and_nothing_else(tmp_path):
    run = open_run_folder(tmp_path / "run", {"seed": 0})
    (run.path / "models").mkdir()
    (run.path / "models" / "paper_pivot.npz").write_text("old")
    (run.path / "notes.txt").write_text("mine")
    with owned_run_folder(run.path, {"seed": 1}, force=True):
        pass
    assert sorted(p.name for p in run.path.iterdir()) == ["config.json", "notes.txt"]
    assert read_settings(run.path) == {"seed": 1}


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_of_somebody_else_is_left_alone(tmp_path, force):
    (tmp_path / "config.json").write_text('{"mine": 1}')
    (tmp_path / "models").mkdir()
    with (
        pytest.raises(FolderExistsError, match="not a run folder"),
        owned_run_folder(tmp_path, {}, force=force),
    ):
        pass
    assert (tmp_path / "models").is_dir()


def test_a_run_of_another_version_is_refused(tmp_path):
    run = open_run_folder(tmp_path / "run", {})
    config = json.loads((run.path / "config.json").read_text())
    (run.path / "config.json").write_text(json.dumps(config | {"version": 99}))
    assert is_run(run.path)
    with pytest.raises(RunFolderError, match=r"version 99, this servoscope reads version 1"):
        open_run_folder(run.path, {}, resume=True)


def damaged_run(path):
    run = open_run_folder(path, {"seed": 0})
    run.run_stage("features", 0, lambda: None)
    (path / "config.json").write_text("{")
    return run


def test_a_damaged_config_is_named_and_may_be_replaced(tmp_path):
    run = damaged_run(tmp_path / "run")
    with pytest.raises(RunFolderError, match=r"config\.json cannot be read"):
        open_run_folder(run.path, {"seed": 0}, resume=True)
    with owned_run_folder(run.path, {"seed": 1}, force=True):
        pass
    assert read_settings(run.path) == {"seed": 1}


def test_a_stage_whose_output_is_gone_is_done_again(tmp_path):
    run = open_run_folder(tmp_path / "run", {})
    made = run.path / "features.npz"
    done = []

    def make():
        done.append(1)
        made.write_text("features")

    for _ in range(2):
        run.run_stage("features", 0, make, ["features.npz"])
    made.unlink()
    run.run_stage("features", 0, make, ["features.npz"])
    assert len(done) == 2


def test_a_stage_with_a_damaged_record_is_done_again(tmp_path):
    run = open_run_folder(tmp_path / "run", {})
    done = []
    run.run_stage("features", 0, lambda: done.append(1))
    (run.path / "stages" / "features.json").write_text("")
    run.run_stage("features", 0, lambda: done.append(2))
    assert done == [1, 2]


def replaced_until_it_fails(path):
    """A finished run, and what is done of another one that shall replace it."""
    with owned_run_folder(path, {"seed": 0}) as run:
        run.run_stage("features", 0, lambda: (run.path / "features.npz").write_text("old"))
    with pytest.raises(OSError, match="disk"):
        replace_and_fail(path)


def replace_and_fail(path):
    with owned_run_folder(path, {"seed": 1}, force=True) as new:
        new.run_stage("features", 0, lambda: (new.path / "features.npz").write_text("new"))
        raise OSError("disk full")


def test_a_replacement_that_fails_leaves_the_run_as_it_was(tmp_path):
    replaced_until_it_fails(tmp_path / "run")
    assert read_settings(tmp_path / "run") == {"seed": 0}
    assert (tmp_path / "run" / "features.npz").read_text() == "old"
    with owned_run_folder(tmp_path / "run", {"seed": 0}, resume=True) as run:
        run.run_stage("features", 0, lambda: pytest.fail("it was finished"))


def test_a_replacement_that_failed_is_resumed(tmp_path):
    replaced_until_it_fails(tmp_path / "run")
    with owned_run_folder(tmp_path / "run", {"seed": 1}, resume=True) as run:
        run.run_stage("features", 0, lambda: pytest.fail("it was finished"))
    assert read_settings(tmp_path / "run") == {"seed": 1}
    assert (tmp_path / "run" / "features.npz").read_text() == "new"
    assert sorted(p.name for p in run.path.parent.iterdir()) == [
        "config.json",
        "features.npz",
        "stages",
    ]


def test_force_begins_a_replacement_afresh(tmp_path):
    replaced_until_it_fails(tmp_path / "run")
    done = []
    with owned_run_folder(tmp_path / "run", {"seed": 1}, force=True) as run:
        run.run_stage("features", 0, lambda: done.append(1))
    assert done == [1]


def test_a_run_has_one_owner(tmp_path):
    with (
        owned_run_folder(tmp_path / "run", {}),
        pytest.raises(FolderInUseError, match="run is being written by another command"),
        owned_run_folder(tmp_path / "run", {}, resume=True),
    ):
        pass


def test_what_a_killed_write_left_does_not_stand_in_the_way(tmp_path):
    (tmp_path / ".config.json.123.part").write_text("{")
    open_run_folder(tmp_path, {"seed": 0})
    assert [p.name for p in tmp_path.iterdir()] == ["config.json"]


def test_lost_arrays_get_one_piece_of_advice(tmp_path):
    with pytest.raises(RunFolderError) as caught:
        read_arrays(tmp_path / "features.npz", ["names"])
    path = tmp_path / "features.npz"
    assert str(caught.value) == (
        f"features.npz is damaged: {path} is missing; make the run again with --force."
    )


def test_a_replacement_that_was_interrupted_is_completed_by_who_reads(tmp_path, monkeypatch):
    open_run_folder(tmp_path / "run", {"seed": 0})
    rename = Path.rename

    def rename_until_the_new_enters(path, target):
        if path.name == ".servoscope-whole":
            raise KeyboardInterrupt
        return rename(path, target)

    def replace():
        with owned_run_folder(tmp_path / "run", {"seed": 1}, force=True):
            monkeypatch.setattr(Path, "rename", rename_until_the_new_enters)

    with pytest.raises(KeyboardInterrupt):
        replace()
    monkeypatch.undo()
    assert not (tmp_path / "run" / "config.json").exists()
    assert is_run(tmp_path / "run")
    assert read_settings(tmp_path / "run") == {"seed": 1}


def test_damaged_arrays_are_named(tmp_path):
    (tmp_path / "features.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(RunFolderError, match=r"features\.npz is damaged.*--force"):
        read_arrays(tmp_path / "features.npz", ["names"])
