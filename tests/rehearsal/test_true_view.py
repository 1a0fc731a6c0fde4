"""Views with errors like the keyframe's own, and what is seen beside the reference."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rehearsal_sample import PIVOT, RANGES, displacements, keyframe, model, plate
from servoscope.poses import inverse_transform, poses_from_displacements, rigid_transform
from servoscope.rehearsal.true_view import Backdrop, OwnErrors, TrueView, relief_error, shifts

CROOKED = rigid_transform(
    Rotation.from_euler("zyx", [70, -10, 150], degrees=True).as_matrix(), [0.03, -0.02, 0.05]
)
READING = np.array([1e-3, 5e-4, 2e-3, 4e-3, 2e-3, 1e-3])


def test_errors_vanish_at_the_reference():
    view = TrueView.draw(keyframe(), OwnErrors(READING, 0.02), np.random.default_rng(0))
    seen = view.image(np.eye(4)).astype(float)
    assert np.abs(seen - plate())[1:-1, 1:-1].max() <= 1


def test_what_is_read_of_a_view_is_off_by_as_much_as_is_asked_for():
    sample = keyframe()
    shares = []
    for k, D in enumerate(displacements(24, seed=3)):
        view = TrueView.draw(sample, OwnErrors(READING, 0.0), np.random.default_rng(k))
        misread = sample.align(np.rint(view.image(D)).astype(np.uint8), D).displacement
        off = inverse_transform(D) @ misread
        shares.append(off[:3, 3] / shifts(sample, D[None])[0])
    clean = [
        inverse_transform(D) @ sample.align(sample.render(D)[0], D).displacement
        for D in displacements(6, seed=3)
    ]
    assert np.abs(np.array(clean)[:, 2, 3]).max() < 5e-5
    # rotations turn about the pivot, so that tz alone is the translation's own
    assert np.std(np.array(shares)[:, 2]) == pytest.approx(READING[2], rel=0.4)


def test_the_backdrop_of_a_plate_is_what_the_mesh_shows_of_it():
    """Two ways to see a plane: a homography, and triangles between pixels."""
    slope = np.linspace(1.9, 2.1, 64)[None].repeat(48, axis=0)
    sample = keyframe(slope)
    backdrop = Backdrop(sample, sample.reference_image.shape[1])
    for D in displacements(3):
        seen, known = sample.render(D)
        beside = backdrop.render(inverse_transform(D))
        assert known.mean() > 0.5
        assert np.abs(beside.astype(float) - seen)[known].mean() < 1.5


def test_an_exact_view_shows_what_the_keyframe_does():
    sample = keyframe(mount=CROOKED)
    view = TrueView(sample, np.zeros(6))
    for D in CROOKED @ displacements(2) @ inverse_transform(CROOKED):
        seen, known = sample.render_grey(D)
        np.testing.assert_allclose(view.image(D)[known], seen[known], atol=0.01)


def test_a_displacement_of_a_hundredth_of_a_pixel_is_seen():
    """Rounded before the noise is added, grey levels would be those of the reference."""
    view = TrueView(keyframe(), np.zeros(6))
    D = poses_from_displacements(np.eye(4), 4e-4 * RANGES, PIVOT)
    change = np.abs(view.image(D) - view.image(np.eye(4)))
    assert 0.01 < np.median(change) < 0.5


def test_nothing_is_black_where_the_reference_shows_nothing():
    sample = keyframe(reference_image=np.full((96, 128), 90, np.uint8))
    aside = poses_from_displacements(np.eye(4), 3 * RANGES * [1, 0, 0, 0, 0, 1], PIVOT)
    assert not sample.render(aside)[1].all()
    assert np.ptp(TrueView(sample, np.zeros(6)).image(aside)) <= 1


def test_a_large_image_is_enlarged_from_a_smaller_one():
    large = np.kron(plate(), np.ones((4, 4), np.uint8))
    sample = keyframe(reference_image=large)
    assert TrueView(sample, np.zeros(6)).image(displacements(1)[0]).shape == (384, 512)


def test_relief_is_as_wrong_as_the_residual_says():
    def error(residual: float) -> float:
        doubted = np.full((48, 64), 0.2, np.float32)
        return relief_error(keyframe(residual=residual, noise=1.0, trust=doubted))

    assert error(0.1) == 0.0
    assert 1e-3 < error(0.8) < 0.7 * error(1.6) < 0.035
    assert error(100.0) == 0.05


def test_errors_are_the_larger_of_the_fit_s_and_those_of_images_held_out():
    median = dict.fromkeys(("tx", "ty", "tz"), 1.0) | dict.fromkeys(("rx", "ry", "rz"), 0.0)
    judged = replace(model(model_error=READING), accuracy={"median": median})
    reading = OwnErrors.of(judged).reading
    typical = np.median(shifts(judged.keyframe, judged.keyframe.displacements))
    assert reading[:3] == pytest.approx(np.maximum(1e-3 / 0.6745 / typical, READING[:3]))
    assert reading[3:] == pytest.approx(READING[3:])
