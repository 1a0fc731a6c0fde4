"""What is said of features from few images and rendered ones, beside what 1000 real ones say.

``python -m benchmarks rendered_ranking``. Two thirds of an acquisition of few images, and what a
keyframe of these renders, are learned from, as `servoscope assess` does it. The information of each
feature, and the forecast of each family, are compared with those from the real images of another
acquisition; a part of these, as many as were learned from, says how well they can be known at best.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from benchmarks.tables import Findings
from servoscope import DOFS, AcquisitionConfig, PoseImageSet, acquire
from servoscope.assessment.rendered import sample_images
from servoscope.features.catalogue import default_families, title_of
from servoscope.pipeline import FeatureTable, Recipe, forecast_all
from servoscope.selection import mutual_information

Array = NDArray[np.float64]

PARTS = {"cylinder_head": "cylinder head", "textured_plane": "textured plane"}
SIZE, N_REAL, N_FOLDS, FEWEST = 128, 1000, 3, 20
BESIDE = ("rendered", "as many")


def tables(quick: bool) -> Iterator[Findings]:
    """One table of every part."""
    size, n_real = (96, 400) if quick else (SIZE, N_REAL)
    for part in list(PARTS)[: 1 if quick else 2]:
        with tempfile.TemporaryDirectory() as folder:
            few = _acquired(Path(folder) / "few", part, FEWEST, size, seed=1)
            many = _acquired(Path(folder) / "many", part, n_real, size, seed=0)
            yield _compared(few, many, PARTS[part])


def _acquired(folder: Path, part: str, n_images: int, size: int, seed: int) -> PoseImageSet:
    return acquire(
        folder, AcquisitionConfig(n_images=n_images, part=part, image_size=size, seed=seed)
    )


def _compared(few: PoseImageSet, many: PoseImageSet, title: str) -> Findings:
    sample = sample_images(few)
    learned, n_many = sample.split.learned, len(many)
    some = np.random.default_rng(0).permutation(n_many)[: len(learned)]
    families = default_families()
    images = np.concatenate([sample.data.images[learned], many.images])
    targets = np.concatenate([_targets(sample.data)[learned], _targets(many)])
    rendered = _table(images, targets, families, np.arange(len(learned)))
    real = _table(many.images, _targets(many), families, np.arange(n_many))
    as_many = _table(many.images, _targets(many), families, some)
    names = [name for name in rendered.fitted if real.has(name) and as_many.has(name)]
    values = rendered.values
    info = {
        "rendered": mutual_information(values[: len(learned)], targets[: len(learned)]),
        "as many": mutual_information(values[len(learned) :][some], targets[len(learned) :][some]),
        "real": mutual_information(values[len(learned) :], targets[len(learned) :]),
    }
    rms = {
        "rendered": _forecasts(rendered, targets, names),
        "as many": _forecasts(as_many, _targets(many), names),
        "real": _forecasts(real, _targets(many), names),
    }
    rows = []
    for i, name in enumerate(names):
        columns = rendered.columns(Recipe(name))
        rows.append(
            (
                title_of(name),
                *(f"{_agreement(info[one][columns], info['real'][columns]):.2f}" for one in BESIDE),
                *(_ratios(rms[one][i] / rms["real"][i]) for one in BESIDE),
            )
        )
        print(title, *rows[-1], file=sys.stderr, flush=True)
    orders = (f"{_agreement(rms[one], rms['real']):.2f}" for one in BESIDE)
    rows.append(
        ("order of all", *(f"{_agreement(info[one], info['real']):.2f}" for one in BESIDE), *orders)
    )
    losses = (f"{_loss(rms[one], rms['real']):.2f}" for one in BESIDE)
    rows.append(("error of the family chosen, over the best", "", "", *losses))
    return Findings(
        f"Features of the {title}: {len(few)} real images and {sample.n_rendered} rendered",
        f"Beside {n_many} real images: Spearman's correlation of mutual information over the "
        "features, mean of the dofs; forecast error, median and range of the dofs, over that from "
        "all real images",
        (
            "features",
            "information, rendered",
            f"{len(some)} real",
            "forecast, rendered",
            f"{len(some)} real",
        ),
        rows,
    )


def _table(
    images: NDArray[np.uint8], targets: Array, families: Sequence[str], learn: NDArray[np.intp]
) -> FeatureTable:
    return FeatureTable.fit(images, targets, families, learn, n_folds=N_FOLDS)


def _targets(data: PoseImageSet) -> Array:
    return np.asarray(data.delta_p() / data.ranges())


def _forecasts(table: FeatureTable, targets: Array, names: list[str]) -> Array:
    """RMS errors, (n_families, 6), in units of the range."""
    jobs = [(Recipe(name), dof) for name in names for dof in DOFS]
    found = forecast_all(table, targets, None, jobs)
    return np.array([one.rms[0] for one in found]).reshape(len(names), len(DOFS))


def _agreement(a: Array, b: Array) -> float:
    """Mean over the dofs of Spearman's correlation, of arrays (n, 6)."""
    return float(np.nanmean([spearmanr(a[:, i], b[:, i])[0] for i in range(a.shape[1])]))


def _ratios(ratios: Array) -> str:
    return f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})"


def _loss(chosen_by: Array, real: Array) -> float:
    """By how much more the family that one chooses errs than the best, in the mean of the dofs."""
    chosen = np.take_along_axis(real, chosen_by.argmin(axis=0)[None], axis=0)[0]
    return float(np.exp(np.mean(np.log(chosen / real.min(axis=0)))))
