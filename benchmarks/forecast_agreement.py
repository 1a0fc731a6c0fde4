"""How errors forecast before training agree with those that were reached."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator
from scipy.stats import spearmanr

from benchmarks.tables import Findings

FAMILIES = ("gm", "pca", "pci", "lfa35", "lfa85")
SIZES = (1, 2, 4, 8, 16, 24, 65)
BAND = (0.75, 1.33)
WAYS = {"forecast": "as they are", "crossfit": "fitted anew in folds"}
TICKS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
REGRESSORS = {"gp": "Gaussian process", "nets": "the paper's nets", "better": "the better"}


@dataclass(frozen=True)
class Point:
    """A subset of features for one dof: what was forecast, and what was reached.

    All errors are RMS, in shares of the range; ``spread`` is by which factor each interval reaches
    above its error, ``gp_spread`` the same for the error at the test images.
    """

    data: str
    seed: int
    form: str
    features: str
    dof: str
    forecast: float
    forecast_spread: float
    crossfit: float
    crossfit_spread: float
    gp: float
    gp_spread: float
    nets: float

    @property
    def better(self) -> float:
        """Of the Gaussian process and the nets."""
        return min(self.gp, self.nets)


def rms(errors: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(errors**2)))


def pooled(points: Sequence[Point]) -> list[Point]:
    """Root mean squares over the splits of a data set."""
    kinds: dict[tuple[str, ...], list[Point]] = {}
    for p in points:
        kinds.setdefault((p.data, p.form, p.features, p.dof), []).append(p)
    return [
        replace(
            same[0],
            **{n: rms(np.array([getattr(p, n) for p in same])) for n in (*WAYS, "gp", "nets")},
        )
        for same in kinds.values()
    ]


def agreement(points: Sequence[Point]) -> Findings:
    """How forecast and reached errors agree, for each data set, way and regressor."""
    rows = []
    for data in dict.fromkeys(p.data for p in points):
        single = [p for p in points if p.data == data]
        n_splits = len({p.seed for p in single})
        sets = {f"{data}, single splits": single}
        if n_splits > 1:
            sets[f"{data}, {n_splits} splits pooled"] = pooled(single)
        rows += [
            (
                *(name, str(len(some)), WAYS[way], REGRESSORS[regressor]),
                *_figures(some, way, regressor),
                _held(some, way) if some is single and regressor == "gp" else "",
            )
            for name, some in sets.items()
            for way in WAYS
            for regressor in REGRESSORS
        ]
    header = ("data", "points", "features", "reached by", "Spearman", "median ratio")
    header = (*header, f"within {BAND[0]} to {BAND[1]}", "interval holds")
    job = (
        f"RMS error forecast from the training images over that reached on the test images; "
        f"{len(FAMILIES)} families and the first {', '.join(map(str, SIZES))} candidates in "
        "ideal-point order, every dof, both displacement forms (whose rotations are the same); "
        "the interval is that of the forecast joined with that of the test error, 90 %"
    )
    return Findings("Errors forecast before training", job, header, rows)


def _figures(points: Sequence[Point], way: str, regressor: str) -> tuple[str, ...]:
    forecast, reached = (np.array([getattr(p, n) for p in points]) for n in (way, regressor))
    ratio = forecast / reached
    return (
        f"{spearmanr(forecast, reached).statistic:.3f}",
        f"{np.median(ratio):.2f}",
        f"{np.mean((ratio >= BAND[0]) & (ratio <= BAND[1])):.0%}",
    )


def _held(points: Sequence[Point], way: str) -> str:
    """How often the logarithms differ by no more than the intervals of both together."""
    apart = np.log([getattr(p, way) / p.gp for p in points])
    spreads = np.log([(getattr(p, f"{way}_spread"), p.gp_spread) for p in points])
    return f"{np.mean(np.abs(apart) <= np.hypot(*spreads.T)):.0%}"


def plot_agreement(points: Sequence[Point], way: str = "forecast", *, ax: Axes) -> Axes:
    """Forecast against reached errors, with the band's edges as lines."""
    for family, marker in zip((*FAMILIES, "first"), "osD^v+", strict=True):
        some = [p for p in points if p.features.split()[0] == family]
        label = "ideal-point order" if family == "first" else family.upper()
        ax.loglog(
            [p.better for p in some],
            [getattr(p, way) for p in some],
            marker,
            markersize=4,
            color="0.15" if marker in "o+" else "0.5",
            markerfacecolor="none" if marker in "D^v" else None,
            label=label,
        )
    ends = np.array([min(p.better for p in points) * 0.8, max(p.better for p in points) * 1.25])
    for ratio, style in zip((*BAND, 1.0), (":", ":", "-"), strict=True):
        ax.plot(ends, ratio * ends, style, color="0.6", linewidth=0.8, zorder=0)
    ticks = [t for t in TICKS if ends[0] <= t <= ends[1]]
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_locator(NullLocator())
        axis.set_ticks(ticks, [f"{t:g}" for t in ticks])
    ax.set_aspect("equal")
    ax.set_xlabel("reached RMS on test images, share of range")
    ax.set_ylabel("forecast RMS, share of range")
    ax.legend(frameon=False, fontsize=8)
    return ax
