"""What positioning needs of a camera, of a robot, and of what turns images into displacements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from servoscope.poses import DOFS

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class Camera(Protocol):
    """Anything that takes grey images."""

    def read(self) -> Image:
        """A new image, (height, width), taken after the call."""


class Robot(Protocol):
    """Anything that carries the camera.

    The frame that is reported and moved may be the camera's or the flange's, as long as it is the
    one of the training poses. Where the camera sits in it need not be known.

    A robot may also offer ``stop()``, which is called at the end of every run that may have moved
    it: it must be safe to call while the robot stands. One that offers
    ``move(displacement)``, with ``T_new = T_now @ displacement``, which returns the displacement
    that was executed, is moved by that, and needs no `move_to`.
    """

    @property
    def pose(self) -> Array:
        """``T_world_cam`` as the robot believes it, (4, 4), [m]."""

    def move_to(self, pose: Array) -> object:
        """Go to a pose, and return once the robot stands there.

        Parameters
        ----------
        pose : ndarray of shape (4, 4)
            Of the frame that `pose` reports, in the same world, [m].

        Raises
        ------
        Exception
            Of any kind, if the robot cannot or will not; its message is shown to the user.
        """


@dataclass(frozen=True, eq=False)
class Estimate:
    """Where an image was taken, as far as it informs of that.

    Parameters
    ----------
    displacement : ndarray of shape (4, 4)
        Displacement from the reference, ``inv(T_world_ref) @ T_world_cam``, [m].
    std : ndarray of shape (6,)
        Standard deviation that is believed of each dof about the pivot, [m] and [rad]; NaN where
        nothing is believed.
    novelty : float
        How unlike the training images the image is; 1 is the most that is taken for alike, NaN
        where that is not known.
    stage : str
        What answered, such as ``"coarse"`` or ``"fine"``.
    is_finest : bool
        Whether no other stage could be more exact; only then can the camera have arrived.
    similarity : float
        Typical normalised correlation, cell by cell, of the image with what is expected at the
        displacement: 1 for the same, 0 for unrelated images; NaN where it is not known.
    least_similarity : float
        What images of the part have at least, as far as the estimator knows.
    """

    displacement: Array
    std: Array
    novelty: float
    stage: str
    is_finest: bool = True
    similarity: float = float("nan")
    least_similarity: float = 0.75

    @property
    def is_recognised(self) -> bool:
        """Whether the image shows the part, not too far away, as far as either is known."""
        return not (self.similarity < self.least_similarity or self.novelty > 1)

    @property
    def distance(self) -> float:
        """How far from the reference it believes the frame to be, [m]."""
        return float(np.linalg.norm(self.displacement[:3, 3]))


class Estimator(Protocol):
    """What turns an image into a displacement.

    One that is for some degrees of freedom alone says so by an attribute ``dofs``, a tuple of
    their names. Its displacements are exactly 0 in the others, and their deviations NaN.
    """

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the images that it takes."""

    @property
    def reference_image(self) -> Image:
        """The view to bring the camera back to, uint8."""

    @property
    def pivot(self) -> float:
        """Distance along z of the point that displacements are taken about, [m]."""

    @property
    def reach(self) -> Array:
        """Largest displacements about the pivot that it was made for, (6,), [m] and [rad]."""

    def estimate(self, image: Image, previous: Estimate | None) -> Estimate:
        """Where an image was taken.

        Parameters
        ----------
        image : ndarray of shape (height, width), uint8
        previous : Estimate or None
            Of the image before it, whose stage hangs on; None at the start.
        """


def dofs_of(estimator: Any) -> tuple[str, ...]:
    """The degrees of freedom that an estimator is for; all six if it does not say."""
    return tuple(getattr(estimator, "dofs", DOFS))
