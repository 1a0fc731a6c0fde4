"""The paper's networks for positioning: one a dof, on features chosen for it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLAY_FACTORS
from servoscope.positioning.linear_features import FeaturePool
from servoscope.regression import PoseRegressor
from servoscope.scene.disturbances import Disturbances

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class PoseNetworks:
    """The displacement that images were taken at, by one network a dof.

    Parameters
    ----------
    pool : FeaturePool
        The features that the networks take.
    regressor : PoseRegressor
        The networks, from features to displacements in units of `ranges`.
    ranges : ndarray of shape (6,)
        [m] and [rad].
    facts : dict
        What `report` tells.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> images = rng.integers(0, 256, (60, 16, 16), dtype=np.uint8)
    >>> delta_p = rng.uniform(-1, 1, (60, 6))
    >>> networks = PoseNetworks.train(images, delta_p, np.ones(6), n_jobs=1)
    >>> networks.predict(images[:2]).shape
    (2, 6)
    """

    pool: FeaturePool
    regressor: PoseRegressor
    ranges: Array
    facts: dict[str, Any]

    @classmethod
    def train(
        cls,
        images: Image,
        delta_p: Array,
        ranges: Array,
        *,
        disturbances: Disturbances | None = None,
        seed: int = 0,
        n_jobs: int | None = -1,
        on_progress: Callable[[int], object] | None = None,
    ) -> PoseNetworks:
        """Choose features and train networks.

        Parameters
        ----------
        images : ndarray of shape (n, height, width), uint8
        delta_p : ndarray of shape (n, 6)
            Displacements, [m] and [rad].
        ranges : ndarray of shape (6,)
            Units in which the networks tell displacements, [m] and [rad].
        disturbances : Disturbances, optional
            What the networks are to hold up against. Without any, the features are the paper's 65;
            with them there are more, those that do not hold up are left out, and disturbed copies
            of the images train as well.
        seed : int
        n_jobs : int, optional
            Processes, as joblib counts them; the result does not depend on it.
        on_progress : callable, optional
            Called with the number of images prepared and networks trained so far.

        Returns
        -------
        PoseNetworks

        Raises
        ------
        InvalidInputError
            If there are fewer than 40 images, or the arrays do not belong together.
        """
        from servoscope.positioning.network_training import train_pose_networks

        return train_pose_networks(images, delta_p, ranges, disturbances, seed, n_jobs, on_progress)

    def predict(self, images: Image) -> Array:
        """Displacements of images of shape (n, height, width), (n, 6), [m] and [rad]."""
        return self.regressor.predict(self.pool.of_images(images)) * self.ranges

    @property
    def validation_rms(self) -> Array:
        """RMS error on undisturbed images that were kept from training, (6,), [m] and [rad]."""
        return np.array(self.facts["validation_rms"]["clean"]) / DISPLAY_FACTORS

    @property
    def doubt(self) -> Array:
        """RMS error on kept images under the worst single disturbance, (6,), [m] and [rad]."""
        kinds = self.facts["validation_rms"].values()
        return np.max(list(kinds), axis=0) / DISPLAY_FACTORS

    def report(self) -> dict[str, Any]:
        """What was chosen and measured, as plain JSON values.

        Returns
        -------
        dict
            ``features``: those of each dof. ``left_out``: for each feature that did not hold up,
            the share of its variance over poses that each disturbance changed, None for one that
            poses do not change. ``largest_share``:
            the most that was let in. ``validation_rms``: errors of images kept from training,
            undisturbed and under each single disturbance, [mm] and [deg].
        """
        return self.facts

    def to_arrays(self) -> dict[str, NDArray]:
        """All of it as plain arrays with flat names."""
        arrays = {f"pool.{name}": array for name, array in self.pool.to_arrays().items()}
        arrays |= {f"networks.{name}": a for name, a in self.regressor.to_arrays().items()}
        return {**arrays, "ranges": self.ranges, "report": np.array(json.dumps(self.facts))}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> PoseNetworks:
        """What `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
        missing = {"ranges", "report"} - set(arrays)
        if missing:
            raise InvalidInputError(f"Pose networks need the array {min(missing)!r}.")
        pool = FeaturePool.from_arrays(_part(arrays, "pool."))
        regressor = PoseRegressor.from_arrays(_part(arrays, "networks."))
        if regressor.n_features_in_ != len(pool.names):
            raise InvalidInputError(
                f"The networks take {regressor.n_features_in_} features, but the pool has "
                f"{len(pool.names)}: the arrays are not of one model."
            )
        ranges = np.asarray(arrays["ranges"], dtype=np.float64)
        return cls(pool, regressor, ranges, json.loads(str(np.asarray(arrays["report"]))))


def _part(arrays: Mapping[str, ArrayLike], prefix: str) -> dict[str, ArrayLike]:
    return {name.removeprefix(prefix): a for name, a in arrays.items() if name.startswith(prefix)}
