"""A robot that lives in a recording: it goes to the recorded pose that is nearest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.poses import as_rigid, inverse_transform, pose_error

Array = NDArray[np.float64]

MM_PER_DEG = 10.0
"""By default a degree counts as much as this many mm: the part is about half a metre away."""

_SAME = 1e-6


class Spacing(NamedTuple):
    """Distance between poses, [mm] and [deg]."""

    mm: float
    deg: float


class RecordedRobot:
    """A camera that is carried from one recorded pose to another, and shows what was recorded.

    Sent to a pose it goes to the nearest recorded one, the reference included, and reports that
    pose. So a loop can be tried on real images without a robot, and comes as near to the reference
    as the frames allow.

    Parameters
    ----------
    data : PoseImageSet
        Its images, poses and reference are the frames; best others than the model learned from.
    start : int
        Number of the frame to begin at, from 0; the reference is frame ``len(data)``.
    with_reference : bool
        Whether the reference is one of the frames; else no run can end nearer than the next one.
    mm_per_deg : float
        How many mm a degree counts as: a frame ``d`` mm and ``a`` degrees from where the robot is
        sent is ``sqrt(d^2 + (mm_per_deg a)^2)`` away.

    Raises
    ------
    InvalidInputError
        If there is no such frame, `mm_per_deg` is not positive and finite, or all frames are at
        the reference.

    Examples
    --------
    Frames 10 mm apart; sent 14 mm on, the robot goes to the next one:

    >>> images = np.arange(3 * 64, dtype=np.uint8).reshape(3, 8, 8)
    >>> poses = np.stack([np.eye(4)] * 3)
    >>> poses[:, 0, 3] = 0.01, 0.02, 0.03
    >>> data = PoseImageSet(images, poses, np.eye(4), images[0] + 1)
    >>> robot = RecordedRobot(data, start=2)
    >>> away = np.eye(4)
    >>> away[0, 3] = -0.014
    >>> executed = robot.move(away)
    >>> robot.frame, float(executed[0, 3].round(3))
    (1, -0.01)
    >>> robot.spacing()
    Spacing(mm=10.0, deg=1.0)
    """

    def __init__(
        self,
        data: PoseImageSet,
        start: int = 0,
        *,
        with_reference: bool = True,
        mm_per_deg: float = MM_PER_DEG,
    ) -> None:
        if not 0 < mm_per_deg < np.inf:
            raise InvalidInputError(f"mm_per_deg must be positive and finite, got {mm_per_deg}.")
        last = len(data) - (not with_reference)
        if not 0 <= start <= last:
            raise InvalidInputError(f"start must be a frame from 0 to {last}, got {start}.")
        self._images = [*data.images, data.reference_image]
        self._poses = np.concatenate([data.T_world_cam, data.T_world_ref[None]])
        self._mm_per_deg = float(mm_per_deg)
        if not (self._away(data.T_world_ref) > _SAME).any():
            raise InvalidInputError(
                "All recorded frames are at the reference; record some at other poses."
            )
        self._is_frame = with_reference | (self._away(data.T_world_ref) > _SAME)
        self.frame = int(start)

    @property
    def pose(self) -> Array:
        """Recorded ``T_world_cam`` of the frame that the robot is at, (4, 4), [m]."""
        return self._poses[self.frame].copy()

    @property
    def true_pose(self) -> Array:
        """The same: nothing better is known of it."""
        return self.pose

    def read(self) -> NDArray[np.uint8]:
        """The recorded image, (height, width)."""
        return self._images[self.frame].copy()

    def move(self, displacement: ArrayLike) -> Array:
        """Move by a displacement (4, 4) in the frame's own axes, [m].

        Returns
        -------
        ndarray of shape (4, 4)
            The displacement to the frame that it went to, [m].

        Raises
        ------
        InvalidInputError
            If it is no rigid transform.
        """
        before = self.pose
        self.move_to(before @ as_rigid(displacement, "displacement"))
        return inverse_transform(before) @ self.pose

    def move_to(self, T_world_cam: ArrayLike) -> None:
        """Go to the frame nearest to a pose (4, 4), [m].

        Raises
        ------
        InvalidInputError
            If it is no rigid transform.
        """
        away = self._away(as_rigid(T_world_cam, "T_world_cam"))
        self.frame = int(np.argmin(np.where(self._is_frame, away, np.inf)))

    def stop(self) -> None:
        """Do nothing: it stands between moves."""

    def spacing(self) -> Spacing:
        """How far from the reference the frame next to it is: no run can be sure to end nearer.

        Frames that are as near by the metric are within this distance and this angle of it.
        """
        mm = self._from_next_to_reference()
        return Spacing(mm, mm / self._mm_per_deg)

    def is_within_spacing(self) -> bool:
        """Whether no frame but those at the reference is nearer to it than the present one."""
        here = self._away(self._poses[-1])[self.frame]
        return bool(here <= self._from_next_to_reference())

    def from_reference(self) -> Spacing:
        """Distance and angle of the present frame from the reference."""
        distance, angle = pose_error(self._poses[-1], self._poses[self.frame])
        return Spacing(1e3 * float(distance), float(np.degrees(angle)))

    def _from_next_to_reference(self) -> float:
        away = self._away(self._poses[-1])
        return float(away[away > _SAME].min())

    def _away(self, T_world_cam: Array) -> Array:
        distance, angle = pose_error(T_world_cam, self._poses)
        return np.asarray(np.hypot(1e3 * distance, self._mm_per_deg * np.degrees(angle)))
