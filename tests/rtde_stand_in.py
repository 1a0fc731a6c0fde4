"""Stand-ins of ``rtde_control`` and ``rtde_receive`` that behave as their documentation says."""

import time
from types import SimpleNamespace

import numpy as np

START = [0.3, -0.2, 0.4, 0.1, 2.9, -0.3]


class Controller:
    """One controller: a tool that goes straight at the speed it was sent with."""

    def __init__(self):
        self.pose, self.target = np.array(START), np.array(START)
        self.speed, self.begun, self.duration = 0.0, 0.0, 0.0
        self.protective_at = None  # [s] after the begin of a move
        self.contact_at = None
        self.stuck_at = None
        self.emergency, self.is_program_running, self.is_connected = False, True, True
        self.safety_mode, self.robot_mode = 1, 7
        self.reachable, self.accepts, self.reuploads = True, True, True
        self.stops, self.scripts_stopped = [], 0

    def where(self):
        elapsed = time.monotonic() - self.begun
        for limit in (self.protective_at, self.stuck_at):
            elapsed = elapsed if limit is None else min(elapsed, limit)
        share = 1.0 if self.duration == 0 else min(1.0, elapsed / self.duration)
        return self.pose + share * (self.target - self.pose)

    def is_moving(self):
        elapsed = time.monotonic() - self.begun
        limits = [x for x in (self.protective_at, self.stuck_at) if x is not None]
        return elapsed < min([self.duration, *limits])

    def is_protective(self):
        return self.protective_at is not None and (
            time.monotonic() - self.begun >= self.protective_at
        )

    def halt(self):
        self.pose = self.target = self.where()
        self.duration = 0.0


class RTDEReceiveInterface:
    controller: Controller

    def __init__(self, hostname):
        self.hostname = hostname

    def getActualTCPPose(self):
        return self.controller.where().tolist()

    def getActualTCPSpeed(self):
        return [0.05 if self.controller.is_moving() else 0.0] + 5 * [0.0]

    def getActualTCPForce(self):
        met = self.controller.contact_at is not None and (
            time.monotonic() - self.controller.begun >= self.controller.contact_at
        )
        return [0.0, 0.0, -12.0 - 80.0 * met, 0.0, 0.0, 0.0]

    def getSafetyMode(self):
        return self.controller.safety_mode

    def getRobotMode(self):
        return self.controller.robot_mode

    def isProtectiveStopped(self):
        return self.controller.is_protective()

    def isEmergencyStopped(self):
        return self.controller.emergency

    def isConnected(self):
        return self.controller.is_connected

    def disconnect(self):
        self.controller.is_connected = False


class RTDEControlInterface:
    controller: Controller

    def __init__(self, hostname):
        self.hostname = hostname

    def moveL(self, pose, speed=0.25, acceleration=1.2, asynchronous=False):
        assert asynchronous, "a move that blocks cannot be stopped"
        assert len(pose) == 6
        if not (self.controller.accepts and self.controller.is_program_running):
            return False
        self.controller.pose, self.controller.target = self.controller.where(), np.array(pose)
        self.controller.begun = time.monotonic()
        way = np.linalg.norm(self.controller.target[:3] - self.controller.pose[:3])
        self.controller.duration = max(0.05, way / speed)
        return True

    def stopL(self, a=10.0, asynchronous=False):
        self.controller.stops.append(a)
        self.controller.halt()

    def stopScript(self):
        self.controller.scripts_stopped += 1
        self.controller.is_program_running = False
        self.controller.halt()

    def isPoseWithinSafetyLimits(self, pose):
        assert len(pose) == 6
        return self.controller.reachable

    def isProgramRunning(self):
        return self.controller.is_program_running and not self.controller.is_protective()

    def reuploadScript(self):
        self.controller.is_program_running = self.controller.reuploads
        return self.controller.reuploads

    def isConnected(self):
        return self.controller.is_connected

    def reconnect(self):
        return False

    def disconnect(self):
        self.controller.is_connected = False


def modules(controller):
    """The two modules, whose interfaces reach a controller."""
    made = []
    for kind in (RTDEControlInterface, RTDEReceiveInterface):
        reaching = type(kind.__name__, (kind,), {"controller": controller})
        made.append(SimpleNamespace(**{kind.__name__: reaching}))
    return made
