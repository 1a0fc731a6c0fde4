"""Training a model for positioning."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from servoscope.dataset import PoseImageSet
from servoscope.errors import DataSetError
from servoscope.positioning.ladder import learn_levels
from servoscope.positioning.model import PositioningModel
from servoscope.processes import one_blas_thread


def train(
    data: PoseImageSet,
    *,
    seed: int = 0,
    n_jobs: int = -1,
    on_progress: Callable[[int], object] | None = None,
) -> PositioningModel:
    """Learn to tell where images were taken.

    Parameters
    ----------
    data : PoseImageSet
        Best taken in rings around the reference, see ``servoscope acquire --schedule``. Its poses
        may be the flange's: where the camera sits need not be known.
    seed : int
        Draws what is held out, and the disturbances.
    n_jobs : int
    on_progress : callable, optional

    Returns
    -------
    PositioningModel

    Raises
    ------
    DataSetError
        If there are too few images, or a dof never moves.
    """
    if not data.moves().all():
        raise DataSetError(
            "Training for positioning needs images displaced along and about every axis, but "
            "some dofs never move in this data set; take images with all six displaced."
        )
    reach = data.ranges()
    rng = np.random.default_rng([seed, len(data)])
    with one_blas_thread():
        levels, _ = learn_levels(data.images, data.delta_p() / reach, data.reference_image, rng)
    return PositioningModel(levels, data.reference_image, data.pivot, reach, dict(data.source))
