"""An arm of Universal Robots, moved through its real-time data exchange (RTDE)."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from threading import Event, Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import RobotFaultError, RobotStoppedError, ServoscopeError
from servoscope.poses import as_rigid, pose_error, rigid_transform
from servoscope.robots.options import check_range, split_options
from servoscope.wording import one_line

Array = NDArray[np.float64]

OPTIONS: dict[str, Callable[[str], Any]] = {
    "speed": float,
    "acceleration": float,
    "force": float,
    "timeout": float,
}
"""Of ``ur:HOST?name=value``."""

PORT = 30004
"""Where a controller exchanges data, by TCP."""

ARRIVED = 5e-4, float(np.radians(0.1))
"""Farther from where it was sent than this an arm has not arrived, [m] and [rad]."""

STANDING = 1e-3
"""Slower than this a tool stands, [m/s] and [rad/s]."""

_POLL = 0.01
_STANDING_POLLS = 10
_LONGEST_REST = 3.0
_STOP_TIME = 2.0
_DECELERATION = 1.0
_RUNNING = 7
_SAFETY = {
    3: "is in protective stop; see what it met, and release it on its pendant",
    4: "is in recovery mode; move it back within its limits on its pendant",
    5: "is stopped by a safeguard; close the fence and reset it",
    6: "is in emergency stop; release it on its pendant",
    7: "is in emergency stop; release it on its pendant",
    8: "has violated a safety limit; restart its safety system on its pendant",
    9: "has a fault; see its pendant",
}


def ur_arm(text: str) -> URArm:
    """The arm that is written ``ur:HOST?name=value``, without the kind."""
    host, options = split_options(text, OPTIONS)
    return URArm(host, **options)


class URArm:
    """An arm of Universal Robots.

    Its pose is that of the active tool centre point in the base, as the controller reports it.
    It moves in straight lines (``moveL``), slowly, and is stopped where it meets something.

    Parameters
    ----------
    host : str
        Address of the controller, which must be in remote control.
    speed, acceleration : float
        Of the tool, [m/s] and [m/s^2].
    force : float
        A change of the force at the tool by more than this during a move stops the arm, [N]; 0
        leaves that to the controller's own limits.
    timeout : float
        How long a move may take, [s].

    Raises
    ------
    ServoscopeError
        If ``ur-rtde`` is not installed.
    InvalidInputError
        If a number is not of its range.
    RobotFaultError
        If the controller cannot be reached.
    """

    def __init__(
        self,
        host: str,
        *,
        speed: float = 0.05,
        acceleration: float = 0.2,
        force: float = 50.0,
        timeout: float = 60.0,
    ) -> None:
        check_range("speed", speed, 1e-3, 1.0, "m/s")
        check_range("acceleration", acceleration, 1e-2, 5.0, "m/s^2")
        check_range("force", force, 0, 500, "N")
        check_range("timeout", timeout, 0.1, 600, "s")
        self.host, self.speed, self.acceleration = host, speed, acceleration
        self.force, self.timeout = force, timeout
        self._is_stopped, self._stopping = Event(), Lock()
        control, receive = _interfaces()
        _check_reachable(host)
        try:
            self._receive = receive.RTDEReceiveInterface(host)
            self._control = control.RTDEControlInterface(host)
        except Exception as error:
            raise RobotFaultError(
                f"The arm at {host} does not answer ({one_line(error)}); see that it is on and in "
                "remote control."
            ) from error

    @property
    def pose(self) -> Array:
        """``T_base_tool``, (4, 4), [m].

        Raises
        ------
        RobotStoppedError
            If the connection is lost.
        """
        self._check_connected()
        x = np.asarray(self._receive.getActualTCPPose(), dtype=float)
        return rigid_transform(Rotation.from_rotvec(x[3:]).as_matrix(), x[:3])

    def move_to(self, pose: ArrayLike) -> None:
        """Move the tool to a pose (4, 4), [m], in a straight line; returns once it stands there.

        Raises
        ------
        InvalidInputError
            If it is no rigid transform; the arm has not moved.
        RobotFaultError
            If the pose is out of reach; the arm has not moved.
        RobotStoppedError
            If the arm is not ready, does not get there, or meets something; it is stopped then.
        """
        target = as_rigid(pose, "pose")
        self._check_ready()
        vector = [*target[:3, 3], *Rotation.from_matrix(target[:3, :3]).as_rotvec()]
        vector = [float(value) for value in vector]
        if not self._control.isPoseWithinSafetyLimits(vector):
            raise RobotFaultError(
                f"The arm at {self.host} cannot reach the pose, or it is outside its safety limits."
            )
        self._is_stopped.clear()
        unloaded = self._tool_force()
        try:
            if not self._control.moveL(vector, self.speed, self.acceleration, True):
                raise self._fault("refused the move; see its pendant")
            self._follow(target, unloaded)
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """Bring the arm to a standstill.

        Raises
        ------
        RobotStoppedError
            If it still moves after 2 s.
        """
        self._is_stopped.set()
        with self._stopping:
            if self._control.isProgramRunning():
                self._control.stopL(_DECELERATION)
        end = time.monotonic() + _STOP_TIME
        while not self._stands():
            if time.monotonic() > end:
                self._control.stopScript()
                raise self._fault("still moves though it was stopped; press its emergency stop")
            time.sleep(_POLL)

    def close(self) -> None:
        """End the program on the controller, and the connection."""
        self._control.stopScript()
        self._control.disconnect()
        self._receive.disconnect()

    def _follow(self, target: Array, unloaded: Array) -> None:
        """Wait until the tool stands at the target; raise what keeps it from getting there."""
        end = time.monotonic() + self.timeout
        n_standing = 0
        while True:
            if self._is_stopped.is_set():
                raise self._fault("was stopped during the move")
            self._check_state()
            if self.force and (met := np.linalg.norm(self._tool_force() - unloaded)) > self.force:
                raise self._fault(f"met something: the force at its tool changed by {met:.0f} N")
            n_standing = n_standing + 1 if self._stands() else 0
            distance, angle = pose_error(target, self.pose)
            is_there = distance < ARRIVED[0] and angle < ARRIVED[1]
            if is_there and n_standing >= _STANDING_POLLS:
                return
            if n_standing * _POLL > _LONGEST_REST:
                raise self._fault(f"stands {1e3 * distance:.1f} mm from where it was sent")
            if time.monotonic() > end:
                raise self._fault(f"did not get there in {self.timeout:g} s; raise its speed")
            time.sleep(_POLL)

    def _check_ready(self) -> None:
        """See that the arm can move; its program is started again if a stop has ended it."""
        self._check_state()
        if (mode := self._receive.getRobotMode()) != _RUNNING:
            raise self._fault(f"is not running (mode {mode}); release its brakes on its pendant")
        if not (self._control.isConnected() or self._control.reconnect()):
            raise self._fault("has lost its connection")
        if not (self._control.isProgramRunning() or self._control.reuploadScript()):
            raise self._fault("does not start its program; see that it is in remote control")

    def _check_state(self) -> None:
        self._check_connected()
        mode = self._receive.getSafetyMode()
        if self._receive.isEmergencyStopped():
            mode = 6
        elif self._receive.isProtectiveStopped():
            mode = 3
        if mode in _SAFETY:
            raise self._fault(_SAFETY[mode])

    def _check_connected(self) -> None:
        if not self._receive.isConnected():
            raise self._fault("has lost its connection; see its cable, and start again")

    def _stands(self) -> bool:
        speed = np.abs(np.asarray(self._receive.getActualTCPSpeed(), dtype=float))
        return bool((speed < STANDING).all())

    def _tool_force(self) -> Array:
        return np.asarray(self._receive.getActualTCPForce(), dtype=float)[:3]

    def _fault(self, reason: str) -> RobotStoppedError:
        return RobotStoppedError(f"The arm at {self.host} {reason}.")


def _check_reachable(host: str) -> None:
    try:
        socket.create_connection((host, PORT), timeout=3.0).close()
    except OSError as error:
        raise RobotFaultError(
            f"The arm at {host!r} cannot be reached ({one_line(error)}); see that it is on, and "
            "that the address is right."
        ) from error


def _interfaces() -> tuple[Any, Any]:
    try:
        import rtde_control
        import rtde_receive
    except ImportError as error:
        raise ServoscopeError(
            'An arm of Universal Robots needs ur-rtde; install it with: pip install "servoscope'
            '[ur]", on Python 3.11 or 3.12 of Linux (x86-64) or Windows, for which it is made.'
        ) from error
    return rtde_control, rtde_receive
