"""The method is decided on images that neither method learned from."""

from types import SimpleNamespace

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_data_set
from servoscope.errors import InvalidInputError
from servoscope.keyframe import Keyframe
from servoscope.poses import poses_from_displacements
from servoscope.positioning.calibration import Calibration
from servoscope.positioning.decision import compare_methods, decision_text
from servoscope.positioning.ladder import HeldOut

DATA = planar_data_set(n_images=60, size=32)
P = DATA.delta_p() / RANGES
P[:20] *= 0.2
HELD = HeldOut(DATA.images[:40], DATA.images[:40], P[:40], np.arange(40, 60))
BY_IMAGE = {image.tobytes(): p for image, p in zip(HELD.images, HELD.p, strict=True)}


def reader(error: float):
    """Reads every image off by a share of the range."""
    return lambda image: BY_IMAGE[image.tobytes()] * RANGES + error * RANGES


def levels(error: float) -> SimpleNamespace:
    read = reader(error)
    return SimpleNamespace(
        reach=RANGES,
        estimate=lambda image: SimpleNamespace(
            displacement=poses_from_displacements(np.eye(4), read(image)[None], PIVOT)[0]
        ),
    )


@pytest.mark.parametrize(
    ("of_levels", "of_keyframe", "chosen"),
    [(0.01, 0.001, "keyframe"), (0.1, 0.08, "keyframe"), (0.1, 0.12, "levels"),
     (0.4, 0.1, "keyframe"), (0.1, 0.4, "levels")],
)  # fmt: skip
def test_the_better_one_is_chosen(monkeypatch, of_levels, of_keyframe, chosen) -> None:
    fitted = []

    def fit(images, *others, **options):
        fitted.append(images)
        read = reader(of_keyframe)
        return SimpleNamespace(align=lambda image: SimpleNamespace(delta_p=read(image)))

    monkeypatch.setattr(Keyframe, "fit", fit)
    decision = compare_methods(levels(of_levels), DATA, HELD, Calibration())
    assert decision["chosen"] == chosen
    assert decision["levels"]["near"] == pytest.approx(of_levels, rel=0.1)
    assert decision["keyframe"]["far"] == pytest.approx(of_keyframe, rel=0.1)
    held = {image.tobytes() for image in HELD.images}
    assert not held & {image.tobytes() for image in fitted[0]}
    assert decision_text(decision).startswith(f"chosen: {chosen} (of images held out by keyframe")


def test_levels_are_kept_where_no_keyframe_can_be_fitted(monkeypatch) -> None:
    def fit(*images, **options):
        raise InvalidInputError("nothing to see")

    monkeypatch.setattr(Keyframe, "fit", fit)
    assert compare_methods(levels(0.1), DATA, HELD, Calibration())["chosen"] == "levels"
