"""Bundle adjustment on grey levels: camera, mount, relief, poses and light of N images at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import View
from servoscope.keyframe.motion import adjoint, conjugate, exponential, logarithm
from servoscope.keyframe.robust import BEND, normal_equations, robust_scale, robust_weights
from servoscope.keyframe.warping import CAMERA, MOTION, N_COLUMNS, RELIEF, UNSEEN, linearise
from servoscope.poses import inverse_transform

Array = NDArray[np.float64]

MOUNT, REFERENCE, OPTICS, PLANE = slice(0, 6), slice(6, 12), slice(12, 17), slice(17, 20)
"""Unknowns that all images share: twists of the mount and of the reference's pose, the camera, and
factor and slopes of the relief."""

N_GLOBAL = 20

N_LOCAL = 10
"""Unknowns of each image: a twist of its pose, and its light."""

_SURE = 0.3


@dataclass(frozen=True)
class Priors:
    """Standard deviations of what is known before any image is seen.

    Parameters
    ----------
    camera : tuple of 5 floats
        Of ln f, cx, cy, k1 and k2; zero holds a parameter.
    principal_and_distortion : tuple of 4 floats
        What is expected of cx, cy, k1 and k2.
    mount : tuple of 2 floats
        Of the mount's translation [m] and rotation [rad], about where it started.
    pose : tuple of 2 floats
        Of the reported poses, [m] and [rad].
    depth : float
        Of a pixel's inverse depth about the smooth relief, relative.
    redundancy : float
        How many pixels count as one: residuals of neighbours are alike.
    """

    camera: tuple[float, float, float, float, float] = (0.7, 0.03, 0.03, 0.15, 0.1)
    principal_and_distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    mount: tuple[float, float] = (0.3, 3.0)
    pose: tuple[float, float] = (3e-4, 5e-4)
    depth: float = 0.05
    redundancy: float = 16.0


@dataclass(frozen=True, eq=False)
class State:
    """All that is adjusted.

    Parameters
    ----------
    camera : CameraModel
    mount : ndarray of shape (4, 4)
        Camera coordinates to those of the frame that the robot reports, [m].
    reference : ndarray of shape (4, 4)
        Correction of the reference's pose, in its camera.
    corrections : ndarray of shape (n, 4, 4)
        Of the images' poses, each in its camera.
    light : ndarray of shape (n, 4)
        Gain, offset, and slopes of the gain.
    relief : ndarray of shape (height, width)
        Inverse depth of the reference image, [1 / m]; of any resolution.
    """

    camera: CameraModel
    mount: Array
    reference: Array
    corrections: Array
    light: Array
    relief: NDArray[np.floating]

    @classmethod
    def start(cls, camera: CameraModel, mount: Array, n: int, inverse_depth: float) -> State:
        """A plane that stands across the view, poses as they are reported, even light."""
        return cls(
            camera,
            mount,
            np.eye(4),
            np.tile(np.eye(4), (n, 1, 1)),
            np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
            np.full((2, 2), inverse_depth),
        )

    def light_at(
        self, i: int, points: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Gain and offset of image i at points of the reference image, (n,) each."""
        gain, offset, right, down = self.light[i].astype(np.float32)
        gains = gain + right * points[:, 0] + down * points[:, 1]
        return gains, np.full_like(gains, offset)

    def transforms(self, displacements: Array) -> Array:
        """Reference camera to each camera, shape (n, 4, 4)."""
        nominal = inverse_transform(conjugate(self.mount, displacements))
        return self.corrections @ nominal @ self.reference


def sees_translations(covariance: Array) -> bool:
    """Whether the images inform how far a translation moves what is seen: focal length / depth.

    Parameters
    ----------
    covariance : ndarray of shape (20, 20)
        Of the unknowns that all images share.
    """
    both = np.zeros(N_GLOBAL)
    both[[OPTICS.start, PLANE.start]] = 1  # ln f, and the factor of inverse depths
    return bool(np.sqrt(both @ covariance @ both) < _SURE)


def observable(covariance: Array) -> dict[str, bool]:
    """What the images inform: its deviation is below 0.3 of what was assumed before.

    Parameters
    ----------
    covariance : ndarray of shape (20, 20)
        Of the unknowns that all images share.
    """
    std, before = np.sqrt(np.diag(covariance)), Priors()
    shares = {
        "depth": std[PLANE][0],
        "mount_translation": std[MOUNT][:3].max() / before.mount[0],
        "mount_rotation": std[MOUNT][3:].max(),
        "focal_length": std[OPTICS][0] / before.camera[0],
    }
    return {name: bool(share < _SURE) for name, share in shares.items()}


Floats = NDArray[np.float32]

LEAST_SCALE = 0.7
"""Residuals are never taken to spread less than this, [grey]."""

LEAST_SEEN = 0.1
"""An image that sees a smaller share of the points is left out, at the cost `WORST_COST`."""

WORST_COST = 30.0


@dataclass(eq=False)
class NormalEquations:
    """Normal equations of all unknowns, and of each pixel's inverse depth."""

    hessian: Array
    gradient: Array
    coupling: Floats | None
    depth: Floats
    depth_hessian: Floats
    depth_gradient: Floats
    weight_sum: Floats
    n_seen: Floats
    scales: Array
    costs: Array

    @classmethod
    def empty(cls, n_images: int, depth: Floats, relief: bool) -> NormalEquations:
        n = N_GLOBAL + N_LOCAL * n_images
        return cls(
            np.zeros((n, n)),
            np.zeros(n),
            np.zeros((len(depth), n), np.float32) if relief else None,
            depth,
            np.zeros_like(depth),
            np.zeros_like(depth),
            np.zeros_like(depth),
            np.zeros_like(depth),
            np.full(n_images, WORST_COST),
            np.full(n_images, WORST_COST),
        )

    @property
    def cost(self) -> float:
        return float(self.costs.mean())

    def add(
        self,
        i: int,
        jacobian: Floats,
        by_depth: Floats,
        residuals: Floats,
        chain: Array,
        redundancy: float,
    ) -> None:
        """Add what image i contributes."""
        seen = residuals > UNSEEN
        n_seen = np.count_nonzero(seen)
        if n_seen < LEAST_SEEN * len(seen):
            return
        scale = robust_scale(residuals, LEAST_SCALE)
        weights = np.empty_like(residuals)
        total = robust_weights(residuals, scale, weights)
        self.scales[i] = scale
        self.costs[i] = BEND * scale * np.sqrt(total / n_seen)
        self.weight_sum += weights
        self.n_seen += seen
        weights /= np.float32(scale * scale * redundancy)
        own = slice(N_GLOBAL + N_LOCAL * i, N_GLOBAL + N_LOCAL * (i + 1))
        H, g = np.empty((N_COLUMNS, N_COLUMNS)), np.empty(N_COLUMNS)
        normal_equations(jacobian, residuals, weights, H, g)
        self.hessian[:N_GLOBAL, :N_GLOBAL] += chain.T @ H @ chain
        self.hessian[:N_GLOBAL, own] = chain.T @ H[:, :N_LOCAL]
        self.hessian[own, :N_GLOBAL] = self.hessian[:N_GLOBAL, own].T
        self.hessian[own, own] = H[:N_LOCAL, :N_LOCAL]
        self.gradient[:N_GLOBAL] += chain.T @ g
        self.gradient[own] = g[:N_LOCAL]
        if self.coupling is not None:
            mixed = jacobian * (weights * by_depth)[:, None]
            self.coupling[:, :N_GLOBAL] += mixed @ chain.astype(np.float32)
            self.coupling[:, own] = mixed[:, :N_LOCAL]
            self.depth_hessian += weights * by_depth * by_depth
            self.depth_gradient -= weights * by_depth * residuals


LEAST_INVERSE_DEPTH = 1e-3
"""[1 / m]."""

PLANE_PRIOR = (1.0, 3.0, 3.0)
"""Standard deviations of a factor of the relief, and of its slopes, [1 / m / image width]."""

LIGHT_PRIOR = (0.5, 30.0, 0.5, 0.5)
"""Standard deviations of gain, offset [grey] and slopes of the gain."""

LONGEST_STEP = np.array(
    [0.05] * 3 + [0.2] * 3 + [np.inf] * 6 + [0.15, 0.05, 0.05, 0.1, 0.1, 0.3, 1.0, 1.0]
)
"""How far a linear model of the unknowns that all images share may be believed."""

_LIGHT = slice(6, 10)


@dataclass(frozen=True, eq=False)
class Solution:
    """A state, and how well it explains the images.

    Parameters
    ----------
    state : State
    cost : float
        Mean over the images of their robust residual, [grey].
    scales : ndarray of shape (n,)
        Robust standard deviation of each image's residuals, [grey].
    trust : ndarray of shape (height, width)
        Mean robust weight of each pixel over the images that see it, 0 to 1.
    covariance : ndarray of shape (20, 20)
        Of the unknowns that all images share.
    """

    state: State
    cost: float
    scales: Array
    trust: Floats
    covariance: Array


@dataclass(eq=False)
class Adjustment:
    """The images of one stage, at one resolution.

    Parameters
    ----------
    view : View
        The reference image.
    images : ndarray of shape (n, height, width), float32
        Prepared alike.
    displacements : ndarray of shape (n, 4, 4)
        As reported.
    priors : Priors
    """

    view: View
    images: Floats
    displacements: Array
    priors: Priors

    def run(
        self,
        state: State,
        n_steps: int,
        *,
        poses: bool = True,
        relief: bool = False,
        tolerance: float = 1e-4,
    ) -> Solution:
        """Adjust by damped Gauss-Newton.

        The mount, the camera, factor and slopes of the relief and the light are always free.

        Parameters
        ----------
        state : State
        n_steps : int
        poses : bool
            Whether the reported poses are corrected.
        relief : bool
            Whether each pixel of the relief is free. Inverse depths are eliminated from the normal
            equations (Schur complement).
        tolerance : float
            A relative gain in cost that is too small to go on for.

        Returns
        -------
        Solution
        """
        system = self._linearise(state, relief)
        damping = 1e-3
        for _ in range(n_steps):
            trial = self._step(state, system, damping, poses)
            next_system = self._linearise(trial, relief)
            gain = system.cost - next_system.cost
            if gain > 0:
                state, system, damping = trial, next_system, damping / 3
                if gain < tolerance * system.cost:
                    break
            else:
                damping *= 10
                if damping > 10:
                    break
        trust = system.weight_sum / np.maximum(system.n_seen, 1)
        return Solution(
            state,
            system.cost,
            system.scales,
            np.asarray(trust.reshape(self.view.shape), dtype=np.float32),
            self._covariance(state, system, poses),
        )

    def _linearise(self, state: State, relief: bool) -> NormalEquations:
        """Normal equations at a state."""
        view, camera = self.view, state.camera
        rays, by_camera = (x.astype(np.float32) for x in camera.rays(view.points))
        xy, grey = view.points.astype(np.float32), view.grey.ravel()
        depth = view.resize(state.relief).ravel()
        nominal = inverse_transform(conjugate(state.mount, self.displacements))
        T = state.corrections @ nominal @ state.reference
        turned = adjoint(state.corrections)
        chain = np.zeros((N_COLUMNS, N_GLOBAL))
        chain[CAMERA, OPTICS], chain[RELIEF, PLANE] = np.eye(5), np.eye(3)
        system = NormalEquations.empty(len(self.images), depth, relief)
        jacobian = np.empty((len(grey), N_COLUMNS), np.float32)
        by_depth, residuals = np.empty_like(grey), np.empty_like(grey)
        for i, image in enumerate(self.images):
            gain, offset = state.light_at(i, xy)
            linearise(
                image, T[i], camera.values, view.aspect, xy, rays, by_camera, depth, grey,
                gain, offset, view.slopes, False, jacobian, by_depth, residuals,
            )  # fmt: skip
            chain[MOTION, MOUNT] = turned[i] @ (adjoint(nominal[i]) - np.eye(6))
            chain[MOTION, REFERENCE] = adjoint(T[i])
            system.add(i, jacobian, by_depth, residuals, chain, self.priors.redundancy)
        return system

    def _priors(self, state: State, poses: bool) -> tuple[Array, Array]:
        """Precision of every unknown, infinite if it is held, and how far it is from its mean."""
        priors, n = self.priors, len(self.images)
        sigma_t, sigma_r = priors.pose
        sigma_t = float(np.hypot(sigma_t, sigma_r * np.linalg.norm(state.mount[:3, 3])))
        pose = np.repeat([sigma_t, sigma_r], 3) if poses else np.zeros(6)
        mount, plane = np.repeat(priors.mount, 3), PLANE_PRIOR
        sigma = np.concatenate(
            [mount, pose, priors.camera, plane, np.tile(np.append(pose, LIGHT_PRIOR), n)]
        )
        off = np.zeros(len(sigma))
        off[REFERENCE] = logarithm(state.reference)
        off[OPTICS][1:] = state.camera.values[1:] - priors.principal_and_distortion
        local = off[N_GLOBAL:].reshape(n, N_LOCAL)
        local[:, MOTION] = logarithm(state.corrections)
        local[:, _LIGHT] = state.light - [1.0, 0.0, 0.0, 0.0]
        with np.errstate(divide="ignore"):
            return 1 / sigma**2, off

    def _reduced(
        self, state: State, system: NormalEquations, damping: float, poses: bool
    ) -> tuple[Array, Array, NDArray[np.intp], Floats]:
        """Normal equations of what is free, without inverse depths; what is free; pivots."""
        precision, off = self._priors(state, poses)
        free = np.flatnonzero(np.isfinite(precision))
        H = system.hessian[np.ix_(free, free)]
        H[np.diag_indices(len(H))] *= 1 + damping
        H[np.diag_indices(len(H))] += precision[free]
        g = system.gradient[free] - precision[free] * off[free]
        spread = self.priors.depth * np.maximum(system.depth, 0.05)
        pivot = (system.depth_hessian * (1 + damping) + 1 / spread**2).astype(np.float32)
        if system.coupling is not None:
            C = system.coupling[:, free]
            scaled = C / np.sqrt(pivot)[:, None]
            H -= scaled.T @ scaled
            g -= C.T @ (system.depth_gradient / pivot)
        return H, g, free, pivot

    def _step(self, state: State, system: NormalEquations, damping: float, poses: bool) -> State:
        H, g, free, pivot = self._reduced(state, system, damping, poses)
        unit = 1 / np.sqrt(np.maximum(np.diag(H), 1e-12))
        scaled = H * unit * unit[:, None] + 1e-9 * np.eye(len(H))
        step = np.zeros(len(system.gradient))
        step[free] = unit * np.linalg.solve(scaled, unit * g)
        step /= max(1.0, float(np.max(np.abs(step[:N_GLOBAL]) / LONGEST_STEP)))
        shift = None
        if system.coupling is not None:
            shift = (system.depth_gradient - system.coupling @ step.astype(np.float32)) / pivot
            shift = np.clip(shift, -0.15 * system.depth, 0.15 * system.depth)
        return self._moved(state, step, shift)

    def _covariance(self, state: State, system: NormalEquations, poses: bool) -> Array:
        """Covariance of the unknowns that all images share."""
        H, _, free, _ = self._reduced(state, system, 0.0, poses)
        n = int(np.count_nonzero(free < N_GLOBAL))
        unit = 1 / np.sqrt(np.maximum(np.diag(H), 1e-12))
        inverse = np.linalg.pinv(H * unit * unit[:, None], rcond=1e-9, hermitian=True)
        out = np.zeros((N_GLOBAL, N_GLOBAL))
        out[np.ix_(free[:n], free[:n])] = (inverse * unit * unit[:, None])[:n, :n]
        return out

    def _moved(self, state: State, step: Array, shift: Floats | None) -> State:
        factor, right, down = step[PLANE]
        relief = self.view.resize(state.relief).ravel() * (1 + factor)
        relief = relief + self.view.points @ [right, down]
        if shift is not None:
            relief = relief + shift
        local = step[N_GLOBAL:].reshape(-1, N_LOCAL)
        return State(
            state.camera.moved(step[OPTICS]),
            state.mount @ exponential(step[MOUNT]),
            state.reference @ exponential(step[REFERENCE]),
            exponential(local[:, MOTION]) @ state.corrections,
            state.light + local[:, _LIGHT],
            np.maximum(relief, LEAST_INVERSE_DEPTH).reshape(self.view.shape),
        )
