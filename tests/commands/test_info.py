"""``servoscope info`` of a trained model."""

import json

import numpy as np
import pytest

from servoscope.cli import main
from servoscope.commands.output import print_facts
from servoscope.positioning.model_folder import write_model

HEADER = {
    "trained_on": {"images": 1800, "part": "cylinder_head", "note": "evil\x1b[2J\nnote"},
    "image_size": [240, 320],
    "reach": [0.025, 0.025, 0.025, *np.radians([15.0, 15.0, 15.0])],
    "pivot": 0.55,
    "levels": [{"blur": 4.0, "pixels": 64}, {"blur": 1.0, "pixels": 256}],
    "accuracy": {"tx": 0.0001},
}
ARRAYS = {"L": np.zeros((1000, 250), np.float32)}


def facts_of(folder, capsys):
    assert main(["info", str(folder), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_model_is_described_in_millimetres_and_degrees(tmp_path, capsys):
    write_model(tmp_path / "model", HEADER, ARRAYS)
    facts = facts_of(tmp_path / "model", capsys)
    assert facts["ranges"] == {
        "tx": "25 mm",
        "ty": "25 mm",
        "tz": "25 mm",
        "rx": "15 deg",
        "ry": "15 deg",
        "rz": "15 deg",
    }
    assert facts["size_px"] == [320, 240]
    assert facts["pivot_mm"] == 550.0
    assert facts["size_mb"] == 1.0
    assert facts["version"] == 1
    assert facts["levels"] == HEADER["levels"]
    assert facts["trained_on"] == HEADER["trained_on"]


def test_a_terminal_sees_every_fact_and_no_control_codes(tmp_path, capsys):
    write_model(tmp_path / "model", HEADER, ARRAYS)
    assert main(["info", str(tmp_path / "model")]) == 0
    told = capsys.readouterr().out
    assert "blur 4, pixels 64; blur 1, pixels 256" in told
    assert "part cylinder_head" in told
    assert "\x1b" not in told
    assert "evil?[2J?note" in told


@pytest.mark.parametrize("reach", [None, 3, [1.0], ["x"] * 6, [10**39] * 6, {"tx": 1}])
def test_what_a_header_does_not_tell_is_left_out(tmp_path, capsys, reach):
    header = {"reach": reach, "pivot": "far", "image_size": [reach]}
    write_model(tmp_path / "model", header, {})
    facts = facts_of(tmp_path / "model", capsys)
    assert facts.keys() == {"model", "arrays", "size_mb", "version", "written_by"}


def test_a_damaged_model_is_refused_in_one_line(tmp_path, capsys):
    write_model(tmp_path / "model", HEADER, ARRAYS)
    (tmp_path / "model" / "arrays.npz").write_bytes(b"PK")
    assert main(["info", str(tmp_path / "model")]) == 1
    err = capsys.readouterr().err
    assert "arrays.npz cannot be read" in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("warnings", "shown"),
    [([], "none"), (["Check the lens.", "Check it."], "Check the lens. Check it.")],
)
def test_sentences_are_shown_one_after_the_other(capsys, warnings, shown):
    print_facts({"warnings": warnings, "size_px": [320, 240]})
    out = capsys.readouterr().out
    assert out.splitlines()[0].split(maxsplit=1)[1].strip() == shown
    assert "320 x 240" in out
