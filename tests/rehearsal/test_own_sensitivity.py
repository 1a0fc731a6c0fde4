"""A model's own errors under disturbances whose effect is known."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rehearsal_sample import RANGES, keyframe, model
from servoscope.errors import InvalidInputError
from servoscope.poses import rigid_transform
from servoscope.rehearsal import Rehearsal, TrueView
from servoscope.rehearsal.own_sensitivity import (
    OWN_DISTURBANCES,
    RenderedLooks,
    check_own_disturbances,
    measure_own,
)
from servoscope.scene.disturbances import DISTURBANCES


@pytest.fixture(scope="module")
def rehearsal():
    small = float(1e3 * RANGES[0]) / 3
    return Rehearsal(model(noise=0.3), starts=2, range_mm=small, range_deg=1.5)


@pytest.fixture(scope="module")
def looks():
    sample = model()
    return RenderedLooks(TrueView(sample.keyframe, np.zeros(6)), np.eye(4), 0.0)


def seen(looks, name, strength):
    rng = np.random.default_rng(0)
    look = DISTURBANCES[name].change(looks.undisturbed, strength, rng)
    return looks.image(look, np.random.default_rng(1)).astype(float)


def test_a_remounted_camera_is_misread_by_as_much(rehearsal):
    growth = measure_own(rehearsal, "hand_eye_tz", n_jobs=1)["tz"]
    # the reference view is no longer where the robot reports it
    assert growth.simulated_bias == pytest.approx(growth.strengths, abs=0.15)
    assert growth.predicted_rms == pytest.approx(growth.simulated_rms, abs=0.2)


def test_the_camera_is_moved_along_its_own_axes_however_it_is_mounted(looks):
    turned = Rotation.from_euler("zyx", [70, -10, 150], degrees=True).as_matrix()
    crooked = keyframe(mount=rigid_transform(turned, [0.03, -0.02, 0.05]))
    mounted = RenderedLooks(TrueView(crooked, np.zeros(6)), np.eye(4), 0.0)
    for dof in ("tz", "rx"):
        straight, turned = (seen(of, f"hand_eye_{dof}", 1.0) for of in (looks, mounted))
        assert np.abs(straight - turned).max() <= 1


def test_gain_is_borne(rehearsal):
    growths = measure_own(rehearsal, "gain", n_jobs=1)
    assert max(growths["tz"].simulated_rms) < 0.2


def test_a_moved_principal_point_moves_the_image(looks):
    clean, moved = seen(looks, "gain", 0.0), seen(looks, "principal_point_x", 4.0)
    shift = np.float32([[1, 0, 4.0 * 128 / 256], [0, 1, 0]])
    shifted = cv2.warpAffine(clean, shift, (128, 96))
    assert np.abs(moved - shifted)[:, 4:].max() <= 1


def test_a_longer_lens_enlarges_the_image(looks):
    clean, larger = seen(looks, "gain", 0.0), seen(looks, "focal_length", 5.0)
    scale = cv2.getRotationMatrix2D((63.5, 47.5), 0, 1.05)
    assert np.abs(larger - cv2.warpAffine(clean, scale, (128, 96))).mean() < 0.6


def test_gain_offset_and_noise_are_those_of_the_image(looks):
    clean = seen(looks, "gain", 0.0)
    assert seen(looks, "gain", -20.0) == pytest.approx(0.8 * clean, abs=1.0)
    assert seen(looks, "offset", -5.0) == pytest.approx(clean - 5, abs=1.0)
    noisy = seen(looks, "noise", 10.0) - clean
    assert noisy.std() == pytest.approx(10.0, rel=0.1)


@pytest.mark.parametrize("shape", [(30, 2100), (2100, 30)])
def test_images_of_any_shape_are_disturbed(shape):
    wide = keyframe(reference_image=np.full(shape, 100, np.uint8))
    looks = RenderedLooks(TrueView(wide, np.zeros(6)), np.eye(4), 0.0)
    assert seen(looks, "offset", -5.0) == pytest.approx(95, abs=1.0)
    assert seen(looks, "noise", 10.0).std() == pytest.approx(10.0, rel=0.1)


def test_covering_hides_the_square_of_its_strength(looks):
    hidden = np.abs(seen(looks, "covering", 45.0) - seen(looks, "gain", 0.0)) > 0
    assert hidden.mean() == pytest.approx(0.45**2, abs=0.03)


def test_lamps_are_left_out():
    assert set(DISTURBANCES) - set(OWN_DISTURBANCES) == {"light_x", "light_z"}
    assert check_own_disturbances(()) == OWN_DISTURBANCES
    with pytest.raises(InvalidInputError, match="needs lamps"):
        check_own_disturbances(["light_x"])
