"""Models that were changed, or made to do harm, are refused in one line."""

import json
import os
import pickle
import zipfile

import numpy as np
import pytest

from model_samples import CONTENT, HEADER, assert_as_written, assert_refused
from servoscope.errors import ModelError
from servoscope.storage import model_folder
from servoscope.storage.model_folder import ARRAYS, MODEL, is_model, read_model, write_model


@pytest.fixture
def model(tmp_path):
    write_model(tmp_path / "model", HEADER, CONTENT)
    return tmp_path / "model"


def sign(model, **changes):
    """Change ``model.json`` as somebody would who knows how it is made."""
    values = json.loads((model / MODEL).read_text()) | changes
    values.pop("sha256", None)
    values["sha256"] = model_folder._digest(values)
    (model / MODEL).write_text(json.dumps(values))


def table_of(model):
    return json.loads((model / MODEL).read_text())["arrays"]


def test_missing_unfinished_and_other_folders_are_refused(tmp_path, model):
    assert_refused(tmp_path / "nowhere", "does not exist")
    assert_refused(model / MODEL, "is a file")
    (model / ARRAYS).unlink()
    assert_refused(model, r"arrays\.npz cannot be read \(.*No such file")
    (model / MODEL).unlink()
    assert_refused(model, r"has no model\.json")


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "Expecting value"),
        ("[1, 2]", "must hold a JSON object, got a list"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a":' * 100_000, "nested too deeply"),
        ('{"format": "servoscope model", "version": 1, "x": NaN}', "is not finite"),
        ('{"format": "servoscope model", "version": 1, "x": 1e999}', "is not finite"),
        (
            '{"format": "servoscope model", "version": 1, "x": %s}' % ("9" * 9999),
            "an integer has 9999 digits",
        ),
        ('{"format": "servoscope model", "version": true}', "version is True"),
        ('{"format": "servoscope model", "version": 1}', "has changed since"),
        (
            '{"format": "servoscope model", "version": "\\u001b[2J\\n"}',
            r"version is '\\x1b\[2J\\n'",
        ),
        ("{}", "not a model of servoscope"),
        (" " * 5_000_000, "more than 4194304 bytes"),
        ("\ud800", "utf-8"),
    ],
)
def test_a_bad_model_json_is_refused(model, text, match):
    (model / MODEL).write_bytes(text.encode("utf-8", "surrogatepass"))
    assert_refused(model, match)


def test_a_newer_model_says_who_wrote_it(model):
    sign(model, version=7, servoscope="3.1.4")
    assert_refused(model, r"version 7, written by servoscope '3\.1\.4'.*update it")


def test_changed_numbers_are_noticed(model):
    data = (model / ARRAYS).read_bytes()
    start = data.index(CONTENT["columns"].tobytes())
    changed = data[:start] + b"\x07" + data[start + 1 :]
    (model / ARRAYS).write_bytes(changed)
    assert_refused(model, "Bad CRC-32")
    with zipfile.ZipFile(model / ARRAYS, "w") as archive:
        for name, array in (CONTENT | {"columns": np.arange(5) + 1}).items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asarray(array))
    assert_refused(model, "bytes of 'columns' have changed")


def test_a_changed_header_is_noticed(model):
    text = (model / MODEL).read_text()
    (model / MODEL).write_text(text.replace("0.025", "0.026"))
    assert_refused(model, "has changed since")


def test_white_space_is_no_change(model):
    values = json.loads((model / MODEL).read_text())
    (model / MODEL).write_text(json.dumps(dict(reversed(values.items())), indent=7))
    assert_as_written(read_model(model))


@pytest.mark.parametrize(
    ("entry", "match"),
    [
        ({"dtype": "<f8"}, "not <f8 of shape"),
        ({"dtype": "<i4"}, "is float32 of shape"),
        ({"shape": [3]}, "not <f4 of shape"),
        ({"shape": [4, 3]}, "not <f4 of shape"),
        ({"dtype": "|O"}, "not of numbers"),
        ({"dtype": "f4,f4"}, "not of numbers"),
        ({"dtype": ["<f4"]}, "not of numbers"),
        ({"dtype": "(9999999999,)<f8"}, "not of numbers"),
        ({"shape": [10**30]}, "more than 2147483648 bytes"),
        ({"shape": [2**24]}, "where 67108920 of arrays are expected"),
        ({"shape": [-3, -4]}, "the shape of"),
        ({"shape": [True, 12]}, "the shape of"),
        ({"shape": 12}, "the shape of"),
        ({"sha256": 0}, "have changed"),
        ({"more": 0}, "lacks dtype"),
    ],
)
def test_a_table_that_is_not_of_the_arrays_is_refused(model, entry, match):
    table = table_of(model)
    table["coarse/tx.weights"] |= entry
    sign(model, arrays=table)
    assert_refused(model, match)


@pytest.mark.parametrize("arrays", [{"x": []}, {"x\ny": {}}])
def test_a_table_of_another_kind_is_refused(model, arrays):
    sign(model, arrays=arrays)
    assert_refused(model, "table")


def test_arrays_that_change_places_are_refused(tmp_path):
    model = tmp_path / "model"
    write_model(model, {}, {"large": np.zeros(500), "small": np.zeros(1)})
    table = table_of(model)
    sign(model, arrays={"large": table["small"], "small": table["large"]})
    assert_refused(model, "'large' has 4128 bytes, not 8")


@pytest.mark.parametrize("key", ["header", "arrays", "servoscope"])
@pytest.mark.parametrize("value", [None, [1]])
def test_parts_of_another_kind_are_refused(model, key, value):
    sign(model, **{key: value})
    assert_refused(model, f"its {key} is ")


def test_missing_extra_and_doubled_arrays_are_refused(model):
    table = table_of(model)
    sign(model, arrays=table | {"more": table["none"] | {"shape": [0]}})
    assert_refused(model, r"lacks 'more\.npy'")
    del table["scale"]
    sign(model, arrays=table)
    assert_refused(model, r"holds 'scale\.npy', which is not in the table")


def npz(model, members, compression=zipfile.ZIP_STORED):
    """Replace the arrays by members of any name and content."""
    with zipfile.ZipFile(model / ARRAYS, "w", compression) as archive:
        for name, data in members:
            archive.writestr(name, data)


def only_member(model, shape=(1,), dtype="<f8"):
    sign(model, arrays={"x": {"dtype": dtype, "shape": list(shape), "sha256": "0" * 64}})


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_names_that_lead_elsewhere_are_refused_and_write_nothing(model):
    only_member(model)
    for name in ("../x.npy", "/etc/x.npy", "x.npy/../../x", "C:\\x.npy", "x"):
        npz(model, [(name, b"\0" * 100)])
        assert_refused(model, r"lacks 'x\.npy'")
        npz(model, [("x.npy", b"\0" * 100), (name, b"")])
        assert_refused(model, "which is not in the table")
    npz(model, [("x.npy", b"\0" * 100), ("x.npy", b"")])
    assert_refused(model, "an array twice")
    assert [p.name for p in model.parent.iterdir()] == ["model"]


class Bomb:
    """Makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


def test_pickles_are_never_run(model, tmp_path):
    crater = tmp_path / "crater"
    path = model.parent / "bomb.npy"
    np.save(path, np.array([Bomb(crater)], dtype=object), allow_pickle=True)
    for data in (path.read_bytes(), pickle.dumps(Bomb(crater))):
        for dtype, size in (("<f8", 8), ("|u1", 1)):
            digest = model_folder.hashlib.sha256(data[-size:]).hexdigest()
            sign(model, arrays={"x": {"dtype": dtype, "shape": [1], "sha256": digest}})
            npz(model, [("x.npy", data)])
            assert_refused(model, "'x'|magic")
    sign(model, arrays={"x": {"dtype": "|O", "shape": [1], "sha256": "0" * 64}})
    npz(model, [("x.npy", path.read_bytes())])
    assert_refused(model, "not of numbers")
    assert not crater.exists()
    np.load(path, allow_pickle=True)
    assert crater.exists(), "the bomb would not have gone off"


def test_a_zip_bomb_is_refused_before_it_is_read(model, monkeypatch):
    only_member(model, (2**20,), "|u1")
    npz(model, [("x.npy", b"\0" * (2**20 + 128))], zipfile.ZIP_DEFLATED)
    assert_refused(model, "where 1048576 of arrays are expected")
    only_member(model, (1,), "|u1")
    npz(model, [("x.npy", b"\0" * 129)], zipfile.ZIP_DEFLATED)
    monkeypatch.setattr(zipfile.ZipFile, "open", lambda *_: pytest.fail("it is read"))
    assert_refused(model, "is compressed")


def test_an_array_head_that_asks_for_more_is_refused(model):
    head = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (%s,), }"
    only_member(model)
    for shape in (b"9" * 12, b"1,) * (10**9", b"__import__('os').mkdir('y')"):
        data = (head % shape).ljust(127) + b"\n" + b"\0" * 8
        npz(model, [("x.npy", data)])
        assert_refused(model, "'x'|Header|header|malformed")


def test_folders_that_cannot_be_looked_at_are_refused(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert_refused(tmp_path / "loop", "does not exist")
    assert not is_model(tmp_path / "loop")
    with pytest.raises(ModelError, match="File name too long"):
        read_model(tmp_path / ("x" * 300))
    assert not is_model("/")


@pytest.mark.parametrize("part", [MODEL, ARRAYS])
def test_links_and_pipes_are_refused(model, tmp_path, part):
    (model / part).rename(tmp_path / "elsewhere")
    (model / part).symlink_to(tmp_path / "elsewhere")
    assert_refused(model, "it is a link")
    (model / part).unlink()
    os.mkfifo(model / part)
    assert_refused(model, r"no file; copy|has no model\.json")


def test_numbers_that_are_not_finite_are_refused(model):
    values = np.array([np.nan])
    digest = model_folder.hashlib.sha256(values.tobytes()).hexdigest()
    sign(model, arrays={"x": {"dtype": "<f8", "shape": [1], "sha256": digest}})
    np.savez(model / ARRAYS, x=values)
    assert_refused(model, "NaN or infinite")
