"""``servoscope info`` of a trained model."""

import json

import cv2
import numpy as np
import pytest

from servoscope import CameraModel, Keyframe
from servoscope.cli import main
from servoscope.commands.accuracy import observability
from servoscope.commands.output import print_facts
from servoscope.keyframe.figure import plot_shares
from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
from servoscope.positioning import KeyframeModel
from servoscope.storage.model_folder import read_model, write_model
from servoscope.wording import plain_number

HEADER = {
    "trained_on": {"images": 1800, "part": "cylinder_head", "note": "evil\x1b[2J\nnote"},
    "kind": "features",
    "image_size": [240, 320],
    "reach": [0.025, 0.025, 0.025, *np.radians([15.0, 15.0, 15.0])],
    "pivot": 0.55,
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
    assert facts["kind"] == "features"
    assert facts["trained_on"] == HEADER["trained_on"]


def test_a_terminal_sees_every_fact_and_no_control_codes(tmp_path, capsys):
    write_model(tmp_path / "model", HEADER, ARRAYS)
    assert main(["info", str(tmp_path / "model")]) == 0
    printed = capsys.readouterr().out
    assert "part cylinder_head" in printed
    assert "\x1b" not in printed
    assert "evil?[2J?note" in printed


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


ERRORS = dict(zip(DOFS, [0.123, 0.08, 0.37, 0.037, 0.049, 0.021], strict=True))


@pytest.fixture(scope="module")
def keyframe_model(tmp_path_factory):
    """A model of a plate 0.5 m away, lit from the left half alone."""
    grey = np.random.default_rng(0).integers(20, 235, (48, 64), dtype=np.uint8)
    grey[:, 40:] = 90
    flat = np.full((24, 32), 2.0, np.float32)
    keyframe = Keyframe(
        grey, CameraModel(1.5), np.eye(4), flat, np.ones_like(flat), np.eye(4)[None],
        np.zeros((20, 20)), np.zeros(6), pivot=0.5, residual=2.0, noise=1.5,
    )  # fmt: skip
    accuracy = {
        "rms": ERRORS, "median": {d: e / 2 for d, e in ERRORS.items()}, "n_images": 40,
        "held_out": {"images": 12, "groups": 4, "share_right": 0.75},
        "residual": 2.0, "noise": 1.5, "residual_over_noise": 3.2,
        "observable": keyframe.observable,
    }  # fmt: skip
    residual = np.full((24, 32), 1.5, np.float32)
    folder = tmp_path_factory.mktemp("keyframe") / "model"
    source = {"kind": "imported", "n_images": 40}
    KeyframeModel(
        keyframe, residual, reach=np.full(6, 0.025), trained_on=source, accuracy=accuracy
    ).save(folder)
    return folder, keyframe


def with_assessment(folder, to, assessment):
    """The model of a folder, with an assessment, in another folder."""
    header, arrays = read_model(folder)
    accuracy = {**header["accuracy"], "assessment": assessment}
    write_model(to, {**header, "accuracy": accuracy}, arrays)
    return to


def rows_of(out):
    """The cells of a printed table by dof."""
    lines = [line.split("│")[1:-1] for line in out.splitlines() if line.startswith("│")]
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}


def printed(folder, capsys):
    assert main(["info", str(folder)]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    assert len(out.splitlines()) < 25
    return out


def test_a_keyframe_model_is_one_table_of_eighty_columns(keyframe_model, capsys):
    folder, keyframe = keyframe_model
    out = printed(folder, capsys)
    rows = rows_of(out)
    assert list(rows) == list(DOFS)
    limit = keyframe.limit().std * DISPLAY_FACTORS
    for k, (dof, cells) in enumerate(rows.items()):
        unit = DISPLAY_UNITS[k]
        assert cells[0] == f"{plain_number(ERRORS[dof])} {unit}"
        assert float(cells[1].removesuffix(unit)) == pytest.approx(limit[k], rel=0.06)
    assert "RMS of 12 images in 4 independent groups, of the 9 read" in " ".join(out.split())
    assert "in the loop: servoscope rehearse MODEL" in out
    assert "train DATA --assessment RUN" in out
    assert "3.2 times the noise" in out
    assert "observable: depth" in out
    assert facts_of(folder, capsys)["limit"]["tx"] == pytest.approx(1e3 * keyframe.limit().std[0])


def test_what_an_assessment_forecast_stands_beside_what_is_measured(
    keyframe_model, tmp_path, capsys
):
    row = {"forecast_rms": 1.25, "reached_rms": 1.5, "loop": {"end_rms": 0.012}}
    loop = {"success": 0.875, "starts": 8, "end_mm": 0.1, "end_deg": 0.011}
    assessment = {"dofs": {"tx": row, "rz": {**row, "loop": None}}, "loop": loop}
    out = printed(with_assessment(keyframe_model[0], tmp_path / "model", assessment), capsys)
    rows = rows_of(out)
    assert rows["tx"][:4] == ["1.2 mm", "1.5 mm", "0.12 mm", "0.012 mm"]
    assert rows["rz"][:4] == ["1.2 deg", "1.5 deg", "0.021 deg", "–"]
    assert rows["ty"][:4] == ["–", "–", "0.08 mm", "–"]
    assert "in the loop: 7 of 8 rehearsed starts arrive; camera 0.1 mm, 0.011 deg away" in out
    assert "servoscope rehearse" not in out
    assert "servoscope assess" not in out


@pytest.mark.parametrize(
    "assessment",
    [3, [], {"dofs": 3}, {"dofs": {"tx": 3, "ty": {"forecast_rms": "x\x1b", "loop": 3}}},
     {"dofs": {"tx": {"forecast_rms": 10**15, "reached_rms": 1e300}}, "loop": [1]},
     {"dofs": {"tx": {"loop": {"end_rms": None}}}, "loop": {"success": "x", "starts": {}}}],
)  # fmt: skip
def test_columns_of_an_assessment_that_cannot_be_read_are_left_out(
    keyframe_model, tmp_path, capsys, assessment
):
    out = printed(with_assessment(keyframe_model[0], tmp_path / "model", assessment), capsys)
    assert all(len(cells) == 2 for cells in rows_of(out).values())
    assert "forecast │" not in out
    assert "–" not in out
    assert "\x1b" not in out
    assert "in the loop: servoscope rehearse MODEL" in out


def test_features_are_the_same_table_without_a_limit_of_the_view(tmp_path, capsys):
    forecast = {dof: 2 * error for dof, error in ERRORS.items()}
    accuracy = {"rms": ERRORS, "held_out": {"images": 90}, "forecast": forecast}
    write_model(tmp_path / "model", {**HEADER, "accuracy": accuracy}, ARRAYS)
    out = printed(tmp_path / "model", capsys)
    assert rows_of(out)["tz"] == ["0.74 mm", "0.37 mm"]
    assert "RMS of 90 images" in out
    assert "servoscope rehearse" not in out  # which cannot render them


@pytest.mark.parametrize(
    "accuracy",
    [None, 3, {"rms": {}, "median": {}}, {"rms": 3, "median": "tx"},
     {"rms": dict.fromkeys(DOFS, "x")}, {"rms": {"x": 1.0}}],
)  # fmt: skip
def test_an_accuracy_that_is_no_table_is_printed_as_it_is(tmp_path, capsys, accuracy):
    write_model(tmp_path / "model", {**HEADER, "accuracy": accuracy}, {})
    assert main(["info", str(tmp_path / "model")]) == 0
    assert "pivot mm" in capsys.readouterr().out


def test_a_view_without_depth_is_said_to_read_rotations_alone():
    line = observability({"depth": False, "mount_rotation": True})
    assert line.startswith("not observable: depth is not known, so translations are not read")
    assert len(line.splitlines()) == 1


def test_the_figure_shows_where_each_dof_is_read(keyframe_model, tmp_path):
    folder, keyframe = keyframe_model
    assert main(["info", str(folder), "--figure", str(tmp_path / "view.png"), "--json"]) == 0
    picture = cv2.imread(str(tmp_path / "view.png"), cv2.IMREAD_GRAYSCALE)
    assert picture.shape[1] > 1500
    shares = keyframe.limit().shares
    axes = plot_shares(shares[0], keyframe.reference_image, title="tx: 0.01 mm")
    image, shown = (drawn.get_array() for drawn in axes.images)
    assert image.shape == shown.shape == (48, 64)
    assert shown[:, :38].mean() > 10 * shown[:, 44:].mean()  # nothing is read where all is alike
    dark, light = axes.images[1].get_cmap()([0.9, 0.1])[:, :3].mean(axis=1)
    assert dark < light
    assert axes.figure.axes[1].get_ylabel() == "times an average pixel"


def test_a_figure_of_what_is_no_keyframe_is_refused_in_one_line(tmp_path, capsys):
    write_model(tmp_path / "model", HEADER, ARRAYS)
    arguments = ["info", str(tmp_path / "model"), "--figure", str(tmp_path / "view.png")]
    assert main(arguments) == 1
    err = capsys.readouterr().err
    assert "--figure shows a keyframe model" in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "view.png").exists()


def test_a_figure_by_another_ending_is_refused(keyframe_model, tmp_path, capsys):
    assert main(["info", str(keyframe_model[0]), "--figure", str(tmp_path / "view.jpg")]) == 1
    assert "PNG or SVG file" in capsys.readouterr().err
