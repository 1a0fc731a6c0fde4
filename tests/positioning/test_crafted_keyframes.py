"""Keyframe models whose arrays cannot be those of a keyframe are refused in one line."""

from dataclasses import replace

import numpy as np
import pytest

from rehearsal_sample import RANGES, model
from servoscope.cli import main
from servoscope.errors import ModelError
from servoscope.positioning import PositioningModel
from servoscope.rehearsal.true_view import OwnErrors

FLAT = np.full((48, 64), 2.0, np.float32)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("inverse_depth", FLAT.astype(float)), ("inverse_depth", FLAT[:0]),
        ("inverse_depth", -FLAT), ("inverse_depth", 0 * FLAT), ("trust", 0 * FLAT),
        ("trust", -FLAT), ("trust", FLAT[:5]), ("displacements", np.zeros((0, 4, 4))),
        ("noise", 0.0), ("noise", -1.0), ("residual", -1.0), ("model_error", np.full(6, -1.0)),
        ("reference_image", np.full((96, 128), 9, np.uint8)),
    ],
)  # fmt: skip
def test_a_crafted_keyframe_is_refused_when_it_is_loaded(name, value, tmp_path):
    made = model()
    made = replace(made, keyframe=replace(made.keyframe, **{name: value}))
    made.save(tmp_path / "model")
    with pytest.raises(ModelError, match=f"arrays of a keyframe.*{name}") as caught:
        PositioningModel.load(tmp_path / "model")
    assert "\n" not in str(caught.value)


def test_a_keyframe_as_it_is_made_is_loaded(tmp_path):
    model().save(tmp_path / "model")
    np.testing.assert_array_equal(PositioningModel.load(tmp_path / "model").reach, RANGES)


@pytest.mark.parametrize("median", [{}, [1, 2], None, dict.fromkeys("abcdef", 1), {"tx": "x"}])
def test_median_errors_of_another_kind_are_refused(median):
    with pytest.raises(ModelError, match="median errors") as caught:
        OwnErrors.of(replace(model(), accuracy={"median": median}))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("shape", [(3, 3, 3), (4,), (0, 5), ()])
def test_a_residual_of_another_shape_is_not_drawn(shape, tmp_path, capsys):
    replace(model(), residual=np.zeros(shape, np.float32)).save(tmp_path / "model")
    picture = tmp_path / "view.png"
    assert main(["info", str(tmp_path / "model"), "--figure", str(picture)]) == 1
    err = capsys.readouterr().err
    assert "held_out_residual" in err
    assert len(err.splitlines()) == 1
    assert not picture.exists()
