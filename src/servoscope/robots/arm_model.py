"""A UR5e over its table, as text that MuJoCo compiles."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import RobotFaultError, ServoscopeError
from servoscope.robots.arm_kinematics import ALPHA, A, D

Array = NDArray[np.float64]

TIMESTEP = 0.002
"""Of the physics, [s]."""

N_JOINTS = 6

CAMERA_MASS = 0.2
"""Of the camera with its bracket, [kg]."""

_CAMERA_RADIUS = 0.025


class _Servo(NamedTuple):
    """What turns a joint: N m / rad, N m s / rad and N m."""

    stiffness: float
    damping: float
    torque: float


class _Link(NamedTuple):
    """A link in its own Denavit-Hartenberg frame; kg, m and kg m^2.

    Its body is a string of capsules through `points`, somewhat wider than the link itself.
    """

    name: str
    servo: _Servo
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float]
    radius: float
    points: tuple[tuple[float, float, float], ...]


_LARGE, _SMALL = _Servo(8000, 320, 150), _Servo(1500, 60, 28)

LINKS = (
    _Link(
        name="shoulder",
        servo=_LARGE,
        mass=3.761,
        centre=(0, -0.02561, 0.00193),
        inertia=(0.0070, 0.0065, 0.0066),
        radius=0.070,
        points=((0, 0, 0), (0, 0, 0.08)),
    ),
    _Link(
        name="upper arm",
        servo=_LARGE,
        mass=8.058,
        centre=(0.2125, 0, 0.11336),
        inertia=(0.0151, 0.3339, 0.3325),
        radius=0.062,
        points=((0.425, 0, 0.138), (0, 0, 0.138), (0, 0, 0.06)),
    ),
    _Link(
        name="forearm",
        servo=_LARGE,
        mass=2.846,
        centre=(0.15, 0, 0.0265),
        inertia=(0.0040, 0.0788, 0.0785),
        radius=0.050,
        points=((0.3922, 0, 0.007), (0, 0, 0.007), (0, 0, 0.03)),
    ),
    _Link(
        name="wrist 1",
        servo=_SMALL,
        mass=1.37,
        centre=(0, -0.0018, 0.01634),
        inertia=(0.00165, 0.00136, 0.00126),
        radius=0.048,
        points=((0, -0.06, 0), (0, 0, 0), (0, 0, 0.03)),
    ),
    _Link(
        name="wrist 2",
        servo=_SMALL,
        mass=1.3,
        centre=(0, 0.0018, 0.01634),
        inertia=(0.00136, 0.00128, 0.00097),
        radius=0.048,
        points=((0, 0.03, 0), (0, 0, 0), (0, 0, 0.02)),
    ),
    _Link(
        name="wrist 3",
        servo=_SMALL,
        mass=0.365,
        centre=(0, 0, -0.001159),
        inertia=(0.00019, 0.00019, 0.00026),
        radius=0.040,
        points=((0, 0, -0.035), (0, 0, -0.03)),
    ),
)
"""Masses and centres of mass are those that Universal Robots publishes for the UR5e, "DH Parameters
for calculations of kinematics and dynamics"; torques are from its "Max. joint torques". Moments of
inertia are the diagonals in its `Universal_Robots_ROS2_Description`. The stiffness and the damping
of the servos are not published; these make them sag by millimetres under gravity."""


def arm_mjcf(
    T_world_base: ArrayLike,
    T_flange_cam: ArrayLike,
    part_bounds: ArrayLike,
    gravity_compensation: bool = True,
) -> str:
    """The arm, the table and a box around the part, in MuJoCo's format.

    Joints and actuators are numbered from the base on. Links next to each other may touch.
    `part_bounds` are the lowest and highest corner of the part, [m]; the table is at the lowest.
    """
    low, high = np.asarray(part_bounds, dtype=float)
    compensation = f'gravcomp="{float(gravity_compensation):g}"'
    links = (
        f'<body name="camera" {_place(T_flange_cam)} {compensation}>'
        f'<geom type="sphere" size="{_CAMERA_RADIUS}" mass="{CAMERA_MASS}"/></body>'
    )
    for i in reversed(range(N_JOINTS)):
        links = f'<body name="{LINKS[i].name}" {_at(i)} {compensation}>{_link(i)}{links}</body>'
    servos = "".join(
        f'<position joint="{link.name}" kp="{link.servo.stiffness}" kv="{link.servo.damping}" '
        f'forcerange="-{link.servo.torque} {link.servo.torque}"/>'
        for link in LINKS
    )
    size, middle = np.maximum((high - low) / 2, 1e-3), (low + high) / 2
    return f"""<mujoco model="ur5e">
  <compiler angle="radian"/>
  <option timestep="{TIMESTEP}" integrator="implicitfast"/>
  <worldbody>
    <geom name="table" type="plane" size="2 2 1" pos="0 0 {low[2]}"/>
    <geom name="part" type="box" size="{_text(size)}" pos="{_text(middle)}"/>
    <body name="base" {_place(T_world_base)}>
      <geom type="cylinder" size="0.08 0.05" pos="0 0 0.05"/>
      {links}
    </body>
  </worldbody>
  <contact><exclude body1="base" body2="shoulder"/></contact>
  <actuator>{servos}</actuator>
</mujoco>"""


def _at(i: int) -> str:
    """Where link `i` lies in the one before it when its joint is at zero."""
    turn = Rotation.from_rotvec([ALPHA[i], 0.0, 0.0]).as_quat(scalar_first=True)
    return f'pos="{_text([A[i], 0.0, D[i]])}" quat="{_text(turn)}"'


def _link(i: int) -> str:
    """Joint, mass and capsules of link `i`; its joint is where the frame before it is."""
    link, sin, cos = LINKS[i], np.sin(ALPHA[i]), np.cos(ALPHA[i])
    axis, anchor = [0.0, sin, cos], [-A[i], -D[i] * sin, -D[i] * cos]
    capsules = "".join(
        f'<geom type="capsule" size="{link.radius}" fromto="{_text([*a, *b])}"/>'
        for a, b in zip(link.points, link.points[1:], strict=False)
    )
    return (
        f'<joint name="{link.name}" pos="{_text(anchor)}" axis="{_text(axis)}" armature="0.1"/>'
        f'<inertial pos="{_text(link.centre)}" mass="{link.mass}" '
        f'diaginertia="{_text(link.inertia)}"/>{capsules}'
    )


def _place(T: ArrayLike) -> str:
    T = np.asarray(T, dtype=float)
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    return f'pos="{_text(T[:3, 3])}" quat="{_text(quaternion)}"'


def _text(numbers: ArrayLike) -> str:
    return " ".join(repr(float(number)) for number in np.asarray(numbers).ravel())


AT_REST = 1e-4
"""Joints that turn slower than this stand still, [rad / s]."""

_LOOK_EVERY = 10
"""Steps between two looks whether the arm stands still."""

_CHECK_EVERY = 0.01
"""Sum of the turns of all joints between two looks for collisions, [rad]."""


class ArmPhysics:
    """A compiled arm and its state, of what `arm_mjcf` returns."""

    def __init__(self, mjcf: str) -> None:
        self._mujoco = _import_mujoco()
        self._model = self._mujoco.MjModel.from_xml_string(mjcf)
        self._data = self._mujoco.MjData(self._model)
        self._looked_at = self._mujoco.MjData(self._model)

    @property
    def encoders(self) -> Array:
        """Joint angles, shape (6,), [rad]."""
        return np.array(self._data.qpos)

    @property
    def commanded(self) -> Array:
        """Joint angles that the servos were sent last, shape (6,), [rad]."""
        return np.array(self._data.ctrl)

    def put(self, joints: Array) -> None:
        """Put the arm somewhere, at rest and with nothing left of its past."""
        self._mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._data.ctrl[:] = joints

    def follow(self, course: Array) -> None:
        """Tell the servos joint angles of shape (n_steps, 6), one set each `TIMESTEP`."""
        step, model, data = self._mujoco.mj_step, self._model, self._data
        for joints in course:
            data.ctrl[:] = joints
            step(model, data)

    def settle(self, timeout: float) -> None:
        """Wait until the arm stands still.

        Raises
        ------
        RobotFaultError
            If it does not within `timeout`, [s].
        """
        for _ in range(int(timeout / TIMESTEP) // _LOOK_EVERY):
            self._mujoco.mj_step(self._model, self._data, _LOOK_EVERY)
            if np.abs(self._data.qvel).max() < AT_REST:
                return
        fastest = int(np.abs(self._data.qvel).argmax())
        raise RobotFaultError(
            f"The arm does not come to rest within {timeout:g} s: joint {fastest + 1} turns at "
            f"{np.degrees(abs(self._data.qvel[fastest])):.2g} deg/s; wait longer or slow it down."
        )

    def check_path(self, start: Array, goal: Array) -> None:
        """Look for collisions on the straight way between two postures; nothing moves.

        Raises
        ------
        RobotFaultError
            If links would hit each other, the table or the part.
        """
        n_looks = 1 + int(np.abs(goal - start).sum() / _CHECK_EVERY)
        for share in np.linspace(0.0, 1.0, n_looks + 1)[1:]:
            touching = self._touching(start + share * (goal - start))
            if touching:
                raise RobotFaultError(
                    f"The move would bring {touching[0]} into {touching[1]} after {share:.0%} of "
                    "the way, so the arm has not moved; ask for a smaller or another move."
                )

    def _touching(self, joints: Array) -> tuple[str, str] | None:
        """Names of two things that touch each other in a posture, if any do."""
        model, data = self._model, self._looked_at
        data.qpos[:] = joints
        self._mujoco.mj_kinematics(model, data)
        self._mujoco.mj_collision(model, data)
        if not data.ncon:
            return None
        of_body = model.geom_bodyid
        outer, inner = sorted(data.contact[0].geom, key=lambda geom: -of_body[geom])
        return self._name(outer), self._name(inner)

    def _name(self, geom: int) -> str:
        body = self._model.geom_bodyid[geom]
        named = self._model.body(body) if body else self._model.geom(geom)
        return f"the {named.name}"


def _import_mujoco() -> Any:
    try:
        import mujoco
    except ImportError as error:
        raise ServoscopeError(
            'The arm needs MuJoCo; install it with: pip install "servoscope[arm]".'
        ) from error
    return mujoco
