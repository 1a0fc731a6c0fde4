"""How a person moves a camera back, on images that a homography makes of a plate."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import servoscope as sv
from servoscope.errors import CameraFaultError, ModelError
from servoscope.keyframe import Keyframe
from servoscope.keyframe.camera import CameraModel
from servoscope.poses import inverse_transform, rigid_transform
from servoscope.positioning import Estimate, KeyframeModel
from servoscope.positioning.aiming import AIM_SETTINGS, std_of_camera

HEIGHT, WIDTH, FOCAL, DEPTH = 96, 128, 1.5, 0.5
MOUNT = rigid_transform(
    Rotation.from_euler("xyz", [10, -20, 40], degrees=True).as_matrix(), [0.05, -0.03, 0.04]
)


def plate():
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(HEIGHT, WIDTH)), (0, 0), 3)
    return cv2.normalize(noise, None, 20, 235, cv2.NORM_MINMAX).astype(np.uint8)


@pytest.fixture(scope="module")
def model():
    """What images of the plate would make: camera, mount and depth are known."""
    flat = np.full((48, 64), 1 / DEPTH, np.float32)
    spread = 0.1 * np.ones(6)
    displacements = np.stack([np.eye(4)] * 2)
    displacements[1, :3, 3] = 0.03
    keyframe = Keyframe(
        plate(), CameraModel(FOCAL), MOUNT, flat, np.ones_like(flat), displacements,
        np.zeros((20, 20)), np.zeros(6), pivot=0.5, residual=1.0, noise=1.0,
    )  # fmt: skip
    return KeyframeModel(keyframe=keyframe, reach=spread)


def seen(T_ref_cam):
    """The plate from a camera displaced by (4, 4) from the reference: a plane's homography."""
    K = np.array(
        [[FOCAL * WIDTH, 0, (WIDTH - 1) / 2], [0, FOCAL * WIDTH, (HEIGHT - 1) / 2], [0, 0, 1]]
    )
    R, t = T_ref_cam[:3, :3], T_ref_cam[:3, 3]
    H = K @ R.T @ (np.eye(3) - np.outer(t, [0, 0, 1 / DEPTH])) @ np.linalg.inv(K)
    size, border = (WIDTH, HEIGHT), cv2.BORDER_REFLECT_101
    return cv2.warpPerspective(plate(), H, size, flags=cv2.INTER_CUBIC, borderMode=border)


def displaced(mm=(0, 0, 0), deg=(0, 0, 0)):
    turn = Rotation.from_euler("xyz", deg, degrees=True).as_matrix()
    return rigid_transform(turn, np.array(mm) / 1e3)


@pytest.mark.parametrize(
    ("at", "said"),
    [
        (displaced(mm=(6, 0, 0)), "left 6."),
        (displaced(mm=(-6, 0, 0)), "right 6."),
        (displaced(mm=(0, 6, 0)), "up 6."),
        (displaced(mm=(0, -6, 0)), "down 6."),
        (displaced(mm=(0, 0, 20)), "farther 20."),
        (displaced(mm=(0, 0, -20)), "nearer 20."),
        (displaced(deg=(3, 0, 0)), "look down 3."),
        (displaced(deg=(-3, 0, 0)), "look up 3."),
        (displaced(deg=(0, 3, 0)), "look left 3."),
        (displaced(deg=(0, -3, 0)), "look right 3."),
        (displaced(deg=(0, 0, 5)), "turn anticlockwise 5."),
        (displaced(deg=(0, 0, -5)), "turn clockwise 5."),
    ],
)
def test_words_say_the_way_back(model, at, said):
    found = sv.aim(model, seen(at))
    assert found.status == "move"
    words = {word.rsplit(" ", 2)[0]: float(word.split()[-2]) for word in found.words()}
    way, amount = said.rsplit(" ", 1)
    assert words[way] == pytest.approx(float(amount), abs=0.5), words


@pytest.mark.parametrize("seed", range(3))
def test_the_motion_brings_the_camera_back_in_its_own_axes(model, seed):
    rng = np.random.default_rng(seed)
    at = displaced(rng.uniform(-5, 5, 3), rng.uniform(-2, 2, 3))
    found = sv.aim(model, seen(at))
    rest = at @ found.motion
    assert np.abs(rest[:3, 3]).max() < 2e-3
    assert np.abs(Rotation.from_matrix(rest[:3, :3]).as_rotvec(degrees=True)).max() < 0.3
    assert found.axes == "camera"
    assert found.distance == pytest.approx(np.linalg.norm(found.motion[:3, 3]))


def test_steps_by_hand_lead_to_the_tolerance(model):
    at, reading = displaced((8, -5, 12), (1, 2, -3)), None
    for _ in range(4):
        reading = sv.aim(model, seen(at), previous=reading)
        if reading.status == "aimed":
            break
        at = at @ reading.motion
    assert reading.status == "aimed", reading.message
    assert "is back" in reading.message
    assert np.linalg.norm(at[:3, 3]) < AIM_SETTINGS.tolerance_mm / 1e3


def test_another_view_is_not_recognised(model):
    for image in (seen(np.eye(4))[::-1].copy(), np.zeros((HEIGHT, WIDTH), np.uint8)):
        found = sv.aim(model, image)
        assert found.status == "unrecognised"
        assert found.message.startswith("The view is not recognised. The ")
        assert found.words() == []
        assert found.to_dict()["correction"]["tx"]["value"] is None


class Seeing:
    """An estimator that says what it was made with."""

    image_shape, pivot, reach = (HEIGHT, WIDTH), 0.5, np.full(6, 0.1)
    reference_image = plate()

    def __init__(self, displacement, std, **given):
        self.estimate = lambda image, previous: Estimate(displacement, std, 0.0, "known", **given)


def test_a_model_that_does_not_know_the_camera_speaks_in_the_axes_of_the_poses():
    model = Seeing(displaced(mm=(6, 0, 0)), np.full(6, np.nan))
    found = sv.aim(model, plate())
    assert found.axes == "poses"
    assert found.words()[0] == "tx -6.00 mm"


def test_what_is_believed_about_the_pivot_is_carried_to_the_camera():
    std, pivot = np.array([1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 3e-3]), 0.5
    errors = std * np.random.default_rng(0).standard_normal((4000, 6))
    about_pivot = rigid_transform(Rotation.from_rotvec(errors[:, 3:]).as_matrix(), errors[:, :3])
    P = displaced((0, 0, 1e3 * pivot))
    frame = P @ about_pivot @ inverse_transform(P)
    camera = inverse_transform(MOUNT) @ frame @ MOUNT
    turns = Rotation.from_matrix(camera[:, :3, :3]).as_rotvec()
    expected = np.std(np.hstack([camera[:, :3, 3], turns]), axis=0)
    np.testing.assert_allclose(std_of_camera(std, MOUNT, pivot, sv.DOFS), expected, rtol=0.05)


def test_a_deviation_above_the_tolerance_is_no_arrival():
    model = Seeing(np.eye(4), np.full(6, 1e-2))
    found = sv.aim(model, plate())
    assert found.status == "move"
    assert "believed deviation" in found.message


def test_a_view_that_does_not_match_is_no_arrival():
    model = Seeing(np.eye(4), np.full(6, np.nan))
    found = sv.aim(model, plate()[:, ::-1].copy())
    assert found.status == "move"
    assert "match the reference" in found.message


def test_images_and_models_of_the_wrong_kind_are_refused(model):
    with pytest.raises(CameraFaultError, match="takes images of 128 x 96 pixels"):
        sv.aim(model, np.zeros((8, 8), np.uint8))
    with pytest.raises(ModelError, match="no rigid displacement"):
        sv.aim(Seeing(np.ones((4, 4)), np.full(6, np.nan)), plate())
