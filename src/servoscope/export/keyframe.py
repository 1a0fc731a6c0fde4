"""A keyframe model as one graph: the first guess, the descents from it, and what is believed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from servoscope.dofs import mask_of
from servoscope.export.graph import Graph, Value, concatenate, maximum, minimum, stack, where
from servoscope.export.levels import (
    Descent,
    LevelGraph,
    Picture,
    block_sums,
)
from servoscope.export.recognition import RecognitionGraph
from servoscope.export.resizing import reduced
from servoscope.export.rigid import Motions, inverse, rotation_angle, solve
from servoscope.keyframe.alignment import (
    BETWEEN,
    BLURRED,
    CLEARLY_ALIKE,
    LEAST_CURVATURE,
    N_COMPARED,
    N_GUESSED,
    N_STARTS,
    REGISTRATION,
    RELIT,
    STAGES,
)
from servoscope.keyframe.levels import CUT, EVENED, FAINT, N_BLOCKS, PRIOR
from servoscope.positioning.first_guess import FirstGuess, bounds_of, small_shape
from servoscope.positioning.keyframe_model import FARTHEST, KeyframeModel

Array = NDArray[np.float64]


class KeyframeGraph:
    """The estimates of a keyframe model, as values of a graph.

    Parameters
    ----------
    graph : Graph
    model : KeyframeModel
    image : Value of shape (height, width), uint8
    """

    def __init__(self, graph: Graph, model: KeyframeModel, image: Value) -> None:
        self.graph, self.model = graph, model
        self.aligner = aligner = model.keyframe.aligner
        self.search, self.freedom = Motions(aligner.search), Motions(aligner.freedom)
        self.levels = [LevelGraph(graph, level, self.search) for level in aligner.levels]
        self.evened = LevelGraph(graph, aligner.evened, self.search)
        self.grey = image.cast(np.float64)
        self._shape = model.image_shape
        self.pictures = []
        for level in aligner.levels:
            view = level.view
            small = reduced(self.grey, self._shape, view.shape, view.sigma)
            self.pictures.append(Picture.of(small, view.shape))
            if level is aligner.levels[0]:
                even = _evened(small, view.shape)
                self.even_picture = Picture.of(even, view.shape)

    def estimate(self) -> dict[str, Value]:
        """What the model says of the image, by name."""
        guess = self._searched()
        T, light, similarity = guess
        if self.model.first_guess is not None:

            def again() -> list[Value]:
                other_T, other_light, other = self._screened_alone()
                better = other > similarity
                return [where(better, other_T, T), where(better, other_light, light)]

            T, light = self.graph.branch(similarity < CLEARLY_ALIKE, again, lambda: [T, light])
        return self._believed(T, light)

    def _searched(self) -> tuple[Value, Value, Value]:
        first_guess = self.model.first_guess
        if first_guess is None:
            return self._screened_alone()
        shares = self._first_guesses(first_guess)
        return self._finished(self._from(shares, len(first_guess.windows)))

    def _screened_alone(self) -> tuple[Value, Value, Value]:
        return self._finished(self._best(self._screened()))

    def _first_guesses(self, first_guess: FirstGuess) -> Value:
        """Displacements about the pivot, (n_windows, 6)."""
        shape = small_shape(self._shape)
        small = reduced(self.grey, self._shape, shape, 0.0)
        even = _evened(small, shape) / 30.0
        found = []
        for window, (rows, columns) in zip(first_guess.windows, bounds_of(shape), strict=True):
            pixels = even[rows, columns].reshape(1, -1)
            at = (pixels - window.mean) @ self.graph.field(window.components)
            samples = self.graph.field(window.samples.T)
            distances = (samples * samples).sum(0) + (at * at).sum() - 2.0 * (at @ samples)
            found.append(self.graph.apply("Exp", -distances) @ self.graph.field(window.weights))
        return concatenate(found).clip(-1.2, 1.2) * first_guess.reach

    def _from(self, starts: Value, n_starts: int) -> Descent:
        """As `Aligner._from`."""
        middle, picture = self.levels[1], self.pictures[1]

        def follow(k: Value, state: list[Value]) -> tuple[Value, list[Value], list[Value]]:
            T = self.search.nearest(self.freedom.of_six(starts.take(k))[1])
            guess = middle.descend(
                picture, middle.start(T), middle.k, N_GUESSED, STAGES[1].tolerance
            )
            alike = middle.compare(picture, guess.T)
            return ~(alike > CLEARLY_ALIKE), [*guess, alike], [*guess]

        nothing = middle.start(self.graph.constant(np.eye(4)))
        state = [*nothing, self.graph.constant(0.0)]
        (*last, alike), kept = self.graph.loop(n_starts, state, follow)
        best = self.graph.branch(
            alike > CLEARLY_ALIKE, lambda: last, lambda: [*self._best((kept, n_starts))]
        )
        return Descent(*best)

    def _screened(self) -> tuple[list[Value], int]:
        """As `Aligner._screened`, of the aligner's own starts."""
        starts = np.stack(self.aligner.starts)[::-1]  # of equal ones the last is the first taken
        n_starts = min(N_STARTS, len(starts))
        middle, found = self.levels[1], []
        for level, picture in (
            (self.levels[0], self.pictures[0]),
            (self.evened, self.even_picture),
        ):
            found.append(self._followed(level, picture, starts, n_starts))
        T = concatenate(found)
        n = 2 * n_starts
        light = self.graph.constant(np.tile(middle.even, (n, 1)))
        return [T, light, self.graph.constant(np.zeros(n, bool))], n

    def _followed(self, level: LevelGraph, picture: Picture, starts: Array, n_starts: int) -> Value:
        """Where the starts that correlate best lead to, (n_starts, 4, 4)."""
        scores = level.correlations(picture, starts)
        wanted = self.graph.constant([n_starts])
        _, order = self.graph.apply_many(
            "TopK", scores, wanted, dtypes=(np.float64, np.int64), largest=1
        )
        chosen = self.graph.constant(starts).take(order)

        def follow(k: Value, _: list[Value]) -> tuple[None, list[Value], list[Value]]:
            guess = level.start(chosen.take(k))
            found = level.descend(picture, guess, level.k, STAGES[0].n_steps, 0.01)
            return None, [], [found.T]

        _, (T,) = self.graph.loop(n_starts, [], follow)
        return T

    def _best(self, guesses: tuple[Sequence[Value], int]) -> Descent:
        """As `Aligner._best`."""
        (T, light, settled), n = guesses
        middle, picture = self.levels[1], self.pictures[1]

        def follow(k: Value, _: list[Value]) -> tuple[None, list[Value], list[Value]]:
            guess = Descent(T.take(k), light.take(k), settled.take(k))
            found = middle.descend(picture, guess, middle.k, N_COMPARED, STAGES[1].tolerance)
            left = middle.linearise(picture, found.T, found.light)
            return None, [], [*found, left.r, left.scale]

        _, (T, light, settled, r, scale) = self.graph.loop(n, [], follow)
        ratio = r / (CUT * scale.min())
        costs = (minimum(ratio * ratio, 1.0) * middle.real.cast(np.float64)).sum(1)
        best = self.graph.apply("ArgMin", costs, dtype=np.int64, axis=0, keepdims=0)
        return Descent(T.take(best), light.take(best), settled.take(best))

    def _finished(self, guess: Descent) -> tuple[Value, Value, Value]:
        """Motion and light of a guess after the finer resolutions, and how alike the image is."""
        (middle, finest), (picture, fine) = self.levels[1:], self.pictures[1:]

        def further() -> list[Value]:
            stage = STAGES[1]
            return [*middle.descend(picture, guess, middle.k, stage.n_steps, stage.tolerance)]

        guess = Descent(*self.graph.branch(guess.settled, lambda: [*guess], further))
        stage = STAGES[2]
        found = finest.descend(fine, guess, middle.k, stage.n_steps, stage.tolerance)
        return found.T, found.light, middle.compare(picture, found.T)

    def _believed(self, T: Value, light: Value) -> dict[str, Value]:
        """What is made of a motion and a light, as `KeyframeModel` does."""
        model, is_commanded = self.model, mask_of(self.model.dofs).astype(float)
        found = self.freedom.delta_p(T)
        variance = self._variance(T, light)
        displacement, delta_p = self.search.displacement(T), found
        deviation = variance.sqrt()
        if not self.freedom.is_full or not is_commanded.all():
            delta_p = found * is_commanded
            displacement, _ = self.freedom.of_six(delta_p)
            deviation = where(self.graph.constant(is_commanded > 0), deviation, np.nan)
        shares = found / np.where(model.reach > 0, FARTHEST * model.reach, 1.0)
        novelty = self.graph.apply("Abs", shares).max()
        recognition = RecognitionGraph(self.graph, model.recognition, model.keyframe)
        view = recognition.view
        small = reduced(self.grey, self._shape, view.shape, view.sigma)
        similarity = recognition.similarity(small, T)
        return {
            "displacement": displacement,
            "correction": inverse(displacement),
            "delta_p": delta_p,
            "deviation": deviation,
            "similarity": similarity,
            "novelty": novelty,
            "is_recognised": (similarity >= model.least_similarity) & (novelty <= 1.0),
        }

    def _variance(self, T: Value, light: Value) -> Value:
        """The variance of each number of the displacement, as `Aligner` finds it."""
        level, picture, aligner = self.levels[2], self.pictures[2], self.aligner
        found = level.linearise(picture, T, light)
        curvature = found.curvature_ratio()
        H, _ = level.normal_equations(found, light)
        follows = solve(H[6:, 6:], H[6:, :6], level.n_light)
        k2 = level.k**2
        gains, offsets = follows[1 : 1 + k2], follows[1 + k2 :]
        parts = []
        for j in range(6):
            made = level.grey * level.light_at(gains[:, j]) + level.light_at(offsets[:, j])
            parts.append(found.J[j] + made + follows[0, j] * level.laplacian)
        alone = concatenate([part.reshape(1, level.n) for part in parts])
        weighted = alone * found.w
        prior = np.diag(1 / PRIOR**2)
        known = maximum(curvature, LEAST_CURVATURE) * (weighted @ found.J.transpose(1, 0)) + prior
        B = self.search.twists(T)
        n_dofs, turned = self.search.n_dofs, B.transpose(1, 0)
        bread = B @ solve(turned @ known @ B, turned, n_dofs)
        depth = aligner.typical_depth
        shift = depth * T[:3, 3].norm() + rotation_angle(T)
        width = level.level.view.width
        apart = minimum(shift * (level.level.camera.f * width / BETWEEN), 1.0)
        grey = level.level.grey
        nodes = light[1 : 1 + k2] * float(grey.mean()) + light[1 + k2 :]
        uneven = nodes - nodes.sum() / k2
        change = ((uneven * uneven).sum() / k2).sqrt() / max(float(grey.std()), 1.0)
        errors = stack([REGISTRATION * apart, RELIT * change, BLURRED * light[0]], 3)
        share = errors.norm() / width
        slopes = self.graph.field(level.filled(level.level.slopes.T))
        rows = [weighted * found.r, weighted * (share * slopes[0]), weighted * (share * slopes[1])]
        scores = block_sums(concatenate(rows), 18, level.blocks).reshape(3, 6, N_BLOCKS**2)
        meat = prior + (scores @ scores.transpose(0, 2, 1)).sum(0)
        by_twist = self.freedom.by_twist(T)
        own = by_twist @ bread @ meat @ bread @ by_twist.transpose(1, 0)
        own = (own * np.eye(6)).sum(1) * mask_of(self.model.keyframe.dofs).astype(float)
        error = shift * aligner.model_error
        return own + error * error


def _evened(grey: Value, shape: tuple[int, int]) -> Value:
    """As `servoscope.keyframe.levels.evened`."""
    sigma = EVENED * shape[1]
    fine = grey - reduced(grey, shape, shape, sigma)
    square = reduced(fine * fine, shape, shape, sigma)
    return 30.0 * (fine / (square.sqrt() + FAINT)).clip(-2.0, 2.0)
