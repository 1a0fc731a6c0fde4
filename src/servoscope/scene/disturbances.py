"""What may differ between training and use: one catalogue, for images and for the simulated cell.

A strength means the same for every image size and every use. A blur is the standard deviation of a
Gaussian in pixels of an image `REFERENCE_WIDTH` wide, on top of what there is: the same share of
the view in images of every size. A gain is a factor of all that is there. Noise is the standard
deviation of what is added to each pixel by itself, in grey levels of the image, on top of what
there is; whatever the size, so that making an image smaller lowers it.

`Disturbances` changes images; `DISTURBANCES` change what is simulated, each in strengths of its own
unit; the conditions of the scoreboard are made of the same functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS, rigid_transform
from servoscope.scene.camera import Covering, Sensor, draw_rectangle
from servoscope.scene.lighting import Lighting
from servoscope.scene.scene import Scene

REFERENCE_WIDTH = 256
"""Width of the images that pixels are given for, [px]."""


def as_widths(px: float) -> float:
    """A length in pixels of an image `REFERENCE_WIDTH` wide, [image widths].

    Examples
    --------
    >>> as_widths(2.0) * 128
    1.0
    """
    return px / REFERENCE_WIDTH


def defocused(sensor: Sensor, px: float) -> Sensor:
    """The sensor behind a lens that blurs by a standard deviation more, [px of 256]."""
    return replace(sensor, blur=float(np.hypot(sensor.blur, as_widths(px))))


def amplified(sensor: Sensor, gain: float) -> Sensor:
    """The sensor with so many times its gain; its noise is amplified as well."""
    return replace(sensor, gain=gain * sensor.gain)


def noisier(sensor: Sensor, grey: float) -> Sensor:
    """The sensor with noise of a standard deviation on top of its own, [grey]."""
    electrons = grey / (255 * sensor.gain) * sensor.full_well
    return replace(sensor, read_noise=float(np.hypot(sensor.read_noise, electrons)))


def with_lamp_moved(lighting: Lighting, shift: ArrayLike) -> Lighting:
    """The lights with the first lamp moved, [m]."""
    first, *others = lighting.lamps
    x, y, z = np.add(first.position, shift).tolist()
    return replace(lighting, lamps=(replace(first, position=(x, y, z)), *others))


def blur_image(grey: NDArray[np.float32], px: float) -> None:
    """Blur an image in place by a standard deviation, [px of 256]."""
    sigma = as_widths(px) * grey.shape[1]
    cv2.GaussianBlur(grey, (0, 0), sigma, dst=grey, borderType=cv2.BORDER_REPLICATE)


def added_noise(
    shape: tuple[int, ...], grey: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """White noise of a standard deviation, to be added to an image, [grey]."""
    return np.float32(grey) * rng.standard_normal(shape, np.float32)


_LIGHT_KNOTS = 3
_ASPECTS = (0.4, 2.5)


Strength = tuple[float, float, float]
"""How strong a disturbance is, evenly drawn between two bounds, and how probable it is."""


@dataclass(frozen=True)
class Disturbances:
    """Random changes of an image that have nothing to do with where the camera is.

    They are made in the order of light: defocus, the light and its gain and offset, what covers
    the view, noise. Any of them may be None, which is never made. What a strength means stands in
    `servoscope.scene.disturbances`.

    Parameters
    ----------
    defocus : Strength, optional
        Standard deviation of a Gaussian blur, [px] in images 256 pixels wide; in proportion to
        the width in others.
    light : Strength, optional
        Standard deviation of the logarithm of a smooth field that the image is multiplied with.
    gain : Strength, optional
        Factor of all grey levels.
    offset : Strength, optional
        Added to all grey levels.
    covering : Strength, optional
        Share of the view behind a rectangle of one grey.
    noise : Strength, optional
        Standard deviation of what is added to each pixel by itself, [grey].

    Examples
    --------
    >>> image = np.full((64, 64), 100, np.uint8)
    >>> Disturbances.only(gain=0.8, offset=5).disturb(image, np.random.default_rng(0))[0, 0]
    np.uint8(85)
    >>> bool(Disturbances().disturb(image, np.random.default_rng(0)).std() > 1)
    True
    """

    defocus: Strength | None = (0.3, 2.5, 0.5)
    light: Strength | None = (0.0, 0.3, 0.9)
    gain: Strength | None = (0.6, 1.3, 0.9)
    offset: Strength | None = (-10.0, 10.0, 0.9)
    covering: Strength | None = (0.0, 0.25, 0.7)
    noise: Strength | None = (0.0, 14.0, 0.5)

    def __post_init__(self) -> None:
        for part in fields(self):
            strength = getattr(self, part.name)
            if strength is not None:
                _check(part.name, *strength)

    @classmethod
    def only(cls, **strengths: float) -> Disturbances:
        """Those that are named, always there and of the strength that is given."""
        absent: dict[str, Strength | None] = dict.fromkeys(part.name for part in fields(cls))
        unknown = set(strengths) - set(absent)
        if unknown:
            raise InvalidInputError(
                f"Disturbances are {', '.join(absent)}, got {', '.join(sorted(unknown))}."
            )
        return cls(**absent | {name: (at, at, 1.0) for name, at in strengths.items()})

    def disturb(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        """The image, uint8, with disturbances drawn from `rng`; the same state gives the same
        image.
        """
        return np.rint(self.disturb_grey(image, rng).clip(0, 255)).astype(np.uint8)

    def disturb_grey(self, image: NDArray[Any], rng: np.random.Generator) -> NDArray[np.float32]:
        """As `disturb`, but grey levels that are neither rounded nor cut off."""
        grey = image.astype(np.float32)
        strength = {part.name: _draw(getattr(self, part.name), rng) for part in fields(self)}
        if strength["defocus"]:
            blur_image(grey, strength["defocus"])
        if strength["light"]:
            grey *= _light_field(grey.shape, strength["light"], rng)
        if strength["gain"] is not None:
            grey *= np.float32(strength["gain"])
        if strength["offset"] is not None:
            grey += np.float32(strength["offset"])
        if strength["covering"]:
            _cover(grey, strength["covering"], rng)
        if strength["noise"]:
            grey += added_noise(grey.shape, strength["noise"], rng)
        return grey


def _check(name: str, low: float, high: float, probability: float) -> None:
    least = -255.0 if name == "offset" else 0.0
    most = {"covering": 1.0, "light": 2.0, "gain": 100.0}.get(name, 255.0)
    if not least <= low <= high <= most or not 0 <= probability <= 1:
        raise InvalidInputError(
            f"The strength of {name} must be from {least:g} to {most:g}, the lower bound first, "
            f"and its probability from 0 to 1, got {(low, high, probability)}."
        )


def _draw(strength: Strength | None, rng: np.random.Generator) -> float | None:
    """A strength between the bounds, or None where the disturbance is not there."""
    if strength is None or rng.random() >= strength[2]:
        return None
    return float(rng.uniform(*strength[:2]))


def _light_field(
    shape: tuple[int, ...], deviation: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    knots = rng.standard_normal((_LIGHT_KNOTS, _LIGHT_KNOTS), np.float32) * np.float32(deviation)
    field = cv2.resize(knots, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(cv2.exp(field), dtype=np.float32)


def _cover(grey: NDArray[np.float32], share: float, rng: np.random.Generator) -> None:
    """Draw a rectangle of one grey; its height is rounded so that its area is that share."""
    place = draw_rectangle(grey.shape, share, _ASPECTS, rng)
    grey[place] = rng.uniform(0, 255)


SINGLE_DISTURBANCES = {
    "gain": Disturbances.only(gain=0.8),
    "offset": Disturbances.only(offset=8.0),
    "light": Disturbances.only(light=0.2),
    "noise": Disturbances.only(noise=10.0),
    "defocus": Disturbances.only(defocus=2.0),
    "covering": Disturbances.only(covering=0.1),
}
"""One disturbance each, of a fixed strength, to measure with."""


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Look:
    """What one image is taken of, and from where:

    the scene, where the camera is in the frame of where it would be undisturbed, noise on top of
    the sensor's own in grey levels, and the height and width of the image, by default those of the
    scene.
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
    lighting = with_lamp_moved(look.scene.lighting, 1e-3 * mm * np.eye(3)[axis])
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
`servoscope.scene.disturbances`. ``covering`` hides a rectangle of one grey, whose area
goes with the square of the strength; ``principal_point_x`` and ``_y`` move the image;
``distortion_k1`` adds to k1; ``light_x`` and ``light_z`` move the first lamp along the part and
upwards; ``repeatability_mm`` and ``_deg`` are deviations along and about each axis on top of
those in training; ``hand_eye_*`` moves the camera on its flange, along or about an axis of its
own."""
