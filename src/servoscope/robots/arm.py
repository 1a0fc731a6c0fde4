"""A simulated UR5e with a camera on its wrist."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import as_rigid, inverse_transform, rigid_transform
from servoscope.robots.arm_kinematics import flange_pose, inverse_kinematics, minimum_jerk
from servoscope.robots.arm_model import N_JOINTS, TIMESTEP, ArmPhysics, arm_mjcf
from servoscope.robots.free_camera import Repeatability
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import geometry_of
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

Array = NDArray[np.float64]

MOUNT = rigid_transform(
    Rotation.from_euler("zx", [30.0, 8.0], degrees=True).as_matrix(), [0.055, -0.045, 0.04]
)
"""``T_flange_cam`` of the bracket: 71 mm aside, 40 mm ahead, turned by 30 deg, tilted by 8 deg."""
MOUNT.setflags(write=False)

T_WORLD_BASE = rigid_transform(
    [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]], [-0.335, -0.06, 0.25]
)
"""The arm is bolted to the side of a column beside the part; its first axis lies level."""
T_WORLD_BASE.setflags(write=False)

READY = np.radians([-164.0, -101.0, -106.0, -157.0, 113.0, 59.0])
"""Joint angles with the camera over the part, [rad]."""
READY.setflags(write=False)

LIMITS = np.radians(
    [
        [-290.0, -180.0, -165.0, -270.0, 15.0, -350.0],
        [-40.0, 0.0, -15.0, -45.0, 165.0, 350.0],
    ]
)
"""Smallest and largest joint angles that are used, [rad]. The joints of a UR5e turn by 360 deg
either way (Universal Robots, UR5e user manual); within these limits its elbow and its wrist stay
bent the way they are over the part."""
LIMITS.setflags(write=False)


class Arm:
    """A UR5e that carries the camera of a simulated cell.

    It has the interface of `FreeCamera`, but what it takes and what it reports is the pose of its
    flange. Its servos hold it against gravity, its joints keep to their limits, and it refuses to
    move where it would hit itself, the table or the part.

    Parameters
    ----------
    scene : Scene
    T_world_cam : array of shape (4, 4)
        Where the camera starts, [m].
    repeatability : Repeatability, optional
        How far from where it was sent the flange comes to rest, beyond what the encoders see.
    rng : Generator, optional
        Draws the errors of motion and the noise of the sensor; without it there are none.
    mount : array of shape (4, 4)
        ``T_flange_cam``, [m].
    backlash : float or array of shape (6,)
        How far each joint turns freely between its encoder and its link, [rad].
    gravity_compensation : bool
        Without it the servos sag by millimetres.
    timeout : float
        How long after a move the arm may take to come to rest, [s].

    Raises
    ------
    ServoscopeError
        If MuJoCo is not installed.
    InvalidInputError
        If an argument is not of its form or range.
    RobotFaultError
        If the arm cannot carry the camera to where it shall start.

    Notes
    -----
    A move starts from the pose that the encoders report. Without gravity compensation that is a
    sagged one, to which every move adds the sag once more: the arm creeps down, and reports so.

    Joints go a straight way in joint space (`minimum_jerk`); their servos are equally quick, so
    that the arm lags behind its path but stays on it. That way is looked along for collisions
    before the first step.

    Examples
    --------
    >>> arm = Arm(Scene(image_size=32))
    >>> executed = arm.move(rigid_transform(np.eye(3), [0.0, 0.0, 0.1]))
    >>> executed[:3, 3].round(3) + 0.0, arm.read().shape
    (array([0. , 0. , 0.1]), (32, 32))
    """

    def __init__(
        self,
        scene: Scene,
        T_world_cam: ArrayLike = T_WORLD_REF,
        repeatability: Repeatability | None = None,
        rng: np.random.Generator | None = None,
        *,
        mount: ArrayLike = MOUNT,
        backlash: ArrayLike = 0.0,
        gravity_compensation: bool = True,
        timeout: float = 2.0,
    ) -> None:
        self.scene = scene
        self.repeatability = Repeatability() if repeatability is None else repeatability
        self.rng = rng
        self.mount = as_rigid(mount, "mount")
        self.backlash = _checked_backlash(backlash)
        self.timeout = _checked_timeout(timeout)
        self._physics = ArmPhysics(
            arm_mjcf(T_WORLD_BASE, self.mount, _bounds(scene.part), gravity_compensation)
        )
        self.place_camera(T_world_cam)

    @property
    def joints(self) -> Array:
        """Joint angles that the encoders read, (6,), [rad]."""
        return self._physics.encoders

    @property
    def pose(self) -> Array:
        """``T_world_flange`` as the robot believes it, from its encoders, (4, 4), [m]."""
        T: Array = T_WORLD_BASE @ flange_pose(self._physics.encoders)
        return T

    @property
    def true_pose(self) -> Array:
        """``T_world_cam`` as it is, (4, 4), [m]: what a simulation knows and a robot does not."""
        T: Array = self._T_world_flange @ self.mount
        return T

    def move(self, displacement: ArrayLike) -> Array:
        """Move by a displacement (4, 4), [m], in the flange's own frame, ``T_new = T_now @
        displacement``. Returns what the encoders report once the arm stands still.
        `RobotFaultError` says that the pose is out of reach or something is in the way, and the arm
        has not moved, or that it does not come to rest.
        """
        before = self.pose
        self.move_to(before @ as_rigid(displacement, "displacement"))
        return inverse_transform(before) @ self.pose

    def move_to(self, T_world_flange: ArrayLike) -> None:
        """Move the flange to a pose (4, 4), [m]; raises what `move` raises."""
        goal = _joints_for(as_rigid(T_world_flange, "T_world_flange"), self.joints)
        start = self._physics.commanded
        self._physics.check_path(start, goal)
        self._physics.follow(minimum_jerk(start, goal, TIMESTEP))
        try:
            self._physics.settle(self.timeout)
        finally:
            self._come_to_rest()

    def read(self) -> NDArray[np.uint8]:
        """The image from where the camera is, (image_size, image_size)."""
        return render(self.scene, self.true_pose, self.rng)

    def place_camera(self, T_world_cam: ArrayLike) -> None:
        """`reset` the arm to where its camera is at a pose (4, 4), [m]."""
        self.reset(as_rigid(T_world_cam, "T_world_cam") @ inverse_transform(self.mount))

    def reset(self, where: ArrayLike = READY) -> None:
        """Put the arm at joint angles (6,), [rad], or ``T_world_flange``, [m], at once and at rest.

        Nothing of what it did before remains.
        """
        where = np.asarray(where, dtype=float)
        if where.shape == (N_JOINTS,):
            joints = _checked_joints(where)
        else:
            joints = _joints_for(as_rigid(where, "T_world_flange"), READY)
        self._physics.check_path(joints, joints)
        self._physics.put(joints)
        self._physics.settle(self.timeout)
        self._links = self._physics.encoders
        self._T_world_flange = self.pose

    def _come_to_rest(self) -> None:
        """Drag the links after the encoders through the backlash, and miss by a little."""
        encoders, play = self._physics.encoders, self.backlash / 2
        self._links = np.clip(self._links, encoders - play, encoders + play)
        self._T_world_flange = T_WORLD_BASE @ flange_pose(self._links)
        if self.rng is not None:
            self._T_world_flange = self.repeatability.disturb(self._T_world_flange, self.rng)


def _joints_for(T_world_flange: Array, start: Array) -> Array:
    return inverse_kinematics(inverse_transform(T_WORLD_BASE) @ T_world_flange, start, LIMITS)


def _bounds(part: CylinderHead | TexturedPlane) -> NDArray[np.float32]:
    """Lowest and highest corner of a part, shape (2, 3), [m]; a plane is a table."""
    if isinstance(part, TexturedPlane):
        return np.zeros((2, 3), np.float32)
    return geometry_of(part).mesh.bounds


def _checked_joints(joints: Array) -> Array:
    if not ((LIMITS[0] <= joints) & (joints <= LIMITS[1])).all():
        raise InvalidInputError(
            f"Joint angles must lie within the limits of the arm, got {joints.tolist()} rad."
        )
    return joints


def _checked_timeout(timeout: float) -> float:
    if not 0 < timeout <= 60:
        raise InvalidInputError(f"timeout must be above 0 and at most 60 s, got {timeout}.")
    return timeout


def _checked_backlash(backlash: ArrayLike) -> Array:
    values = np.asarray(backlash, dtype=float)
    if values.shape not in {(), (N_JOINTS,)} or not ((values >= 0) & (values < 0.1)).all():
        raise InvalidInputError(
            f"backlash must be one angle or {N_JOINTS}, from 0 to 0.1 rad, got {backlash!r}."
        )
    return np.broadcast_to(values, N_JOINTS)
