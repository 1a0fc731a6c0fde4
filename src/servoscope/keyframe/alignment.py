"""Where one image was taken: robust Gauss-Newton on its grey levels, coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.dofs import mask_of
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import CUT, FAR, N_BLOCKS, PRIOR, Guess, Level, View, evened
from servoscope.keyframe.lighting import Light
from servoscope.keyframe.motion import Freedom, conjugate, exponential, logarithm
from servoscope.keyframe.robust import curvature_ratio
from servoscope.poses import inverse_transform, rotation_angle

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


class Stage(NamedTuple):
    """Width and blur of a level [px], most steps, and the step that is the last [px]."""

    width: int
    sigma: float
    n_steps: int
    tolerance: float


STAGES = (Stage(32, 1.0, 10, 0.01), Stage(64, 0.7, 8, 0.1), Stage(128, 1.0, 6, 0.03))
CLEARLY_ALIKE = 0.85
"""The similarity above which no other start is tried."""

_NODES = (2, 3, 8)
_NODE_PX = 16
"""Nodes of the light are no nearer, [px]."""

_STIFFNESS = (3.0, 1.0, 1.0)
N_STARTS = 5
N_COMPARED, N_GUESSED = 5, 10
_N_SPREAD = 200
LEAST_CURVATURE = 0.1
REGISTRATION = 0.035
"""Standard deviation of the place of a block of the view beside the middles of pixels, [px]."""

BETWEEN = 0.25
"""Displacements of that much bring all of it, [px]: grey levels are then between pixels."""

RELIT = 0.4
"""The same in a light as uneven as the reference's grey levels are, [px]."""

BLURRED = 0.3
"""The same for a defocus of the whole Laplacian, [px]."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Where an image was taken.

    Parameters
    ----------
    displacement : ndarray of shape (4, 4)
        ``inv(T_world_ref) @ T_world_cam`` of the poses that the robot reports, [m]. The identity
        where the view is that of the reference.
    delta_p : ndarray of shape (6,)
        The same about the pivot, [m] and [rad], in `DOFS` order; 0 in dofs that are not read.
    covariance : ndarray of shape (6, 6)
        Of `delta_p`: from the residuals, correlated as they are inside blocks of the view, and
        from the keyframe's own errors, which grow with the displacement.
    similarity : float
        Mean correlation of blocks of the image with what the keyframe expects there, 0 to 1.
    share_visible : float
        Share of the keyframe that is within the image.
    light : Light
        Gain and offset over the view, and defocus.
    """

    displacement: Array
    delta_p: Array
    covariance: Array
    similarity: float
    share_visible: float
    light: Light

    @property
    def std(self) -> Array:
        """Standard deviations of `delta_p`, shape (6,)."""
        return np.sqrt(np.diag(self.covariance))


class Aligner:
    """The keyframe at all resolutions that an alignment goes through.

    Parameters
    ----------
    reference_image : ndarray of shape (height, width), uint8
    camera : CameraModel
    mount : ndarray of shape (4, 4)
    inverse_depth, trust : ndarrays
        Over the reference image, of any resolution.
    displacements : ndarray of shape (n, 4, 4)
        Tried, beside none, where no first guess is given.
    pivot : float
        [m].
    model_error : ndarray of shape (6,)
        Standard deviation of each dof per radian that the view is shifted.
    dofs : tuple of str
        The degrees of freedom that are read; all others are taken to be those of the reference.
    """

    def __init__(
        self,
        reference_image: NDArray[np.uint8],
        camera: CameraModel,
        mount: Array,
        inverse_depth: Floats,
        trust: Floats,
        displacements: Array,
        pivot: float,
        model_error: Array,
        dofs: tuple[str, ...],
    ) -> None:
        self.mount, self.pivot, self.model_error = mount, pivot, model_error
        self.typical_depth = float(np.median(inverse_depth))
        self.freedom = Freedom(mount, pivot, dofs)
        self.search, self._is_read = self.freedom, mask_of(dofs)
        if self.typical_depth < FAR and not self.freedom.is_full:  # turned about the camera
            self.search = self.freedom.turning()
        self.levels = []
        for (width, sigma, *_), k, stiffness in zip(STAGES, _NODES, _STIFFNESS, strict=True):
            view = View.of(reference_image, min(width, reference_image.shape[1]), sigma)
            depth, weight = view.resize(inverse_depth), view.resize(trust)
            k = max(2, min(k, round(np.sqrt(view.grey.size) / _NODE_PX)))
            finest = width == STAGES[-1].width
            level = Level(view, camera, depth, weight, k, stiffness, finest, self.search)
            self.levels.append(level)
        first = self.levels[0]
        grey = evened(first.view.grey)
        view = View(grey, first.view.aspect, first.view.sigma)
        self.evened = Level(
            view, camera, view.resize(inverse_depth), view.resize(trust), _NODES[0], _STIFFNESS[0],
            freedom=self.search,
        )  # fmt: skip
        twists = logarithm(inverse_transform(conjugate(mount, displacements)))
        if self.typical_depth < FAR:  # translations are not seen: they stay at none
            twists[:, :3] = 0
        self.starts = [self.search.nearest(T) for T in _starts(twists)]

    def align(self, image: NDArray[np.uint8], starts: Array | None) -> Alignment:
        """See `Keyframe.align`."""
        prepared = [level.prepare(image) for level in self.levels]
        if starts is None:
            guess = self._best(prepared, self._screened(prepared, self.starts, N_STARTS))
        else:
            T = inverse_transform(conjugate(self.mount, starts))
            guess = self._from(prepared, [self.search.nearest(t) for t in T])
        for level, grey, stage in zip(self.levels[1:], prepared[1:], STAGES[1:], strict=True):
            if level is self.levels[-1] or not guess.is_settled:
                guess = level.descend(grey, guess, stage.n_steps, stage.tolerance)
        similarity, share_visible = self.levels[1].compare(prepared[1], guess.T)
        displacement, delta_p = self.search.displacement(guess.T), self.freedom.delta_p(guess.T)
        covariance = self._covariance(level, grey, guess, displacement)
        return Alignment(displacement, delta_p, covariance, similarity, share_visible, guess.light)

    def _from(self, prepared: Sequence[Array], starts: Sequence[Array]) -> Guess:
        """The guess that explains an image best, of those that first guesses lead to.

        The coarsest resolution is left out: what covers a part of the view, or lights it
        otherwise, misleads there. Only if none of them is enough does a single one go through it.
        """
        middle, guesses = self.levels[1], []
        for T in starts:
            guess = middle.descend(prepared[1], middle.start(T), N_GUESSED, STAGES[1].tolerance)
            if middle.compare(prepared[1], guess.T)[0] > CLEARLY_ALIKE:
                return guess
            guesses.append(guess)
        if len(starts) == 1:
            guesses += self._screened(prepared, starts, 1)
        return self._best(prepared, guesses)

    def _screened(
        self, prepared: Sequence[Array], starts: Sequence[Array], n_starts: int
    ) -> list[Guess]:
        """Where the starts that correlate best lead to at the coarsest resolution."""
        middle, guesses = self.levels[1], []
        for level, image in ((self.levels[0], prepared[0]), (self.evened, evened(prepared[0]))):
            scores = [level.correlation(image, T) for T in starts]
            for k in np.argsort(scores, kind="stable")[::-1][:n_starts]:
                coarse = level.descend(image, level.start(starts[k]), STAGES[0].n_steps)
                guesses.append(middle.start(coarse.T))
        return guesses

    def _best(self, prepared: Sequence[Array], guesses: Sequence[Guess]) -> Guess:
        """The guess that explains an image best, each followed at the middle resolution."""
        middle = self.levels[1]
        tolerance = STAGES[1].tolerance
        found = [middle.descend(prepared[1], guess, N_COMPARED, tolerance) for guess in guesses]
        explained = [middle.linearise(prepared[1], guess) for guess in found]
        scale = min(scale for *_, scale in explained)
        costs = [np.minimum((r / (CUT * scale)) ** 2, 1).mean() for _, r, *_ in explained]
        return found[int(np.argmin(costs))]

    def view_shift(self, T: Array) -> float:
        """How far a motion of the camera moves what is seen, roughly, [rad]."""
        shift = np.linalg.norm(T[:3, 3]) * self.typical_depth
        return float(shift + rotation_angle(T[:3, :3]))

    def _covariance(self, level: Level, image: Array, guess: Guess, displacement: Array) -> Array:
        """Covariance of the displacement about the pivot.

        The sandwich formula with residuals that are correlated inside blocks of the view; errors
        of registration, alike inside blocks, between pixels and where another light shows another
        shading; and the keyframe's own errors, which grow with the displacement. Robust weights
        hold less than they say (`curvature_ratio`).
        """
        J, r, w, scale = level.linearise(image, guess)
        curvature = curvature_ratio(r, w, scale)
        grid = level.grid
        H, _ = grid.normal_equations(J, r, w, level.laplacian, level.grey, guess.light)
        alone = grid.without_light(J, level.laplacian, level.grey, H)
        information = (alone * w[:, None]).T @ J
        known = max(curvature, LEAST_CURVATURE) * information + np.diag(1 / PRIOR**2)
        B = self.search.twists(guess.T)
        bread = B @ np.linalg.inv(B.T @ known @ B) @ B.T
        shift = self.view_shift(guess.T)
        apart = min(1.0, shift * level.camera.f * level.view.width / BETWEEN)
        errors = (
            REGISTRATION * apart,
            RELIT * guess.light.unevenness(level.grey),
            BLURRED * guess.light.defocus,
        )
        misplaced = float(np.linalg.norm(errors))
        meat = np.diag(1 / PRIOR**2)
        sums = np.zeros((3, N_BLOCKS**2, 6))
        share = misplaced / level.view.width
        _add_scores(alone, w, r, share * level.slopes, level.blocks, sums)
        meat = meat + np.einsum("ebi,ebj->ij", sums, sums)
        by_twist = self.by_twist(displacement)
        own = by_twist @ bread @ meat @ bread @ by_twist.T
        own[~self._is_read] = own[:, ~self._is_read] = 0
        return np.asarray(own + np.diag((shift * self.model_error) ** 2))

    def by_twist(self, displacement: Array) -> Array:
        """Derivative of the displacement about the pivot by a twist before T, shape (6, 6)."""
        return self.freedom.by_twist(displacement)


@compiled(fastmath=True, error_model="numpy")
def _add_scores(
    jacobian: NDArray[Any],
    weights: NDArray[Any],
    residuals: NDArray[Any],
    misplaced: NDArray[Any],
    blocks: NDArray[Any],
    sums: NDArray[Any],
) -> None:
    """Add what each block of points contributes to the gradient, by residuals and two others.

    Parameters
    ----------
    jacobian : array of shape (n, 6)
    weights, residuals : arrays of shape (n,)
    misplaced : array of shape (n, 2)
        Residuals of a displacement to the right and down.
    blocks : array of shape (n,)
        Of integers.
    sums : array of shape (3, n_blocks, 6)
    """
    for i in range(jacobian.shape[0]):
        b = blocks[i]
        errors = (residuals[i], misplaced[i, 0], misplaced[i, 1])
        for e in range(3):
            for j in range(6):
                sums[e, b, j] += weights[i] * errors[e] * jacobian[i, j]


def _starts(twists: Array) -> list[Array]:
    """None, those that are given, and more that are spread as they are."""
    mix = np.random.default_rng(0).normal(size=(_N_SPREAD, len(twists))) / np.sqrt(len(twists))
    return [np.eye(4), *exponential(np.concatenate([twists, mix @ twists]))]
