"""How the error of each target falls with the number of images."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import t

from servoscope.errors import InvalidInputError
from servoscope.kernels import KernelPosterior, fit_kernel, merge_repeats
from servoscope.processes import in_processes, one_blas_thread
from servoscope.selection.forecast import (
    Array,
    Forecast,
    check_groups,
    cut_samples,
    forecast_errors,
)
from servoscope.selection.rms_interval import rms_log_error
from servoscope.selection.samples import as_samples, group_poses, in_ordinary_units

EXPONENTS = np.geomspace(0.15, 2.0, 16)
REMAINDERS = np.linspace(0.0, 1.0, 26)
"""Shares of the last error that no number of images takes away."""
_OFFSETS = np.linspace(-3.0, 3.0, 13)
"""By how many of its standard errors the last error may be wrong."""


@dataclass(frozen=True, eq=False)
class PowerLaw:
    """The curves ``a + b n^-c`` that agree with some measured errors, and how well each does.

    They are given by the largest measured number of images, the error of each there, the share of
    it that no number of images takes away, ``a / level``, the exponent c, and weights that add up
    to 1.
    """

    n: float
    level: Array = field(repr=False)
    remainder: Array = field(repr=False)
    exponent: Array = field(repr=False)
    weight: Array = field(repr=False)

    def quantiles(self, n: float, shares: ArrayLike) -> Array:
        """The errors at n images that such shares of the curves, by weight, fall below.

        They never rise with n.
        """
        falling = (1 - self.remainder) * (n / self.n) ** -self.exponent
        errors = self.level * (falling + self.remainder)
        order = np.argsort(errors, kind="stable")
        reached = np.searchsorted(np.cumsum(self.weight[order]), shares)
        return np.asarray(errors[order[np.minimum(reached, len(order) - 1)]])


def fit_power_law(n: ArrayLike, rms: ArrayLike, log_errors: ArrayLike) -> PowerLaw:
    """The power laws that agree with errors measured at several numbers of images, ascending.

    `log_errors` are the standard errors of the logarithms of the errors, which are above 0.

    Notes
    -----
    Three to five errors do not settle three parameters. So no curve is the best one: every curve
    of a grid counts by its likelihood, with log errors taken for normal, exponents for equally
    likely by their logarithm from 0.15 to 2, and remainders from 0 to 1.

    Examples
    --------
    >>> n = np.array([100, 200, 400, 800])
    >>> law = fit_power_law(n, 0.1 + 4 / n, [0.01] * 4)
    >>> law.quantiles(8000, [0.5]).round(2)
    array([0.1])
    """
    sizes, errors, spread = (np.asarray(a, dtype=float) for a in (n, rms, log_errors))
    level, remainder, exponent = (
        grid.ravel()
        for grid in np.meshgrid(
            errors[-1] * np.exp(spread[-1] * _OFFSETS), REMAINDERS, EXPONENTS, indexing="ij"
        )
    )
    ratio = sizes[:, None] / sizes[-1]
    curves = level * ((1 - remainder) * ratio**-exponent + remainder)
    misfit = np.square((np.log(curves) - np.log(errors)[:, None]) / spread[:, None]).sum(axis=0)
    weight = np.exp(-0.5 * (misfit - misfit.min()))
    return PowerLaw(float(sizes[-1]), level, remainder, exponent, weight / weight.sum())


Indices = NDArray[np.intp]

LEAST_SAMPLES = 40
"""A quarter of them is the smallest subset."""

MOST_SAID = 100
"""Times as many images as there are: what more of them would do is not said."""

_FINE_CUT = 160
"""From so many samples on, the smallest subset is an eighth of them."""

_MODEL_ERROR = 0.08
"""Standard deviation of the logarithms of measured errors about a power law, as found on images."""


_QUANTILES = (0.05, 0.5, 0.95)


class PredictedError(NamedTuple):
    """RMS errors at a number of images, in the unit of each target.

    Parameters
    ----------
    rms : ndarray of shape (n_targets,)
    interval : ndarray of shape (2, n_targets)
        90 %.
    """

    rms: Array
    interval: Array


@dataclass(frozen=True, eq=False)
class LearningCurve:
    """Errors at several numbers of images, and what they say of others.

    Parameters
    ----------
    n_images : ndarray of shape (n_sizes,)
        Ascending; the last one is that of all images.
    rms : ndarray of shape (n_sizes, n_targets)
        Forecast RMS error of new images, in the unit of each target.
    forecast : Forecast
        That of all images.
    """

    n_images: Indices
    rms: Array
    forecast: Forecast = field(repr=False)
    _laws: tuple[PowerLaw | None, ...] = field(repr=False)
    _level_errors: Array = field(repr=False)

    def rms_at(self, n_images: float) -> PredictedError:
        """The errors at another number of images; they never rise with it.

        Raises
        ------
        InvalidInputError
            If the number is below that of the smallest subset, or over 100 times that of all.
        """
        least, most = int(self.n_images[0]), MOST_SAID * int(self.n_images[-1])
        if not least <= n_images <= most:
            raise InvalidInputError(
                f"n_images must be from {least} to {most} for this curve, got {n_images!r}."
            )
        laws = [law.quantiles(n_images, _QUANTILES) if law else np.zeros(3) for law in self._laws]
        low, rms, high = np.transpose(laws)
        below = np.hypot(_log_ratio(rms, low), self._level_errors)
        above = np.hypot(_log_ratio(high, rms), self._level_errors)
        return PredictedError(rms, np.array([rms * np.exp(-below), rms * np.exp(above)]))

    def images_for(self, rms: ArrayLike) -> list[int | None]:
        """How many images bring the error of each target within a tolerance.

        Parameters
        ----------
        rms : float or array of shape (n_targets,)
            In the unit of each target.

        Returns
        -------
        list of int or None
            None where it takes more than 100 times as many as there are, or no number does.
        """
        tolerances = np.broadcast_to(np.asarray(rms, dtype=float), (len(self._laws),))
        return [self._images_for(j, float(rms)) for j, rms in enumerate(tolerances)]

    def _images_for(self, target: int, tolerance: float) -> int | None:
        few, many = int(self.n_images[0]), MOST_SAID * int(self.n_images[-1])
        if self.rms_at(many).rms[target] > tolerance:
            return None
        while few < many:
            middle = (few + many) // 2
            if self.rms_at(middle).rms[target] <= tolerance:
                many = middle
            else:
                few = middle + 1
        return many


def learning_curve(
    X: ArrayLike,
    Y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    poses: ArrayLike | None = None,
    n_draws: int = 8,
    whole: Forecast | None = None,
    n_jobs: int | None = 1,
    max_samples: int = 300,
    max_iter: int = 25,
) -> LearningCurve:
    """How the error of each target falls with the number of images, and where it will end.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
        Features that were not fitted on these very images.
    Y : array of shape (n_samples, n_targets) or (n_samples,)
    groups : array of shape (n_samples,), optional
        What belongs together, such as the blocks of a sequence; 4 groups at least.
    n_draws : int
        Most subsets of each size; 2 at least.
    whole : Forecast, optional
        What `forecast_errors` says of all of these samples, where it is known.
    poses, n_jobs, max_samples, max_iter
        As of `forecast_errors`.

    Returns
    -------
    LearningCurve

    Raises
    ------
    InvalidInputError
        If `X` or `Y` is not finite, or there are fewer than 40 samples or 4 groups.

    Notes
    -----
    Subsets of an eighth (from 160 samples on), a quarter, a half and three quarters of the samples
    choose a kernel each and predict all the others; the error of all samples is that of
    `forecast_errors`. Power laws that agree with these errors say what more images would do.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(-1, 1, (160, 4))
    >>> curve = learning_curve(X, np.sin(X.sum(axis=1)) + rng.normal(0, 0.1, 160))
    >>> curve.n_images
    array([ 20,  40,  80, 120, 160])
    >>> curve.rms_at(800).rms.round(1), curve.images_for(0.01)
    (array([0.1]), [None])
    """
    features, targets = as_samples(X, Y)
    (features, _), (targets, unit) = in_ordinary_units(features), in_ordinary_units(targets)
    if len(features) < LEAST_SAMPLES:
        raise InvalidInputError(
            f"A learning curve needs at least {LEAST_SAMPLES} samples, got {len(features)}; "
            "take more images."
        )
    members = check_groups(groups, len(features))
    effort = {"max_samples": max_samples, "max_iter": max_iter}
    targets = targets - targets[0]  # what never changes is exactly 0
    joined = group_poses(features, targets, members, poses)
    forecast = (
        forecast_errors(
            features, targets, groups=members, poses=joined.members, n_jobs=n_jobs, **effort
        )
        if whole is None
        else whole.in_units(1 / unit)
    )
    subsets = _draw_subsets(len(features), joined.groups_of_shots, max(n_draws, 2))
    calls = [
        (features, y, joined.members, subset, effort)
        for y in targets.T
        for draws in subsets
        for subset in draws
    ]
    logs = iter(in_processes(_log_rms_of_others, calls, n_jobs))
    measured = [[[next(logs) for _ in draws] for draws in subsets] for _ in targets.T]
    n_images = np.array([round(np.mean([len(d) for d in s])) for s in subsets] + [len(features)])
    error, n_groups = rms_log_error(forecast.residuals, joined.groups_of_shots)
    fits = [_fit(n_images, m, whole) for m, whole in zip(measured, forecast.rms, strict=True)]
    return LearningCurve(
        n_images,
        np.transpose([rms for _, rms in fits]) * unit,
        forecast.in_units(unit),
        tuple(
            law and replace(law, level=law.level * size)
            for (law, _), size in zip(fits, unit, strict=True)
        ),
        error * t.isf(0.05, n_groups - 1),
    )


def _draw_subsets(n_samples: int, groups: Indices | None, n_draws: int) -> list[list[Indices]]:
    """Several subsets of each size, from the smallest size up."""
    n_units = n_samples if groups is None else groups.max() + 1
    n_pieces = 8 if n_samples >= _FINE_CUT and n_units >= 8 else 4
    pieces = cut_samples(n_samples, groups, n_pieces)
    subsets = []
    for share in (1, 2, 4, 6) if n_pieces == 8 else (1, 2, 3):
        starts = range(0, n_pieces, min(share, n_pieces - share))
        starts = starts[:: -(-len(starts) // n_draws)]
        rings = [[(start + i) % n_pieces for i in range(share)] for start in starts]
        subsets.append([np.sort(np.concatenate([pieces[i] for i in ring])) for ring in rings])
    return subsets


def _log_rms_of_others(
    X: Array, y: Array, members: Indices, subset: Indices, effort: dict[str, int]
) -> float:
    """Logarithm of the RMS error at all samples outside of the subset that predicts them."""
    others = np.delete(np.arange(len(X)), subset)
    _, poses = np.unique(members[subset], return_inverse=True)
    X_known, y_known = merge_repeats(X[subset], y[subset], poses)
    with one_blas_thread():
        kernel = fit_kernel(X_known, y_known, **effort)
        errors = y[others] - KernelPosterior(kernel, X_known, y_known).mean(X[others])
    with np.errstate(divide="ignore"):
        return float(np.log(np.sqrt(np.mean(errors**2))))


def _fit(
    n_images: Indices, measured: list[list[float]], whole: float
) -> tuple[PowerLaw | None, Array]:
    """The power laws of one target, and its errors; None where nothing is left to fall."""
    rms = np.array([np.exp(np.mean(logs)) for logs in measured] + [whole])
    if not (rms > 0).all():
        return None, rms
    spread = [np.std(logs, ddof=1) / np.sqrt(len(logs)) for logs in measured] + [0.0]
    return fit_power_law(n_images, rms, np.hypot(spread, _MODEL_ERROR)), rms


def _log_ratio(a: Array, b: Array) -> Array:
    return np.log(np.divide(a, b, out=np.ones_like(a), where=b > 0))
