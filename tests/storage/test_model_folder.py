"""Models on disk: they come back as they were, and replace nothing that they should not."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from model_samples import CONTENT, HEADER, assert_as_written
from servoscope import __version__
from servoscope.errors import FolderExistsError, InvalidInputError, ModelError, ServoscopeError
from servoscope.storage import model_folder
from servoscope.storage.model_folder import (
    ARRAYS,
    MODEL,
    VERSION,
    check_free,
    is_model,
    read_model,
    read_version,
    write_model,
)


@pytest.fixture
def model(tmp_path):
    write_model(tmp_path / "model", HEADER, CONTENT)
    return tmp_path / "model"


def test_a_model_comes_back_as_it_was(model):
    assert_as_written(read_model(model))
    assert sorted(p.name for p in model.iterdir()) == [ARRAYS, MODEL]
    assert read_version(model) == (VERSION, __version__)
    assert read_model(model)[1]["coarse/tx.weights"].flags.writeable


def test_arrays_in_any_order_of_axes_and_slices_come_back(tmp_path):
    a = np.arange(24.0).reshape(2, 3, 4)
    arrays = {"turned": a.T, "fortran": np.asfortranarray(a), "slice": a[:, ::2, 1:]}
    write_model(tmp_path / "model", {}, arrays)
    for name, array in read_model(tmp_path / "model")[1].items():
        np.testing.assert_array_equal(array, arrays[name])


def test_numpy_and_a_zip_reader_open_the_arrays(model):
    with np.load(model / ARRAYS, allow_pickle=False) as loaded:
        assert set(loaded) == CONTENT.keys()
        np.testing.assert_array_equal(loaded["columns"], CONTENT["columns"])


def test_equal_models_have_equal_bytes(model, tmp_path):
    write_model(tmp_path / "again", HEADER, CONTENT)
    for part in (MODEL, ARRAYS):
        assert (tmp_path / "again" / part).read_bytes() == (model / part).read_bytes()


def test_a_model_is_replaced_by_force_only(model):
    with pytest.raises(FolderExistsError, match="holds a model already"):
        write_model(model, {"new": 1}, {})
    assert_as_written(read_model(model))
    write_model(model, {"new": 1}, {}, force=True)
    assert read_model(model) == ({"new": 1}, {})
    assert [p.name for p in model.parent.iterdir()] == ["model"]


@pytest.mark.parametrize(
    ("files", "match"),
    [
        ({"thesis.tex": "all of it"}, "holds 'thesis.tex', which is no part of a model"),
        ({MODEL: '{"class_name": "Sequential"}'}, "holds no whole model"),
        ({MODEL: "{"}, "holds no whole model"),
        ({ARRAYS: ""}, "holds no whole model"),
    ],
)
def test_what_is_not_a_model_is_never_replaced(tmp_path, files, match):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(FolderExistsError, match=match):
        write_model(tmp_path, {}, {}, force=True)
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == files


def test_what_lies_beside_a_model_is_kept(model):
    (model / "notes.txt").write_text("dear")
    with pytest.raises(FolderExistsError, match=r"notes\.txt"):
        write_model(model, {}, {}, force=True)
    assert (model / "notes.txt").exists()
    assert_as_written(read_model(model))


def test_a_file_is_no_place_for_a_model(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FolderExistsError, match="is a file"):
        check_free(tmp_path / "file", force=True)


class KilledError(BaseException):
    pass


@pytest.mark.parametrize("n_done", range(6))
def test_a_kill_at_any_moment_leaves_the_old_or_the_new_model(model, monkeypatch, n_done):
    """The process ends before its n-th change to the disk, and nothing of it runs after."""
    done, dead = [], []

    def mortal(change):
        def call(*args, **kwargs):
            if dead or len(done) == n_done:
                dead.append(1)
                raise KilledError
            done.append(1)
            return change(*args, **kwargs)

        return call

    for where, name in (
        (Path, "mkdir"),
        (Path, "rename"),
        (model_folder, "write_arrays"),
        (model_folder, "write_text"),
    ):
        monkeypatch.setattr(where, name, mortal(getattr(where, name)))
    rmtree = shutil.rmtree
    monkeypatch.setattr(shutil, "rmtree", lambda *a, **k: None if dead else rmtree(*a, **k))
    try:
        write_model(model, {"new": 1}, {}, force=True)
    except KilledError:
        assert dead
    monkeypatch.undo()
    assert is_model(model)
    if dead:
        assert_as_written(read_model(model))
        with pytest.raises(FolderExistsError, match="holds a model already"):
            check_free(model)
    else:
        assert n_done == 5
        assert read_model(model) == ({"new": 1}, {})
    write_model(model, {"newer": 2}, {}, force=True)
    assert read_model(model) == ({"newer": 2}, {})
    assert [p.name for p in model.parent.iterdir()] == ["model"]


def test_a_failure_while_writing_leaves_the_old_model_and_nothing_else(model, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(model_folder, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        write_model(model, {}, {}, force=True)
    assert_as_written(read_model(model))
    assert [p.name for p in model.parent.iterdir()] == ["model"]


@pytest.mark.parametrize(
    ("header", "arrays", "match"),
    [
        ({"x": float("nan")}, {}, "must be JSON"),
        ({"x": {1, 2}}, {}, "must be JSON"),
        ({"x": "y" * 5_000_000}, {}, "may have 4194304 bytes"),
        ({}, {"x": np.array([None])}, "not of numbers"),
        ({}, {"x": np.array(["text"])}, "not of numbers"),
        ({}, {"x": np.zeros(2, ">f4")}, "not of numbers"),
        ({}, {"x": np.array([1.0, np.inf])}, "NaN or infinite"),
        ({}, {"../x": np.zeros(1)}, "cannot be called '../x'"),
        ({}, {"/x": np.zeros(1)}, "cannot be called"),
        ({}, {"": np.zeros(1)}, "cannot be called"),
        ({}, {"x": np.zeros((1,) * 9)}, "9 axes"),
        ({}, {"x": np.broadcast_to(np.uint8(0), (2**31 + 1,))[:1], "y": np.zeros((1,) * 9)}, "9"),
    ],
)
def test_what_a_model_cannot_hold_is_refused_and_nothing_is_written(
    tmp_path, header, arrays, match
):
    with pytest.raises(InvalidInputError, match=match):
        write_model(tmp_path / "model", header, arrays)
    assert not list(tmp_path.iterdir())


def test_a_link_to_a_whole_folder_is_followed(model, tmp_path):
    (tmp_path / "best").symlink_to(model)
    assert_as_written(read_model(tmp_path / "best"))
    write_model(tmp_path / "best", {"new": 1}, {}, force=True)
    assert (tmp_path / "best").is_symlink()
    assert read_model(model) == ({"new": 1}, {})


def test_a_model_error_is_of_this_package_and_a_value_error():
    assert issubclass(ModelError, ServoscopeError)
    assert issubclass(ModelError, ValueError)
