"""Forward selection: each time the feature with which the forecast error is least."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.kernels import GaussianKernel, leave_out_residuals
from servoscope.processes import one_blas_thread
from servoscope.selection.candidates import Candidates, Ranking
from servoscope.selection.forecast import check_groups
from servoscope.selection.samples import as_samples, group_poses, in_ordinary_units

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MAX_SAMPLES = 200
"""So many samples decide: more of them hardly change the order, and time grows with their cube."""

_ENTRY_SCALES = (1.0, 3.0)
"""Length scales at which a feature may enter, as multiples of the mean one."""

_FIRST_KERNELS = tuple(product((0.5, 1.5, 5.0), (0.05, 0.3)))
"""Length scale in standard deviations of a feature, and noise in those of the target."""

_REFINEMENTS = tuple(product((0.71, 1.0, 1.41), (0.5, 1.0, 2.0)))
"""Factors of all length scales and of the noise that are tried once a feature is selected."""

_NOISE_BOUNDS = 0.003, 1.0
_LEAST_UNSEEN = 50


@dataclass(frozen=True, eq=False)
class ForwardRanking(Ranking):
    """Features in the order of selection, and the error after each of them.

    Relevance is the log2 of how many times a feature alone lowers the error, [bits]; redundancy
    is by how much less it lowers the error that the features selected before it leave.

    Parameters
    ----------
    errors : ndarray of shape (n_steps,)
        Forecast RMS error from the features selected so far, in the target's unit, at samples that
        did not take part in the selection where there are 50 of them.
    """

    errors: Array = field(default_factory=lambda: np.empty(0))


@dataclass(frozen=True, eq=False)
class _Samples:
    """Features and target in units of their standard deviations."""

    X: Array
    y: Array
    groups: Indices | None

    def rms(self, features: list[int], kernel: GaussianKernel) -> float:
        """Of the residuals left out."""
        return float(np.sqrt(np.mean(self.residuals(features, kernel) ** 2)))

    def residuals(self, features: list[int], kernel: GaussianKernel) -> Array:
        return leave_out_residuals(kernel, self.X[:, features], self.y, self.groups)

    def __getitem__(self, rows: Indices) -> _Samples:
        return _Samples(
            self.X[rows], self.y[rows], None if self.groups is None else self.groups[rows]
        )


def rank_forward(candidates: Candidates, n_features: int) -> ForwardRanking:
    """Rank features by forward selection; each pose is left out by itself."""
    return forward_selection(candidates.X, candidates.y, n_features)


def forward_selection(
    X: ArrayLike,
    y: ArrayLike,
    n_features: int = 24,
    *,
    groups: ArrayLike | None = None,
    max_samples: int = MAX_SAMPLES,
) -> ForwardRanking:
    """Rank features by the forecast error that each leaves beside those selected before it.

    Parameters
    ----------
    X : array of shape (n_samples, n_candidates)
    y : array of shape (n_samples,)
    n_features : int
        How many features to rank; all of them if there are fewer.
    groups : array of shape (n_samples,), optional
        What is left out together, such as the blocks of a sequence; 4 groups at least.
    max_samples : int
        Of more samples than that, so many drawn at random decide; always the same ones.

    Returns
    -------
    ForwardRanking

    Raises
    ------
    InvalidInputError
        If the samples are not finite, fewer than 8 or of fewer than 4 groups, or `n_features` is
        not a positive integer.

    Notes
    -----
    The error is that of a Gaussian process whose residuals are left out in closed form. A feature
    enters at one of two length scales; once it is selected, all length scales and the noise are
    multiplied by what lowers the error most. A criterion that scores sets of features as a whole
    finds those that inform only jointly, but one step at a time: of two features that explain
    nothing alone, neither is the first.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(-1, 1, (200, 5))
    >>> ranking = forward_selection(X, X[:, 3] + 0.3 * X[:, 1] ** 2, 3)
    >>> ranking.order[:2], ranking.errors[1] < 0.1 * ranking.errors[0]
    (array([3, 1]), np.True_)
    """
    if not isinstance(n_features, Integral) or n_features < 1:
        raise InvalidInputError(f"n_features must be 1 or more, got {n_features!r}.")
    features, targets = as_samples(X, y)
    (features, _), (targets, unit) = in_ordinary_units(features), in_ordinary_units(targets)
    poses = group_poses(features, targets, check_groups(groups, len(features)))
    n_steps, spread = min(int(n_features), features.shape[1]), float(poses.Y[:, 0].std())
    if spread <= 1e-12 * abs(float(poses.Y[:, 0].mean())):
        return _of_a_constant(features.shape[1], n_steps)
    samples = _Samples(_standardised(poses.X), _standardised(poses.Y)[:, 0], poses.groups)
    drawn = np.random.default_rng(0).permutation(len(poses))[:max_samples]
    with one_blas_thread():
        order, kernels, scores = _select(samples[np.sort(drawn)], n_steps)
        errors = [
            _unseen_rms(samples, np.sort(drawn), order[: i + 1], kernels[i]) for i in range(n_steps)
        ]
    relevance, redundancy = _as_information(order, scores)
    return ForwardRanking(
        np.array(order, dtype=np.intp), relevance, redundancy, spread * unit[0] * np.array(errors)
    )


def _select(samples: _Samples, n_steps: int) -> tuple[list[int], list[GaussianKernel], Array]:
    """Features in order, the kernel after each, and the error of every candidate at each step."""
    n_candidates = samples.X.shape[1]
    order: list[int] = []
    kernels: list[GaussianKernel] = []
    scores = np.full((n_steps, n_candidates), np.nan)
    for step in range(n_steps):
        entered = {}
        for candidate in range(n_candidates):
            if candidate not in order:
                chosen = [*order, candidate]
                tried = [(samples.rms(chosen, k), i, k) for i, k in enumerate(_entries(kernels))]
                scores[step, candidate], _, entered[candidate] = min(tried)
        order.append(int(np.nanargmin(scores[step])))
        kernels.append(_refined(samples, order, entered[order[-1]]))
    return order, kernels, scores


def _entries(kernels: list[GaussianKernel]) -> list[GaussianKernel]:
    """Kernels with one more feature than the last of those so far."""
    if not kernels:
        return [_kernel(np.array([scale]), noise) for scale, noise in _FIRST_KERNELS]
    scales, noise = kernels[-1].length_scales, kernels[-1].noise
    mean = np.exp(np.log(scales).mean())
    return [_kernel(np.append(scales, entry * mean), noise) for entry in _ENTRY_SCALES]


def _refined(samples: _Samples, features: list[int], kernel: GaussianKernel) -> GaussianKernel:
    tried = [
        replace(
            kernel,
            length_scales=scale * kernel.length_scales,
            noise=float(np.clip(noise * kernel.noise, *_NOISE_BOUNDS)),
        )
        for scale, noise in _REFINEMENTS
    ]
    return min(tried, key=lambda k: samples.rms(features, k))


def _kernel(length_scales: Array, noise: float) -> GaussianKernel:
    return GaussianKernel(np.zeros(len(length_scales)), length_scales, 1.0, noise)


def _unseen_rms(
    samples: _Samples, drawn: Indices, features: list[int], kernel: GaussianKernel
) -> float:
    """RMS residual at the samples that were not drawn; at all of them if these are few."""
    residuals = samples.residuals(features, kernel)
    unseen = np.delete(residuals, drawn)
    counted = unseen if len(unseen) >= _LEAST_UNSEEN else residuals
    return float(np.sqrt(np.mean(counted**2)))


def _as_information(order: list[int], scores: Array) -> tuple[Array, Array]:
    """Relevance of every candidate, and its redundancy at every step, [bits]."""
    left = np.array([1.0, *(scores[i, chosen] for i, chosen in enumerate(order[:-1]))])
    gains = np.log2(left[:, None] / np.maximum(scores, np.finfo(float).tiny))
    relevance = np.maximum(gains[0], 0.0)
    redundancy = relevance - gains
    redundancy[0] = 0.0
    return relevance, redundancy


def _of_a_constant(n_candidates: int, n_steps: int) -> ForwardRanking:
    """The ranking for a target that never changes."""
    redundancy = np.zeros((n_steps, n_candidates))
    redundancy[np.tril_indices(n_steps, -1, n_candidates)] = np.nan
    return ForwardRanking(np.arange(n_steps), np.zeros(n_candidates), redundancy, np.zeros(n_steps))


def _standardised(table: Array) -> Array:
    """Zero mean and unit variance; zero for what is constant."""
    centred = table - table[0]
    centred -= centred.mean(axis=0)
    spread = centred.std(axis=0)
    return np.asarray(centred / np.where(spread > 0, spread, np.inf))
