"""The reference view as a calibrated keyframe."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.dofs import check_dofs, mask_of
from servoscope.keyframe.adjustment import Priors, observable, sees_translations
from servoscope.keyframe.alignment import Aligner, Alignment
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.checks import (
    check_arrays,
    check_images,
    check_like,
    check_names,
    check_numbers,
    checked_noise,
    rigid,
    rigid_stack,
)
from servoscope.keyframe.fitting import (
    Known,
    chosen_images,
    evenly_spread,
    fit_state,
    turning_state,
)
from servoscope.keyframe.levels import View
from servoscope.keyframe.limit import ViewLimit, pixel_noise, view_limit
from servoscope.keyframe.motion import conjugate
from servoscope.keyframe.rendering import Renderer
from servoscope.poses import DOFS, displacements_from_poses, inverse_transform
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

MOST_READ = 30
"""Most of the fitted images from which the keyframe's own errors are found."""

_OPTIMISM, _FAR = 1.25, 1e-6


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
    dofs : tuple of str
        The degrees of freedom that are read. The camera is taken to be displaced in no others:
        images that move in few dofs do not inform lens, mount and depth enough to read all.

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
    dofs: tuple[str, ...] = DOFS

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
        noise: float | None = None,
        dofs: Iterable[str] = DOFS,
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
        noise : float, optional
            Standard deviation of a pixel's noise, [grey]; found in the smoothest parts of the
            images by default, which takes fine texture for noise where it is everywhere.
        dofs : iterable of str
            The degrees of freedom that the images are displaced in, beyond the noise of the poses.

        Returns
        -------
        Keyframe

        Raises
        ------
        InvalidInputError
            If shapes disagree, a pose is not rigid, a number is out of its range, or there are
            fewer than `LEAST_IMAGES` images.
        """
        check_numbers(pivot=pivot, distance=distance, pose_noise=pose_noise)
        check_images(images, reference_image)
        T_world_cam = rigid("T_world_cam", T_world_cam, (len(images), 4, 4))
        displacements = inverse_transform(rigid("T_world_ref", T_world_ref)) @ T_world_cam
        start = None if mount is None else rigid("mount", mount)
        known = Known(camera, start, distance)
        priors = Priors(pose=pose_noise)
        if camera is not None:
            priors = replace(priors, camera=(0.0,) * 5)
        chosen = chosen_images(displacements, distance)
        with one_blas_thread():
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
            pixel_noise(images[chosen]) if noise is None else checked_noise(noise),
            check_dofs(dofs),
        )
        if keyframe._reads_only_rotations():
            lever = np.zeros(3) if start is None else start[:3, 3]
            with one_blas_thread():
                turning = turning_state(
                    state, lever, images[chosen], displacements[chosen], reference_image, priors
                )
            keyframe = replace(
                keyframe,
                camera=turning.state.camera,
                mount=turning.state.mount,
                inverse_depth=np.full_like(keyframe.inverse_depth, _FAR),
                trust=np.asarray(turning.trust, dtype=np.float32),
                residual=turning.cost,
            )
        with one_blas_thread():
            return replace(keyframe, model_error=keyframe._find_model_error(images[chosen]))

    def _find_model_error(self, images: NDArray[np.uint8]) -> Array:
        """Robust deviation of what is read of the fitted images, beyond what each explains."""
        outer = np.arange(len(images) // 2, len(images))  # near ones show the noise of the poses
        squares = []
        for k in evenly_spread(outer, MOST_READ):
            D = self.displacements[k]
            found = self.aligner.align(images[k], D[None])
            (reported,) = displacements_from_poses(np.eye(4), D[None], self.pivot)
            shift = self.aligner.view_shift(conjugate(self.mount, D))
            beyond = (found.delta_p - reported) ** 2 - np.diag(found.covariance)
            beyond[~mask_of(self.dofs)] = 0
            squares.append(beyond / max(shift, 1e-3) ** 2)
        return _OPTIMISM * 1.4826 * np.sqrt(np.maximum(np.median(squares, axis=0), 0))

    def _reads_only_rotations(self) -> bool:
        """Whether translations are not seen in the images, but a rotation may be."""
        if self.dofs == DOFS:
            return not self.observable["depth"]
        rotates = any(dof.startswith("r") for dof in self.dofs)
        return rotates and not sees_translations(self.covariance)

    @property
    def observable(self) -> dict[str, bool]:
        """Whether the images inform depth, mount_translation, mount_rotation and focal_length.

        Where only some `dofs` are read they do not have to: depth is known up to a factor that
        the focal length shares unless the images are displaced along, or tilt, the optical axis.
        """
        found = observable(self.covariance)
        found["depth"] &= bool({"tz", "rx", "ry"} & set(self.dofs))
        return found

    @cached_property
    def aligner(self) -> Aligner:
        """What aligns images, at all its resolutions."""
        return Aligner(
            self.reference_image, self.camera, self.mount, self.inverse_depth, self.trust,
            self.displacements, self.pivot, self.model_error, self.dofs,
        )  # fmt: skip

    @cached_property
    def _renderers(self) -> dict[int, Renderer]:
        return {}

    def align(self, image: NDArray[np.uint8], start: ArrayLike | None = None) -> Alignment:
        """Where an image was taken.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
            As large as the reference image.
        start : array of shape (4, 4) or (n, 4, 4), optional
            First guesses of the displacement, the best first. Without any the displacements of
            the fitted images are tried.

        Returns
        -------
        Alignment

        Raises
        ------
        InvalidInputError
            If the image is not as large as the reference image, or the start is not rigid.
        """
        check_like(image, self.reference_image)
        starts = None if start is None else rigid_stack("start", start)
        with one_blas_thread():
            return self.aligner.align(image, starts)

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
        grey, known = self.render_grey(displacement, width)
        return np.rint(grey).astype(np.uint8), known

    def render_grey(
        self, displacement: ArrayLike, width: int | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """As `render`, but grey levels that are not rounded, float64."""
        width = width or self.reference_image.shape[1]
        if width not in self._renderers:
            view = View.of(self.reference_image, width, 0.0)
            self._renderers[width] = Renderer(view, self.camera, self.inverse_depth)
        T = inverse_transform(conjugate(self.mount, rigid("displacement", displacement)))
        return self._renderers[width](T)

    def limit(self, noise: float | None = None) -> ViewLimit:
        """How accurate one look at the reference can be at best, from its interaction matrix.

        Parameters
        ----------
        noise : float, optional
            Standard deviation of a pixel's noise, [grey]; `self.noise` by default.

        Returns
        -------
        ViewLimit
        """
        noise = self.noise if noise is None else checked_noise(noise)
        by_twist = self.aligner.by_twist(np.eye(4))
        return view_limit(
            self.reference_image, self.camera, self.inverse_depth, by_twist, noise,
            mask_of(self.dofs),
        )  # fmt: skip

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All that makes the keyframe, as arrays of numbers."""
        values = vars(self) | {"camera": self.camera.values, "dofs": mask_of(self.dofs)}
        return {f.name: np.asarray(values[f.name]) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Keyframe:
        """The keyframe that `to_arrays` made them of.

        Raises
        ------
        InvalidInputError
            If they are not arrays of a keyframe.
        """
        names = [f.name for f in fields(cls)]
        arrays = {"dofs": mask_of(DOFS), **arrays}  # as keyframes were before: they read all
        check_names(names, arrays)
        values: dict[str, Any] = {name: np.asarray(arrays[name]) for name in names}
        check_arrays(values)
        scalars = {name: float(values[name]) for name in ("pivot", "residual", "noise")}
        camera = CameraModel(*map(float, values["camera"]))
        dofs = tuple(dof for dof, is_read in zip(DOFS, values["dofs"], strict=True) if is_read)
        return cls(**values | scalars | {"camera": camera, "dofs": dofs})
