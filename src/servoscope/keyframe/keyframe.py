"""The reference view as a calibrated keyframe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from servoscope.errors import InvalidInputError
from servoscope.keyframe.adjustment import LEAST_INVERSE_DEPTH, MOUNT, OPTICS, PLANE, Priors
from servoscope.keyframe.alignment import Aligner, Alignment
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.fitting import Known, chosen_images, fit_state
from servoscope.keyframe.levels import EVEN_LIGHT, Guess, Level
from servoscope.keyframe.limit import ViewLimit, cramer_rao, pixel_noise
from servoscope.keyframe.motion import conjugate
from servoscope.keyframe.rendering import draw, project
from servoscope.keyframe.views import View
from servoscope.keyframe.warping import LIGHT, MOTION
from servoscope.poses import displacements_from_poses, inverse_transform, is_rigid

Array = NDArray[np.float64]

LEAST_IMAGES = 6
"""Fewest images that a keyframe is fitted to."""

LEAST_SIDE = 32
"""Fewest rows and columns of an image, [px]."""

MOST_READ = 30
"""Most of the fitted images from which the keyframe's own errors are found."""

_OPTIMISM = 1.25
_SURE = 0.3
_JUMP = 0.03


@dataclass(frozen=True, eq=False)
class Keyframe:
    """The reference image with all that is needed to see it from elsewhere.

    Fitted to a few images at known displacements; neither the camera, nor how it sits on the
    robot, nor the shape of the part need be known.

    Parameters
    ----------
    reference_image : ndarray of shape (height, width), uint8
    camera : CameraModel
    mount : ndarray of shape (4, 4)
        Camera coordinates to those of the frame whose poses the robot reports, [m].
    inverse_depth : ndarray of shape (rows, columns), float32
        Over the reference image, at a lower resolution, [1 / m].
    trust : ndarray of shape (rows, columns), float32
        How well the images agree with each pixel, 0 to 1.
    displacements : ndarray of shape (n, 4, 4)
        Of the images that were fitted, as reported.
    covariance : ndarray of shape (20, 20)
        Of mount (a twist), reference pose (a twist), camera (ln f, cx, cy, k1, k2), and factor and
        slopes of the relief.
    model_error : ndarray of shape (6,)
        Standard deviation of what is read of each dof, per radian that the view is shifted; at the
        reference the keyframe's own errors vanish.
    pivot : float
        Distance along z of the reported frame of the point that displacements are taken about, [m].
    residual : float
        Mean robust residual of the fitted images at the finest resolution of the fit, [grey].
    noise : float
        Standard deviation of a pixel's noise, [grey].

    Examples
    --------
    A plate half a metre away, seen from 10 mm aside:

    >>> import cv2
    >>> noise = np.random.default_rng(0).normal(size=(96, 128))
    >>> plate = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 4), None, 0, 255, cv2.NORM_MINMAX)
    >>> flat = np.full((48, 64), 2.0, np.float32)
    >>> keyframe = Keyframe(
    ...     plate.astype(np.uint8), CameraModel(1.5), np.eye(4), flat, np.ones_like(flat),
    ...     np.eye(4)[None], np.zeros((20, 20)), np.zeros(6), pivot=0.5, residual=1.0, noise=1.0,
    ... )
    >>> aside = np.eye(4)
    >>> aside[0, 3] = 0.01
    >>> image, known = keyframe.render(aside)
    >>> keyframe.align(image).displacement[:3, 3].round(3) + 0.0
    array([0.01, 0.  , 0.  ])
    """

    reference_image: NDArray[np.uint8]
    camera: CameraModel
    mount: Array
    inverse_depth: NDArray[np.float32]
    trust: NDArray[np.float32]
    displacements: Array
    covariance: Array
    model_error: Array
    pivot: float
    residual: float
    noise: float

    @classmethod
    def fit(
        cls,
        images: NDArray[np.uint8],
        T_world_cam: ArrayLike,
        reference_image: NDArray[np.uint8],
        T_world_ref: ArrayLike,
        *,
        pivot: float = 0.55,
        camera: CameraModel | None = None,
        mount: ArrayLike | None = None,
        distance: float = 0.55,
        pose_noise: tuple[float, float] = (3e-4, 5e-4),
    ) -> Keyframe:
        """A keyframe from images at known displacements.

        Parameters
        ----------
        images : ndarray of shape (n, height, width), uint8
            Twenty to forty, spread over the range that is to be covered.
        T_world_cam : array of shape (n, 4, 4)
            The pose of each, of the camera or of any frame that is rigidly joined to it, [m].
        reference_image : ndarray of shape (height, width), uint8
        T_world_ref : array of shape (4, 4)
        pivot : float
            What displacements are taken about, along z of the reported frame, [m].
        camera : CameraModel, optional
            If it is known.
        mount : array of shape (4, 4), optional
            Roughly, if it is known: camera coordinates to those of the reported frame, [m].
        distance : float
            Of the part from the camera, within a factor of two or so, [m].
        pose_noise : tuple of 2 floats
            Standard deviations of the reported poses, [m] and [rad]: the repeatability of a
            robot, the noise of a tracker.

        Returns
        -------
        Keyframe

        Raises
        ------
        InvalidInputError
            If shapes disagree, a pose is not rigid, a number is out of its range, or there are
            fewer than `LEAST_IMAGES` images.
        """
        _check_numbers(pivot=pivot, distance=distance, pose_noise=pose_noise)
        _check_images(images, reference_image)
        T_world_cam, T_world_ref = _poses(T_world_cam, T_world_ref, len(images))
        displacements = inverse_transform(T_world_ref) @ T_world_cam
        known = Known(camera, _checked_mount(mount), distance)
        priors = Priors(pose=pose_noise)
        if camera is not None:
            priors = replace(priors, camera=(0.0,) * 5)
        chosen = chosen_images(displacements, distance)
        with threadpool_limits(1):
            solution = fit_state(
                images[chosen], displacements[chosen], reference_image, known, priors
            )
        state = solution.state
        keyframe = cls(
            np.array(reference_image),
            state.camera,
            state.mount,
            np.asarray(state.relief, dtype=np.float32),
            np.asarray(solution.trust, dtype=np.float32),
            displacements[chosen],
            solution.covariance,
            np.zeros(6),
            float(pivot),
            solution.cost,
            pixel_noise(images[chosen]),
        )
        if not keyframe.observable["depth"]:  # only rotations are read from images
            flat = np.full_like(keyframe.inverse_depth, LEAST_INVERSE_DEPTH)
            keyframe = replace(keyframe, inverse_depth=flat)
        return replace(keyframe, model_error=keyframe._find_model_error(images[chosen]))

    def _find_model_error(self, images: NDArray[np.uint8]) -> Array:
        """Robust deviation of what is read of the fitted images, beyond what each explains."""
        some = np.linspace(0, len(images) - 1, min(len(images), MOST_READ)).round().astype(int)
        squares = []
        for k in some:
            D = self.displacements[k]
            found = self._aligner.align(images[k], D)
            (reported,) = displacements_from_poses(np.eye(4), D[None], self.pivot)
            shift = self._aligner.view_shift(conjugate(self.mount, D))
            beyond = (found.delta_p - reported) ** 2 - np.diag(found.covariance)
            squares.append(beyond / max(shift, 1e-3) ** 2)
        return _OPTIMISM * 1.4826 * np.sqrt(np.maximum(np.median(squares, axis=0), 0))

    @property
    def observable(self) -> dict[str, bool]:
        """Whether the images inform the depth, the mount's translation and turn, the focal length.

        Something is observable if its standard deviation is below 0.3 of what was assumed before.
        """
        std, before = np.sqrt(np.diag(self.covariance)), Priors()
        shares = {
            "depth": std[PLANE][0],
            "mount_translation": std[MOUNT][:3].max() / before.mount[0],
            "mount_rotation": std[MOUNT][3:].max(),
            "focal_length": std[OPTICS][0] / before.camera[0],
        }
        return {name: bool(share < _SURE) for name, share in shares.items()}

    @cached_property
    def _aligner(self) -> Aligner:
        return Aligner(
            self.reference_image, self.camera, self.mount, self.inverse_depth, self.trust,
            self.displacements, self.pivot, self.model_error,
        )  # fmt: skip

    def align(self, image: NDArray[np.uint8], start: ArrayLike | None = None) -> Alignment:
        """Where an image was taken.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
            As large as the reference image.
        start : array of shape (4, 4), optional
            A first guess of the displacement. Without it the displacements of the fitted images
            are tried.

        Returns
        -------
        Alignment

        Raises
        ------
        InvalidInputError
            If the image is not as large as the reference image, or the start is not rigid.
        """
        self._check_image(image)
        if start is not None:
            start = self._check_displacement(start)
        return self._aligner.align(image, start)

    def render(
        self, displacement: ArrayLike, width: int | None = None
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """What would be seen at a displacement, and where that is known.

        Parameters
        ----------
        displacement : array of shape (4, 4)
            ``inv(T_world_ref) @ T_world_cam`` of the reported poses, [m].
        width : int, optional
            Of the image; that of the reference image by default.

        Returns
        -------
        image : ndarray of shape (height, width), uint8
        known : ndarray of shape (height, width), bool
            False where the reference image does not show what would be seen; the image is 0 there.
        """
        displacement = self._check_displacement(displacement)
        width = width or self.reference_image.shape[1]
        view = View.of(self.reference_image, width, 0.0)
        depth = view.resize(self.inverse_depth).astype(float)
        rays, _ = self.camera.rays(view.points)
        seen = np.empty((len(rays), 3))
        T = inverse_transform(conjugate(self.mount, displacement))
        project(T, self.camera.values, view.aspect, rays, depth.ravel(), seen)
        image, nearness = np.zeros(view.shape), np.zeros(view.shape)
        draw(
            view.grey.astype(float), seen.reshape(*view.shape, 3), depth, view.aspect,
            _JUMP, image, nearness,
        )  # fmt: skip
        return np.rint(image.clip(0, 255)).astype(np.uint8), nearness > 0

    def limit(self, noise: float | None = None) -> ViewLimit:
        """What one look at the reference can tell at best, from its interaction matrix.

        Parameters
        ----------
        noise : float, optional
            Standard deviation of a pixel's noise, [grey]; `self.noise` by default.

        Returns
        -------
        ViewLimit
        """
        noise = self.noise if noise is None else noise
        if not noise > 0:
            raise InvalidInputError(f"noise must be positive, in grey levels, got {noise}.")
        view = View.of(self.reference_image, self.reference_image.shape[1], 0.5)
        depth = view.resize(self.inverse_depth)
        level = Level(view, self.camera, depth, np.ones_like(depth))
        J, _, _, _ = level.linearise(view.grey, Guess(np.eye(4), EVEN_LIGHT))
        by_delta_p = J[:, MOTION] @ np.linalg.inv(self._aligner.by_twist(np.eye(4)))
        light = J[:, LIGHT][:, :2]
        return cramer_rao(np.hstack([by_delta_p, light]), noise, view.shape)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All that makes the keyframe, as arrays of numbers."""
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        return arrays | {"camera": self.camera.values}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Keyframe:
        """The keyframe that `to_arrays` made them of.

        Raises
        ------
        InvalidInputError
            If they are not arrays of a keyframe.
        """
        names = [f.name for f in fields(cls)]
        if missing := sorted(set(names) - set(arrays)):
            raise InvalidInputError(
                f"A keyframe consists of {', '.join(names)}; {', '.join(missing)} is missing."
            )
        values: dict[str, Any] = {name: np.asarray(arrays[name]) for name in names}
        _check_arrays(values)
        for name in ("pivot", "residual", "noise"):
            values[name] = float(values[name])
        return cls(**values | {"camera": CameraModel(*map(float, values["camera"]))})

    def _check_image(self, image: NDArray[np.uint8]) -> None:
        if getattr(image, "shape", None) != self.reference_image.shape or image.dtype != np.uint8:
            raise InvalidInputError(
                f"The image must be uint8 of shape {self.reference_image.shape}, like the "
                f"reference image, got {_describe(image)}."
            )

    @staticmethod
    def _check_displacement(displacement: ArrayLike) -> Array:
        D = np.asarray(displacement, dtype=float)
        if D.shape != (4, 4) or not np.isfinite(D).all() or not is_rigid(D):
            raise InvalidInputError(
                "A displacement must be a rigid transform of shape (4, 4), in metres, got "
                f"{_describe(D)}."
            )
        return D


def _describe(array: Any) -> str:
    return f"{getattr(array, 'dtype', type(array).__name__)} of shape {np.shape(array)}"


def _check_images(images: NDArray[np.uint8], reference_image: NDArray[np.uint8]) -> None:
    for name, array, n_axes in (("images", images, 3), ("reference_image", reference_image, 2)):
        if getattr(array, "ndim", 0) != n_axes or array.dtype != np.uint8:
            raise InvalidInputError(
                f"{name} must be a uint8 array with {n_axes} axes, got {_describe(array)}."
            )
    if images.shape[1:] != reference_image.shape or min(reference_image.shape) < LEAST_SIDE:
        raise InvalidInputError(
            f"Images must be as large as the reference image and at least {LEAST_SIDE} px a side, "
            f"got {images.shape[1:]} and {reference_image.shape}."
        )
    if len(images) < LEAST_IMAGES:
        raise InvalidInputError(
            f"A keyframe needs at least {LEAST_IMAGES} images, got {len(images)}; take some more."
        )


def _poses(T_world_cam: ArrayLike, T_world_ref: ArrayLike, n: int) -> tuple[Array, Array]:
    poses = np.asarray(T_world_cam, dtype=float), np.asarray(T_world_ref, dtype=float)
    names = ("T_world_cam", "T_world_ref")
    for name, T, shape in zip(names, poses, ((n, 4, 4), (4, 4)), strict=True):
        if T.shape != shape or not np.isfinite(T).all() or not is_rigid(T):
            raise InvalidInputError(
                f"{name} must hold rigid transforms of shape {shape}, in metres, got "
                f"{_describe(T)}."
            )
    return poses


def _checked_mount(mount: ArrayLike | None) -> Array | None:
    if mount is None:
        return None
    T = np.asarray(mount, dtype=float)
    if T.shape != (4, 4) or not np.isfinite(T).all() or not is_rigid(T):
        raise InvalidInputError(
            f"mount must be a rigid transform of shape (4, 4), in metres, got {_describe(T)}."
        )
    return T


def _check_numbers(pivot: float, distance: float, pose_noise: tuple[float, float]) -> None:
    if not np.isfinite(pivot):
        raise InvalidInputError(f"pivot must be a finite distance in metres, got {pivot}.")
    if not 0 < distance < np.inf:
        raise InvalidInputError(f"distance must be positive, in metres, got {distance}.")
    if len(pose_noise) != 2 or not all(0 < s < np.inf for s in pose_noise):
        raise InvalidInputError(
            f"pose_noise must be two positive deviations, in metres and radians, got {pose_noise}."
        )


def _check_arrays(values: dict[str, Any]) -> None:
    """Raise InvalidInputError unless the arrays fit together as those of a keyframe."""
    image, depth = values["reference_image"], values["inverse_depth"]
    n_fitted = len(values["displacements"]) if values["displacements"].ndim else 0
    shapes = {
        "camera": (5,), "mount": (4, 4), "trust": depth.shape, "covariance": (20, 20),
        "model_error": (6,),
        "displacements": (n_fitted, 4, 4), "pivot": (), "residual": (), "noise": (),
    }  # fmt: skip
    wrong = [name for name, shape in shapes.items() if values[name].shape != shape]
    wrong += [name for name in shapes if values[name].dtype.kind != "f"]
    wrong += [name for name in shapes if name not in wrong and not np.isfinite(values[name]).all()]
    if image.dtype != np.uint8 or image.ndim != 2 or min(image.shape) < LEAST_SIDE:
        wrong.append("reference_image")
    if depth.ndim != 2 or depth.dtype.kind != "f" or not (depth > 0).all():
        wrong.append("inverse_depth")
    wrong += [n for n in ("mount", "displacements") if n not in wrong and not is_rigid(values[n])]
    if wrong:
        raise InvalidInputError(
            f"These are not the arrays of a keyframe: {', '.join(dict.fromkeys(wrong))} "
            "has another type, shape or range; fit it again."
        )
