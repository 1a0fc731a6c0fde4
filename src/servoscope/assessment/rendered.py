"""The images that an assessment is made of; few real ones are joined by rendered ones."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc, rankdata

from servoscope.assessment.view import FittedView, fit_view
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import (
    IndependentGroups,
    check_enough_images,
    independent_groups,
    split_groups,
)
from servoscope.data.splits import Split, further_splits
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.keyframe import Keyframe
from servoscope.keyframe.motion import conjugate
from servoscope.poses import inverse_transform, poses_from_displacements
from servoscope.processes import ProgressBar, in_processes, no_progress, one_blas_thread
from servoscope.rehearsal.true_view import (
    WIDEST,
    Backdrop,
    OwnErrors,
    TrueView,
    relief_error,
    shifts,
)
from servoscope.selection import Forecast
from servoscope.selection.rms_interval import effective_groups, rms_interval

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

N_RENDERED = 512
"""Rendered images that join the real ones."""

ENOUGH_TESTED = 100
"""With so many independent groups tested, the RMS of one split is as sure as that of several."""

_N_PARTS = 3
_BLOCK = 10
_CHANCE = 3.0
_EVERY = 5


@dataclass(frozen=True, eq=False)
class Sample:
    """Images to learn from, and others to test on.

    Parameters
    ----------
    data : PoseImageSet
        The real images, and behind them those that were rendered, named ``rendered_0000`` and on.
    independence : IndependentGroups
        A rendered image is a group by itself.
    split : Split
        Only real images test.
    n_rendered : int
    view : FittedView, optional
        The keyframe that was rendered. It was fitted to real images that are learned from.
    real : PoseImageSet, optional
        The real images alone; all of them by default.
    parts : ndarray of shape (n_real,), optional
        Where some are rendered, in which part of the real images each is, one of which tests; -1
        for those of none.
    """

    data: PoseImageSet = field(repr=False)
    independence: IndependentGroups = field(repr=False)
    split: Split = field(repr=False)
    n_rendered: int = 0
    view: FittedView | None = field(default=None, repr=False)
    real: PoseImageSet = field(default=None, repr=False)  # type: ignore[assignment]
    parts: Indices | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.real is None:
            object.__setattr__(self, "real", self.data)

    @property
    def n_real(self) -> int:
        """The first so many images are real."""
        return len(self.data) - self.n_rendered

    @property
    def real_split(self) -> Split:
        """The split of the real images alone."""
        return Split(*(part[part < self.n_real] for part in vars(self.split).values()))

    def on_real_images(self, forecast: Forecast) -> Forecast:
        """A forecast from the images learned from, of one target, as it is for real images.

        The real ones among them, each predicted from all others, show what the rendered ones
        leave out: the larger of the two errors counts, as sure as so few real images allow.
        """
        if not self.n_rendered:
            return forecast
        of_real = forecast.residuals[self.split.learned < self.n_real]
        real, rendered = np.sqrt(np.mean(of_real**2, axis=0)), forecast.rms
        factor = np.maximum(np.divide(real, rendered, where=rendered > 0, out=np.ones(1)), 1.0)
        rms = factor * rendered
        spread = rms_interval(of_real) / np.where(real > 0, real, 1.0)
        return replace(
            forecast, rms=rms, interval=rms * spread, residuals=factor * forecast.residuals
        )


def sample_images(
    data: PoseImageSet,
    seed: int = 0,
    *,
    n_rendered: int = N_RENDERED,
    n_jobs: int | None = -1,
    progress: ProgressBar = no_progress,
) -> Sample:
    """The images of an assessment: the real ones, with rendered ones if there are too few.

    Of few images a third is kept for testing, independent groups as a whole. A keyframe is fitted
    to the others. If it reads at least half of those kept right, it is rendered at displacements
    spread as those learned from, with errors as large as its own and with the camera's noise.

    Parameters
    ----------
    data : PoseImageSet
    seed : int
        Of the split, of the displacements and of the noise.
    n_rendered : int
    n_jobs : int, optional
        Processes, as joblib counts them; every number of them gives the same.
    progress : ProgressBar

    Raises
    ------
    InvalidInputError
        If there are too few images, and no keyframe explains them.
    """
    check_enough_images(data)
    groups = independent_groups(data)
    try:
        return Sample(data, groups, split_groups(data, groups, seed))
    except InvalidInputError as error:
        too_few = str(error)
    try:
        parts = independent_groups(data, _N_PARTS).labels
    except InvalidInputError:
        raise InvalidInputError(too_few) from None
    return _with_rendered(
        data, groups, parts, seed % _N_PARTS, seed, n_rendered, too_few, n_jobs, progress
    )


def other_samples(
    sample: Sample,
    seed: int = 0,
    *,
    n_jobs: int | None = -1,
    progress: ProgressBar = no_progress,
) -> Iterator[Sample]:
    """The same images split otherwise, until `ENOUGH_TESTED` groups or all are tested, each once.

    Parameters
    ----------
    sample : Sample
    seed, n_jobs, progress
        As of `sample_images`. Images are rendered anew from a keyframe that has not seen the test
        images; a split in which none explains the view is left out.
    """
    labels, tested = sample.independence.labels, sample.split.test
    if sample.parts is None:
        for split in further_splits(sample.split, labels, seed):
            if effective_groups(labels[tested]) >= ENOUGH_TESTED:
                return
            tested = np.concatenate([tested, split.test])
            yield replace(sample, split=split)
        return
    groups = replace(sample.independence, labels=labels[: sample.n_real])
    for part in range(_N_PARTS):
        if part != seed % _N_PARTS:
            with suppress(InvalidInputError):
                yield _with_rendered(
                    sample.real,
                    groups,
                    sample.parts,
                    part,
                    seed,
                    sample.n_rendered,
                    "",
                    n_jobs,
                    progress,
                )


def _with_rendered(
    data: PoseImageSet,
    groups: IndependentGroups,
    parts: Indices,
    part: int,
    seed: int,
    n_rendered: int,
    too_few: str,
    n_jobs: int | None,
    progress: ProgressBar,
) -> Sample:
    """Few real images, a part of which tests, and images rendered of the others."""
    test = np.flatnonzero(parts == part)
    learn = np.flatnonzero((parts >= 0) & (parts != part))
    with progress("keyframe", 1) as advance, one_blas_thread():
        view = fit_view(data, learn, test)
        advance(1)
    if view is None or not view.explains:
        read = (
            "none can be fitted to them"
            if view is None
            else (f"that of these read {view.right.sum()} of {len(view.read)} others right")
        )
        raise InvalidInputError(
            f"{too_few} Fewer do where a keyframe explains the view, but {read}."
        )
    moving, delta_p = mask_of(data.dofs), np.zeros((n_rendered, 6))
    rng = np.random.default_rng([seed, len(data)])
    moved = data.delta_p()[np.ix_(learn, moving)]
    delta_p[:, moving] = _spread(moved, data.ranges()[moving], n_rendered, rng)
    images = _render(view, data, delta_p, seed, n_jobs, progress)
    learned = np.concatenate([learn, len(data) + np.arange(n_rendered)])
    decides = np.arange(len(learned)) % _EVERY == 0
    split = Split(learned[~decides], learned[decides], test)
    labels = np.concatenate([groups.labels, groups.labels.max() + 1 + np.arange(n_rendered)])
    joined = replace(
        data,
        images=np.concatenate([data.images, images]),
        T_world_cam=np.concatenate(
            [data.T_world_cam, poses_from_displacements(data.T_world_ref, delta_p, data.pivot)]
        ),
        names=[*data.names, *(f"rendered_{i:04d}" for i in range(n_rendered))],
        pivot_ranges=np.where(data.moves(), data.ranges(), 0.0),
        times=None,
        split="random",
        source={**data.source, "n_rendered": n_rendered},
        asked_dofs=data.dofs,
    )
    independence = replace(groups, labels=labels)
    return Sample(joined, independence, split, n_rendered, view, data, parts)


def _spread(delta_p: Array, ranges: Array, n: int, rng: np.random.Generator) -> Array:
    """Displacements spread as given ones, (n, n_dofs), within the ranges.

    Each dof is distributed as it is in those given, and dofs that clearly move together still do:
    a Gaussian copula of their rank correlations. Correlations that as many independent
    displacements may show by chance do not count, since features would seem informative about
    dofs that they do not see.
    """
    n_given, n_dofs = delta_p.shape
    order = np.sort(delta_p, axis=0)
    scores = norm.ppf((rankdata(delta_p, axis=0) - 0.5) / n_given)
    correlation = np.atleast_2d(np.corrcoef(scores, rowvar=False))
    correlation[np.abs(correlation) < _CHANCE / np.sqrt(n_given)] = 0.0
    values, vectors = np.linalg.eigh(correlation)
    even = qmc.Sobol(n_dofs, rng=rng).random(n)
    drawn = norm.ppf(even.clip(1e-9, 1 - 1e-9)) * np.sqrt(values.clip(0)) @ vectors.T
    shares = norm.cdf(drawn / np.sqrt(np.square(vectors) @ values.clip(0)))
    step = np.ptp(delta_p, axis=0) / (n_given - 1)
    order = np.concatenate([order[:1] - step, order, order[-1:] + step]).clip(-ranges, ranges)
    at = np.linspace(0, 1, n_given + 2)
    return np.column_stack(
        [np.interp(share, at, one) for share, one in zip(shares.T, order.T, strict=True)]
    )


def _render(
    view: FittedView,
    data: PoseImageSet,
    delta_p: Array,
    seed: int,
    n_jobs: int | None,
    progress: ProgressBar,
) -> NDArray[np.uint8]:
    """Images of a keyframe at displacements about its pivot, with the camera's noise.

    What lies beside the reference view is as the images show it that the keyframe was fitted to.
    """
    keyframe = view.keyframe
    errors = OwnErrors(keyframe.model_error, relief_error(keyframe))
    noise = keyframe.noise * min(1.0, view.readings.residual_over_noise)  # some was texture
    moved = inverse_transform(data.T_world_ref) @ data.T_world_cam[view.fitted]
    order = np.argsort(shifts(keyframe, moved), kind="stable")
    beside = Backdrop(keyframe, min(WIDEST, data.image_shape[1])).shown_in(
        (data.images[view.fitted[k]], inverse_transform(conjugate(keyframe.mount, moved[k])))
        for k in order
    )
    displacements = poses_from_displacements(np.eye(4), delta_p, keyframe.pivot)
    calls = [
        (keyframe, errors, beside, displacements[k : k + _BLOCK], noise, [seed, k])
        for k in range(0, len(delta_p), _BLOCK)
    ]
    blocks = []
    with progress("rendered images", len(calls)) as advance:
        for block in in_processes(_render_block, calls, n_jobs, batch_size=1):
            blocks.append(block)
            advance(len(blocks))
    return np.concatenate(blocks)


def _render_block(
    keyframe: Keyframe,
    errors: OwnErrors,
    beside: Backdrop,
    displacements: Array,
    noise: float,
    seed: list[int],
) -> NDArray[np.uint8]:
    """Images of a view with errors of its own."""
    rng = np.random.default_rng(seed)
    with one_blas_thread():
        view = replace(TrueView.draw(keyframe, errors, rng), backdrop=beside)
        clean = np.stack([view.image(D) for D in displacements])
    grey = clean + rng.normal(0, noise, clean.shape)
    return np.rint(grey.clip(0, 255)).astype(np.uint8)
