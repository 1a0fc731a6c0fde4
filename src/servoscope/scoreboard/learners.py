"""The methods that learn from images, and how what they learned is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.errors import RunFolderError
from servoscope.files import write_arrays
from servoscope.storage.archives import read_arrays


@dataclass(frozen=True)
class Learner:
    """A method that learns from images.

    Parameters
    ----------
    train : callable
        Makes an `Estimator` of a `PoseImageSet`; takes ``seed``, ``n_jobs`` and ``on_progress`` by
        name.
    save : callable
        Writes the estimator to a path, in place of one that is there.
    load : callable
        Reads it again.
    """

    train: Callable[..., Any]
    save: Callable[[Any, Path], object]
    load: Callable[[Path], Any]


def _train_ours(data: PoseImageSet, **options: Any) -> Any:
    from servoscope.positioning.training import train

    return train(data, **options)


def _save_ours(model: Any, path: Path) -> None:
    model.save(path, force=True)


def _load_ours(path: Path) -> Any:
    from servoscope.positioning.model import PositioningModel

    return PositioningModel.load(path)


def _train_networks(data: PoseImageSet, **options: Any) -> Any:
    from servoscope.positioning.iterated_networks import IteratedNetworks

    return IteratedNetworks.train(data, **options)


def _save_networks(model: Any, path: Path) -> None:
    path.mkdir(exist_ok=True)
    arrays = {"reference_image": model.reference_image, "pivot": np.array(model.pivot)}
    for k, ring in enumerate(model.rings):
        arrays |= {f"{k}/{name}": array for name, array in ring.to_arrays().items()}
    write_arrays(path / "arrays.npz", arrays)


def _load_networks(path: Path) -> Any:
    from servoscope.positioning.iterated_networks import IteratedNetworks
    from servoscope.positioning.pose_networks import PoseNetworks

    arrays = read_arrays(path / "arrays.npz", None, RunFolderError)
    reference_image, pivot = arrays.pop("reference_image"), float(arrays.pop("pivot"))
    rings: dict[int, dict[str, Any]] = {}
    for name, array in arrays.items():
        k, _, own = name.partition("/")
        rings.setdefault(int(k), {})[own] = array
    nets = tuple(PoseNetworks.from_arrays(rings[k]) for k in sorted(rings))
    return IteratedNetworks(nets, reference_image, pivot)


LEARNERS = {
    "ours": Learner(_train_ours, _save_ours, _load_ours),
    "networks": Learner(_train_networks, _save_networks, _load_networks),
}
