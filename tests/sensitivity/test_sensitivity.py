"""The whole analysis, small: its models, its numbers, its tables and its figure."""

import json
from dataclasses import replace

import numpy as np
import pytest

from servoscope.acquisition import acquire
from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLAY_FACTORS, DOFS
from servoscope.scene.disturbances import DISTURBANCES
from servoscope.sensitivity import SensitivityConfig, SensitivityRun, measure
from servoscope.sensitivity.page import draw_sensitivity, sensitivity_table

CONFIG = SensitivityConfig(
    n_images=120,
    n_test=8,
    image_size=64,
    part="textured_plane",
    features=("tchebichef",),
    disturbances=("hand_eye_tx", "gain"),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "dataset"
    return SensitivityRun(acquire(folder, CONFIG.acquisition(), n_jobs=1), CONFIG, n_jobs=1)


@pytest.fixture(scope="module")
def sensitivity(run):
    return {name: run.measure(name)["tchebichef"] for name in CONFIG.disturbances}


def test_the_clean_error_is_that_of_the_images_that_were_not_trained_on(run, sensitivity):
    images = run.data.images[-8:]
    model = run.models["tchebichef"]
    predicted = model.predict(model.transform(images))
    errors = (predicted - run.data.delta_p()[-8:]) * DISPLAY_FACTORS
    rms = np.sqrt((errors**2).mean(axis=0))
    for by_dof in sensitivity.values():
        assert [by_dof[dof]["clean_rms"] for dof in DOFS] == pytest.approx(rms)


def test_every_number_of_processes_gives_the_same_errors(run):
    gain = replace(DISTURBANCES["gain"], strengths=(5.0, 10.0))
    one, two = (
        measure(gain, run.models, CONFIG.acquisition(), CONFIG.test_numbers[:2], n_jobs=n)
        for n in (1, 2)
    )
    assert one == two


def test_a_camera_mounted_10_mm_beside_is_seen_10_mm_beside(sensitivity):
    """The image is that of the camera's place; the robot reports the place of the flange."""
    growth = sensitivity["hand_eye_tx"]["tx"]
    by = dict(zip(growth["strengths"], growth["simulated_bias"], strict=True))
    assert (by[10.0] - by[-10.0]) / 20 == pytest.approx(1.0, abs=0.25)
    predicted = dict(zip(growth["strengths"], growth["predicted_rms"], strict=True))
    simulated = dict(zip(growth["strengths"], growth["simulated_rms"], strict=True))
    assert predicted[3.0] == pytest.approx(simulated[3.0], rel=0.2)


def test_results_are_plain_json_with_what_is_promised(sensitivity):
    growth = json.loads(json.dumps(sensitivity, allow_nan=False))["gain"]["rx"]
    assert growth["unit"] == "%"
    assert growth["error_unit"] == "deg"
    n = len(growth["strengths"])
    for key in ("simulated_rms", "predicted_rms", "simulated_bias"):
        assert len(growth[key]) == n
    assert {"doubles_at", "parts_at", "clean_rms"} <= set(growth)


def test_tables_say_where_nothing_doubles(sensitivity):
    never = {dof: {**sensitivity["gain"][dof], "doubles_at": None} for dof in DOFS}
    some = {dof: {**sensitivity["gain"][dof], "doubles_at": 123.4} for dof in DOFS}
    table = sensitivity_table("tchebichef", {"gain": never, "light": some}, "doubles_at")
    clean, *rows = table.rows
    assert rows[0] == ("gain", "%", *["> 20"] * 6)
    assert rows[1] == ("light", "%", *["120"] * 6)
    assert len(clean) == len(table.columns)
    assert len(sensitivity_table("tchebichef", sensitivity, "parts_at").rows) == 2


def test_the_figure_has_a_panel_a_disturbance_with_two_lines_a_dof(run, sensitivity):
    figure = draw_sensitivity(sensitivity, run.ranges())
    assert len(figure.axes) == 2
    for ax, name in zip(figure.axes, sensitivity, strict=True):
        solid, dashed = (
            [line for line in ax.lines if line.get_linestyle() == style] for style in ("-", "--")
        )
        assert len(solid) == len(dashed) == 6
        assert ax.get_title() == name.replace("_", " ")
        growth = sensitivity[name]["tx"]
        shown = dict(zip(solid[0].get_xdata(), solid[0].get_ydata(), strict=True))
        for strength, rms in zip(growth["strengths"], growth["simulated_rms"], strict=True):
            assert shown[strength] == pytest.approx(rms / run.ranges()["tx"]["value"])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"n_images": 10}, "n_images must be a whole number from 50"),
        ({"n_test": 1}, "n_test must be"),
        ({"disturbances": ("gravity",)}, "disturbances must be taken from focal_length"),
        ({"features": ()}, "features must be taken from moments"),
        ({"image_size": 3}, "image_size must be"),
    ],
)
def test_what_cannot_be_analysed_is_refused(change, said):
    with pytest.raises(InvalidInputError, match=said):
        replace(CONFIG, **change)
