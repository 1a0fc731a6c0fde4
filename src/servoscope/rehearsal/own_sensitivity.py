"""How the errors of a model grow once its own camera, view or mount is not as it was."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import View
from servoscope.poses import (
    DISPLAY_FACTORS,
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
)
from servoscope.processes import in_processes, one_blas_thread
from servoscope.rehearsal.rendered_cell import view_of_start
from servoscope.rehearsal.run import Rehearsal
from servoscope.rehearsal.true_view import sample_at
from servoscope.scene.disturbances import (
    DISTURBANCES,
    REFERENCE_WIDTH,
    Disturbances,
    Look,
    added_noise,
)
from servoscope.scene.scene import Scene
from servoscope.scoreboard.cell import start_direction
from servoscope.sensitivity.measurement import (
    N_DRAWS,
    ErrorGrowth,
    all_strengths,
    differences,
    error_growths,
)

Array = NDArray[np.float64]

NEED_THE_SCENE = ("light_x", "light_z")
"""Disturbances that need to know where the lamps stand, which a keyframe does not."""

OWN_DISTURBANCES = tuple(name for name in DISTURBANCES if name not in NEED_THE_SCENE)
"""The disturbances that can be made of rendered images."""

_DRAWS = 32
"""What random numbers are drawn for: the looks of an analysis."""


def measure_own(
    rehearsal: Rehearsal,
    name: str,
    *,
    n_jobs: int = -1,
    on_progress: Callable[[int], object] | None = None,
) -> dict[str, ErrorGrowth]:
    """How the error of one look of the model grows with one of `OWN_DISTURBANCES`, by dof.

    The model looks at one image from each start of the rehearsal, in views of their own; every
    number of processes gives the same.
    """
    disturbance = DISTURBANCES[name]
    calls = [
        (rehearsal.model, rehearsal.errors, rehearsal.ranges, name, rehearsal.seed, k)
        for k in range(rehearsal.starts)
    ]
    rows = []
    for row in in_processes(_errors_of_an_image, calls, n_jobs):
        rows.append(row)
        if on_progress is not None:
            on_progress(len(rows))
    strengths = [0.0, *all_strengths(disturbance)]
    errors = dict(zip(strengths, np.stack(rows, axis=2), strict=True))  # (n_draws, n_starts, 6)
    first, second = (differences(disturbance, errors, step) for step in disturbance.steps)
    simulated = np.stack([errors[s] for s in disturbance.strengths])
    growths = error_growths(disturbance, errors[0.0][0], simulated, (first, second))
    return {dof: growths[dof] for dof in rehearsal.model.dofs}


def check_own_disturbances(names: Sequence[str]) -> tuple[str, ...]:
    """The names themselves, or all, if they are of `OWN_DISTURBANCES`."""
    for name in names:
        if name not in OWN_DISTURBANCES:
            needs = " (that needs lamps whose places are known)" if name in NEED_THE_SCENE else ""
            raise InvalidInputError(
                f"Of a model's own view can be disturbed {', '.join(OWN_DISTURBANCES)}; got "
                f"{name!r}{needs}."
            )
    return tuple(names) or OWN_DISTURBANCES


def _errors_of_an_image(
    model: Any, own: Any, ranges: Array, name: str, seed: int, number: int
) -> Array:
    """Errors of one look at each strength, 0 first, (n_strengths, n_draws, 6), [mm] and [deg]."""
    disturbance, keyframe = DISTURBANCES[name], model.keyframe
    view, _ = view_of_start(keyframe, own, seed, number)
    delta_p = ranges * start_direction(seed, number)
    D = poses_from_displacements(np.eye(4), delta_p, keyframe.pivot)
    looks = RenderedLooks(view, D, keyframe.noise)
    n_draws = N_DRAWS if disturbance.is_random else 1

    def error(strength: float, draw: int) -> Array:
        rng = np.random.default_rng([seed, _DRAWS, number, draw])
        look = disturbance.change(looks.undisturbed, strength, rng)
        image = looks.image(look, np.random.default_rng([seed, _DRAWS, number]))
        found = model.estimate(image).displacement
        seen = displacements_from_poses(np.eye(4), found[None], keyframe.pivot)[0]
        return (seen - delta_p) * DISPLAY_FACTORS

    with one_blas_thread():
        clean = error(0.0, 0)
        disturbed = [
            [error(strength, k) for k in range(n_draws)] for strength in all_strengths(disturbance)
        ]
    return np.array([[clean] * n_draws, *disturbed])


@dataclass(frozen=True, eq=False)
class RenderedLooks:
    """Images of a `TrueView` from one displacement, as a `Look` is disturbed.

    A look of the simulated scene is disturbed, and what that did to its lens, its sensor, its
    camera's place and its grey levels is done to the rendered image, with the camera's noise.
    """

    view: Any
    displacement: Array
    noise: float

    @cached_property
    def _clean(self) -> Array:
        return self.view.image(self.displacement)

    @property
    def undisturbed(self) -> Look:
        """What the disturbances change."""
        height, width = self.view.keyframe.reference_image.shape
        scene = Scene(image_size=int(np.clip(max(height, width), 16, 2048)))
        return Look(scene, image_shape=(height, width))

    def image(self, look: Look, rng: np.random.Generator) -> NDArray[np.uint8]:
        """The image of a disturbed look, (height, width); `rng` draws the camera's noise."""
        mount, trained, seen = self.view.keyframe.mount, self.undisturbed.scene, look.scene
        clean = self._clean
        if not np.array_equal(look.departure, np.eye(4)):
            moved = mount @ look.departure @ inverse_transform(mount)
            clean = self.view.image(self.displacement @ moved)
        grey = self._through(seen.lens, clean)
        more_blur = np.sqrt(max(seen.sensor.blur**2 - trained.sensor.blur**2, 0.0))
        gain = seen.sensor.gain / trained.sensor.gain
        hidden = 0.0 if seen.covering is None else seen.covering.share
        places = np.random.default_rng(0 if seen.covering is None else seen.covering.seed)
        disturbances = Disturbances.only(
            defocus=REFERENCE_WIDTH * more_blur, gain=gain, covering=hidden
        )
        disturbed = disturbances.disturb_grey(grey, places).astype(float)
        disturbed += added_noise(grey.shape, gain * self.noise, rng)
        if look.added_noise is not None:
            disturbed += look.added_noise
        return np.rint(disturbed.clip(0, 255)).astype(np.uint8)

    def _through(self, lens: Any, image: Array) -> Array:
        """The image through a lens that differs from that of training as `lens` does."""
        trained = self.undisturbed.scene.lens
        if lens == trained:
            return image
        camera = self.view.keyframe.camera
        dx, dy = np.subtract(lens.principal_point, trained.principal_point)
        k1, k2 = np.subtract(lens.distortion, trained.distortion)
        changed = CameraModel(
            camera.f * lens.focal_length / trained.focal_length,
            camera.cx + dx, camera.cy + dy, camera.k1 + k1, camera.k2 + k2,
        )  # fmt: skip
        view = View.of(image, image.shape[1], 0.0)
        rays, _ = changed.rays(view.points)
        points = np.column_stack([rays, np.ones(len(rays))]).reshape(*view.shape, 3)
        return np.asarray(sample_at(image, camera, points, cv2.BORDER_REFLECT))
