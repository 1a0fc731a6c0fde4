"""What may change between training and use, and by how much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS, rigid_transform
from servoscope.scene.covering import Covering
from servoscope.scene.scene import Scene
from servoscope.scene.sensor import Sensor
from servoscope.scene.strengths import (
    REFERENCE_WIDTH,
    amplified,
    as_widths,
    defocused,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Look:
    """What one image is taken of, and from where.

    Parameters
    ----------
    scene : Scene
    departure : ndarray of shape (4, 4)
        Where the camera is, in the frame of where it would be undisturbed, [m].
    added_noise : ndarray of shape `image_shape`, optional
        Noise on top of the sensor's own, [grey levels].
    image_shape : tuple of 2 ints, optional
        Height and width, [px]; that of the scene by default.
    """

    scene: Scene
    departure: Array = field(default_factory=lambda: np.eye(4))
    added_noise: Array | None = None
    image_shape: tuple[int, int] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the image, [px]."""
        return self.image_shape or (self.scene.image_size, self.scene.image_size)


Change = Callable[[Look, float, np.random.Generator], Look]
"""Makes of an undisturbed look the look at a strength; what is random comes from the generator."""


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Something that is not as it was in training.

    Parameters
    ----------
    change : callable
        ``change(look, strength, rng)``; leaves the look as it is at strength 0.
    unit : str
        Of the strength.
    strengths : tuple of float
        Those that are simulated, without 0; of two sizes at the least.
    power : {1, 2}
        To first order the image changes with this power of the strength: 2 where a negative
        strength would be the same as a positive one.
    is_random : bool
        Whether every image is changed in another way, drawn anew.

    Raises
    ------
    InvalidInputError
        If the strengths are not of two sizes, one is 0 or not finite, or the power not 1 or 2.
    """

    change: Change
    unit: str
    strengths: tuple[float, ...]
    power: int = 1
    is_random: bool = False

    def __post_init__(self) -> None:
        sizes = {abs(s) for s in self.strengths}
        if len(sizes) < 2 or not all(s > 0 and np.isfinite(s) for s in sizes):
            raise InvalidInputError(
                "strengths must be finite numbers other than 0, of two sizes at the least, "
                f"got {self.strengths}."
            )
        if self.power not in (1, 2):
            raise InvalidInputError(f"power must be 1 or 2, got {self.power!r}.")

    @property
    def steps(self) -> tuple[float, float]:
        """The two smallest strengths without their signs; derivatives are differences over them."""
        smallest, *others = sorted({abs(s) for s in self.strengths})
        return smallest, others[0]


def _lens(look: Look, **values: Any) -> Look:
    return replace(look, scene=replace(look.scene, lens=replace(look.scene.lens, **values)))


def _sensor(look: Look, sensor: Sensor) -> Look:
    return replace(look, scene=replace(look.scene, sensor=sensor))


def _focal_length(look: Look, percent: float, rng: np.random.Generator) -> Look:
    return _lens(look, focal_length=look.scene.lens.focal_length * (1 + percent / 100))


def _principal_point(look: Look, px: float, rng: np.random.Generator, *, axis: int) -> Look:
    point = list(look.scene.lens.principal_point)
    point[axis] += as_widths(px)
    return _lens(look, principal_point=tuple(point))


def _distortion(look: Look, k1: float, rng: np.random.Generator) -> Look:
    first, second = look.scene.lens.distortion
    return _lens(look, distortion=(first + k1, second))


def _gain(look: Look, percent: float, rng: np.random.Generator) -> Look:
    return _sensor(look, amplified(look.scene.sensor, 1 + percent / 100))


def _defocus(look: Look, px: float, rng: np.random.Generator) -> Look:
    return _sensor(look, defocused(look.scene.sensor, px))


def _noise(look: Look, grey: float, rng: np.random.Generator) -> Look:
    return replace(look, added_noise=grey * rng.standard_normal(look.shape))


def _offset(look: Look, grey: float, rng: np.random.Generator) -> Look:
    return replace(look, added_noise=np.full(look.shape, grey))


def _covering(look: Look, percent: float, rng: np.random.Generator) -> Look:
    if not percent:
        return look
    covering = Covering((percent / 100) ** 2, seed=int(rng.integers(2**31)))
    return replace(look, scene=replace(look.scene, covering=covering))


def _light(look: Look, mm: float, rng: np.random.Generator, *, axis: int) -> Look:
    first, *others = look.scene.lighting.lamps
    position = np.array(first.position)
    position[axis] += 1e-3 * mm
    x, y, z = position.tolist()
    lighting = replace(look.scene.lighting, lamps=(replace(first, position=(x, y, z)), *others))
    return replace(look, scene=replace(look.scene, lighting=lighting))


def _moved(look: Look, translation: Array, rotation: Array) -> Look:
    """The camera moved in its own frame, [m] and rotation vector in [rad]."""
    motion = rigid_transform(Rotation.from_rotvec(rotation).as_matrix(), translation)
    return replace(look, departure=look.departure @ motion)


def _rests_beside(look: Look, mm: float, rng: np.random.Generator) -> Look:
    return _moved(look, 1e-3 * mm * rng.standard_normal(3), np.zeros(3))


def _rests_turned(look: Look, deg: float, rng: np.random.Generator) -> Look:
    return _moved(look, np.zeros(3), np.radians(deg) * rng.standard_normal(3))


def _remounted(look: Look, amount: float, rng: np.random.Generator, *, axis: int) -> Look:
    step = np.zeros(6)
    step[axis] = 1e-3 * amount if axis < 3 else np.radians(amount)
    return _moved(look, step[:3], step[3:])


def _both_ways(*strengths: float) -> tuple[float, ...]:
    return (*(-s for s in reversed(strengths)), *strengths)


_SHIFTS, _TURNS = _both_ways(1.0, 3.0, 10.0), _both_ways(0.1, 0.3, 1.0)
_PIXELS, _LAMP = _both_ways(1.0, 2.0, 4.0, 10.0), _both_ways(20.0, 50.0, 100.0, 300.0)

_PX = f"px of {REFERENCE_WIDTH}"

DISTURBANCES = {
    "focal_length": Disturbance(_focal_length, "%", _both_ways(0.5, 1.0, 2.0, 5.0)),
    "principal_point_x": Disturbance(partial(_principal_point, axis=0), _PX, _PIXELS),
    "principal_point_y": Disturbance(partial(_principal_point, axis=1), _PX, _PIXELS),
    "distortion_k1": Disturbance(_distortion, "1", _both_ways(0.02, 0.05, 0.1, 0.2)),
    "gain": Disturbance(_gain, "%", _both_ways(1.0, 2.0, 5.0, 10.0, 20.0)),
    "offset": Disturbance(_offset, "grey levels", _both_ways(2.0, 5.0, 10.0, 20.0)),
    "covering": Disturbance(
        _covering, "% of the sides", (10.0, 20.0, 30.0, 45.0), power=2, is_random=True
    ),
    "noise": Disturbance(_noise, "grey levels", (1.0, 2.0, 5.0, 10.0, 20.0), is_random=True),
    "defocus": Disturbance(_defocus, _PX, (0.6, 1.0, 1.4, 2.0, 4.0), power=2),
    "light_x": Disturbance(partial(_light, axis=0), "mm", _LAMP),
    "light_z": Disturbance(partial(_light, axis=2), "mm", _LAMP),
    "repeatability_mm": Disturbance(
        _rests_beside, "mm", (0.5, 1.0, 2.0, 5.0, 10.0), is_random=True
    ),
    "repeatability_deg": Disturbance(
        _rests_turned, "deg", (0.05, 0.1, 0.2, 0.5, 1.0), is_random=True
    ),
    **{
        f"hand_eye_{dof}": Disturbance(
            partial(_remounted, axis=axis),
            "mm" if axis < 3 else "deg",
            _SHIFTS if axis < 3 else _TURNS,
        )
        for axis, dof in enumerate(DOFS)
    },
}
"""Every disturbance, by name. What gain, noise, defocus and pixels mean stands in
`servoscope.scene.strengths`. ``covering`` hides a rectangle of one grey, whose area
goes with the square of the strength; ``principal_point_x`` and ``_y`` move the image;
``distortion_k1`` adds to k1; ``light_x`` and ``light_z`` move the first lamp along the part and
upwards; ``repeatability_mm`` and ``_deg`` are deviations along and about each axis on top of
those in training; ``hand_eye_*`` moves the camera on its flange, along or about an axis of its
own."""
