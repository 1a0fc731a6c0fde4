"""How a run of the loop went and how it ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.poses import DOFS
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.reference_view import Comparison

Array = NDArray[np.float64]

STATUSES = (
    "converged",
    "limited",
    "max_moves",
    "abstained",
    "diverged",
    "inconsistent",
    "out_of_workspace",
    "robot_fault",
    "camera_fault",
    "callback_fault",
    "interrupted",
    "dry_run",
)
"""How a run may end."""


@dataclass(frozen=True, eq=False)
class Step:
    """One look, and the move that followed.

    Parameters
    ----------
    pose : ndarray of shape (4, 4)
        Of the robot when it looked, ``T_world_cam`` as it believes it, [m].
    image_error : float
        Of the image against the reference, see `image_error`.
    estimate : Estimate
    commanded : ndarray of shape (4, 4) or None
        Displacement that was asked of the robot, or would have been in a dry run; None if it was
        to stay.
    executed : ndarray of shape (4, 4) or None
        Displacement that it made, as it says; None if it made none or does not say.
    seconds : float
        From the image to the command, without the camera's and the robot's own time.
    comparison : Comparison or None
        With the reference, cell by cell; None in a log that does not hold it.
    first_displacement : ndarray of shape (4, 4) or None
        Of the first image alone, where the estimate is the mean of several.
    """

    pose: Array
    image_error: float
    estimate: Estimate
    commanded: Array | None
    executed: Array | None
    seconds: float
    comparison: Comparison | None = None
    first_displacement: Array | None = None

    def to_dict(self) -> dict[str, Any]:
        """The step as plain JSON values; NaN becomes None."""
        return {
            "pose": plain(self.pose),
            "image_error": plain(self.image_error),
            "stage": self.estimate.stage,
            "novelty": plain(self.estimate.novelty),
            "similarity": plain(self.estimate.similarity),
            "is_finest": self.estimate.is_finest,
            "displacement": plain(self.estimate.displacement),
            "std": plain(self.estimate.std),
            "first_displacement": plain(self.first_displacement),
            "commanded": plain(self.commanded),
            "executed": plain(self.executed),
            "seconds": plain(self.seconds),
            "comparison": None
            if self.comparison is None
            else {k: plain(v) for k, v in self.comparison._asdict().items()},
        }


@dataclass(frozen=True, eq=False)
class PositioningResult:
    """How a run went.

    Parameters
    ----------
    status : str
        One of `STATUSES`.
    message : str
        One line for a person: what happened, and what to do about it.
    moves : int
        Moves that the robot completed, those back to the best pose included.
    remaining : ndarray of shape (6,)
        Displacement from the reference that is believed where the robot stands, about the pivot,
        [m] and [rad], in `DOFS` order; NaN where that is not known.
    std : ndarray of shape (6,)
        Standard deviation that is believed of `remaining`.
    steps : tuple of Step
    returned_to : int or None
        Number of the step whose pose the robot went back to, if it did.
    dofs : tuple of str
        The degrees of freedom that were commanded; `remaining` and `std` are NaN in all others.
    """

    status: str
    message: str
    moves: int
    remaining: Array
    std: Array
    steps: tuple[Step, ...]
    returned_to: int | None = None
    dofs: tuple[str, ...] = DOFS

    @property
    def predicted_error(self) -> Array:
        """Root mean square error that is believed to be left in each dof, (6,), [m] and [rad]."""
        return np.hypot(self.remaining, self.std)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain JSON values, in metres and radians; NaN becomes None."""
        return {
            "status": self.status,
            "message": self.message,
            "moves": self.moves,
            "dofs": list(self.dofs),
            "remaining": plain(self.remaining),
            "std": plain(self.std),
            "predicted_error": plain(self.predicted_error),
            "returned_to": self.returned_to,
            "steps": [step.to_dict() for step in self.steps],
        }


def plain(value: Any) -> Any:
    """Numbers and arrays as floats and lists, with None for what is not finite."""
    if value is None:
        return None
    if np.ndim(value):
        return [plain(item) for item in value]
    return float(value) if np.isfinite(value) else None
