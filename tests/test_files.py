import json

import numpy as np
import pytest

from servoscope.storage.folders import write_arrays, write_atomically, write_json, write_text


def test_text_is_written_as_utf8(tmp_path):
    write_text(tmp_path / "a.txt", "5 µm\n")
    assert (tmp_path / "a.txt").read_bytes() == "5 µm\n".encode()
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def fail_in_the_middle(file):
    file.write(b"half of")
    raise OSError(28, "No space left on device")


def test_a_failure_in_the_middle_leaves_the_old_file_and_no_temporary(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, fail_in_the_middle)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_an_interruption_leaves_nothing(tmp_path):
    def interrupt(file):
        file.write(b"half of")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "a.txt", interrupt)
    assert list(tmp_path.iterdir()) == []


def test_a_reader_sees_the_old_file_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    seen = []
    write_atomically(path, lambda file: (file.write(b"new"), seen.append(path.read_text())))
    assert seen == ["old"]
    assert path.read_text() == "new"


def test_numpy_values_become_plain_json(tmp_path):
    value = {"a": np.arange(3), "b": np.float64(0.5), "c": [np.int64(2)], "d": None}
    write_json(tmp_path / "a.json", value)
    plain = {"a": [0, 1, 2], "b": 0.5, "c": [2], "d": None}
    assert json.loads((tmp_path / "a.json").read_text()) == plain


@pytest.mark.parametrize("value", [float("nan"), np.inf, np.array([1.0, np.nan])])
def test_json_that_no_strict_reader_takes_is_refused_and_the_old_file_kept(tmp_path, value):
    write_json(tmp_path / "a.json", 1)
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"x": value})
    assert (tmp_path / "a.json").read_text() == "1\n"


def test_what_json_has_no_place_for_is_refused(tmp_path):
    with pytest.raises(TypeError, match="set has no place in a JSON file"):
        write_json(tmp_path / "a.json", {"x": {1, 2}})


def test_arrays_come_back_without_pickle(tmp_path):
    arrays = {"x": np.arange(5.0), "names": np.array(["theta_150", "e_07"])}
    write_arrays(tmp_path / "a.npz", arrays)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as loaded:
        assert sorted(loaded) == ["names", "x"]
        for name, array in arrays.items():
            np.testing.assert_array_equal(loaded[name], array)


def test_arrays_of_objects_are_refused(tmp_path):
    with pytest.raises(TypeError, match="cannot be written without pickle"):
        write_arrays(tmp_path / "a.npz", {"x": np.array([None, {}])})
    assert list(tmp_path.iterdir()) == []
