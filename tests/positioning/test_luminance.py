"""The interaction matrix of grey levels is the derivative of images."""

import cv2
import numpy as np
import pytest

from servoscope.positioning.luminance import SMOOTHING_PX, luminance_interaction
from servoscope.positioning.screw import motion
from servoscope.scene.camera import Lens
from servoscope.scene.lighting import Lighting
from servoscope.scene.render import render_depth, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

OBLIQUE = T_WORLD_REF @ motion([0.1, -0.05, 0.02, 0.15, -0.1, 0.3])


def _soft(scene: Scene, T_world_cam: np.ndarray) -> np.ndarray:
    """Without detail as fine as the pixels, whose slopes no sum over pixels tells."""
    return cv2.GaussianBlur(render_radiance(scene, T_world_cam), (0, 0), 3.0).astype(float)


@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.3, 0.1)])
@pytest.mark.parametrize("axis", range(6))
def test_it_is_the_difference_of_images_of_a_plane(
    axis: int, distortion: tuple[float, float]
) -> None:
    scene = Scene(
        TexturedPlane(),
        Lighting(lamps=(), ambient=1.0),
        Lens(principal_point=(0.45, 0.56), distortion=distortion),
        image_size=256,
    )
    K = scene.lens.camera_matrix(256)
    depth = render_depth(scene, OBLIQUE)
    L = luminance_interaction(_soft(scene, OBLIQUE), depth, K[0, 0], (K[0, 2], K[1, 2]), distortion)
    screw = 1e-3 * np.eye(6)[axis]
    ahead, behind = (_soft(scene, OBLIQUE @ motion(s)) for s in (screw, -screw))
    inner = np.s_[15:-15, 15:-15]
    expected = cv2.GaussianBlur((ahead - behind) / 2e-3, (0, 0), SMOOTHING_PX)[inner].ravel()
    found = L[axis][inner].ravel()
    assert np.corrcoef(found, expected)[0, 1] > 0.99
    assert found @ expected / (expected @ expected) == pytest.approx(1, abs=0.025)


def test_what_lies_infinitely_far_only_turns() -> None:
    image = np.random.default_rng(0).uniform(0, 255, (20, 20))
    near, far = (luminance_interaction(image, z, 50.0, (9.5, 9.5)) for z in (1.0, np.inf))
    assert (far[:3] == 0).all()
    np.testing.assert_array_equal(far[3:], near[3:])
