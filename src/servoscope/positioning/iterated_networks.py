"""The paper's networks alone, looked at again after every move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.data.schedule import parse_schedule
from servoscope.errors import InvalidInputError
from servoscope.poses import poses_from_displacements
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.pose_networks import PoseNetworks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

ENTER, LEAVE = 1.0, 1.3
"""Shares of a ring's range within which it is entered, and beyond which it is left."""

LEAST_IMAGES = 100
"""Images of a ring, below which it has no networks of its own."""

_ROUNDING = 1e-3


@dataclass(frozen=True, eq=False)
class IteratedNetworks:
    """Displacements told by the networks of the smallest ring that holds them.

    The networks are the paper's own, trained on undisturbed images. They say nothing of how unlike
    the training images an image is.

    Parameters
    ----------
    rings : tuple of PoseNetworks
        From the largest ring to the smallest.
    reference_image : ndarray of shape (height, width), uint8
    pivot : float
        [m].

    Examples
    --------
    A larger ring is entered again only when the smaller one is left by far:

    >>> from servoscope.positioning.iterated_networks import ENTER, LEAVE
    >>> ENTER < LEAVE
    True
    """

    rings: tuple[PoseNetworks, ...]
    reference_image: Image
    pivot: float

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the images that it takes."""
        return self.reference_image.shape[0], self.reference_image.shape[1]

    @property
    def reach(self) -> Array:
        """Largest displacements about the pivot that it was made for, [m] and [rad]."""
        return self.rings[0].ranges

    @classmethod
    def train(
        cls,
        data: PoseImageSet,
        seed: int = 0,
        n_jobs: int | None = -1,
        on_progress: Callable[[int], object] | None = None,
    ) -> IteratedNetworks:
        """Train the networks of every ring.

        Parameters
        ----------
        data : PoseImageSet
            Taken in rings, as its source tells; in one if it tells of none.
        seed : int
        n_jobs : int, optional
            Processes, as joblib counts them.
        on_progress : callable, optional
            Called with the number of images prepared and networks trained so far.

        Raises
        ------
        InvalidInputError
            If no ring has as many as 100 images.
        """
        delta_p, done, rings = data.delta_p(), _Count(on_progress), []
        for ranges, members in _split_by_rings(data):
            networks = PoseNetworks.train(
                data.images[members],
                delta_p[members],
                ranges,
                seed=seed,
                n_jobs=n_jobs,
                on_progress=done.of_part(),
            )
            rings.append(networks)
        return cls(tuple(rings), data.reference_image, data.pivot)

    def estimate(self, image: Image, previous: Estimate | None) -> Estimate:
        """Where an image was taken; see `Estimator`.

        Notes
        -----
        The ring that answered before is asked first, the largest one at the start. A larger ring
        is asked when the answer lies outside by more than 30 %, and a smaller one when it lies
        within that; the smaller one's answer counts unless it lies outside itself.
        """
        ring = 0 if previous is None else self._names().index(previous.stage)
        delta_p = self.rings[ring].predict(image[None])[0]
        while ring > 0 and self._share(delta_p, ring) > LEAVE:
            ring -= 1
            delta_p = self.rings[ring].predict(image[None])[0]
        while ring + 1 < len(self.rings) and self._share(delta_p, ring + 1) < ENTER:
            nearer = self.rings[ring + 1].predict(image[None])[0]
            if self._share(nearer, ring + 1) > LEAVE:
                break
            ring, delta_p = ring + 1, nearer
        displacement = poses_from_displacements(np.eye(4), delta_p, self.pivot)
        return Estimate(
            displacement,
            self.rings[ring].validation_rms,
            np.nan,
            stage=self._names()[ring],
            is_finest=ring + 1 == len(self.rings),
        )

    def _share(self, delta_p: Array, ring: int) -> float:
        """The largest displacement of a dof as a share of a ring's range."""
        return float(np.abs(delta_p / self.rings[ring].ranges).max())

    def _names(self) -> list[str]:
        return [f"ring {i}" for i in range(len(self.rings))]


class _Count:
    """Progress through parts of the work whose lengths are not known before."""

    def __init__(self, on_progress: Callable[[int], object] | None) -> None:
        self.on_progress, self.n_done = on_progress, 0

    def of_part(self) -> Callable[[int], None]:
        before = self.n_done

        def count(n_done: int) -> None:
            self.n_done = before + n_done
            if self.on_progress is not None:
                self.on_progress(self.n_done)

        return count


def _split_by_rings(data: PoseImageSet) -> list[tuple[Array, NDArray[np.intp]]]:
    """Ranges and images of each ring that has enough of them, the largest first.

    An image belongs to the smallest ring that holds its displacement; rings too small for
    networks of their own leave their images to the next larger one.
    """
    told = data.source.get("rings")
    factors = sorted({ring.factor for ring in parse_schedule(told)}) if told else [1.0]
    moves, ranges = data.moves(), data.ranges() / max(factors)
    size = np.abs(data.delta_p()[:, moves] / ranges[moves]).max(axis=1, initial=0.0)
    split: list[tuple[Array, NDArray[np.intp]]] = []
    left = np.ones(len(data), dtype=bool)
    for factor in factors:
        is_largest = factor == factors[-1]
        members = np.flatnonzero(left & (is_largest | (size <= factor * (1 + _ROUNDING))))
        if len(members) >= LEAST_IMAGES:
            split.insert(0, (factor * ranges, members))
            left[members] = False
    if not split:
        raise InvalidInputError(
            f"Networks need a ring of {LEAST_IMAGES} images or more, got {len(data)} images in "
            f"all; take more."
        )
    return split
