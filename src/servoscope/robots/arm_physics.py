"""The arm in MuJoCo: servos under gravity, and what touches what."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import RobotFaultError, ServoscopeError
from servoscope.robots.arm_model import TIMESTEP

Array = NDArray[np.float64]

AT_REST = 1e-4
"""Joints that turn slower than this stand still, [rad / s]."""

_LOOK_EVERY = 10
"""Steps between two looks whether the arm stands still."""

_CHECK_EVERY = 0.01
"""Sum of the turns of all joints between two looks for collisions, [rad]."""


class ArmPhysics:
    """A compiled arm and its state.

    Parameters
    ----------
    mjcf : str
        What `arm_mjcf` returns.

    Raises
    ------
    ServoscopeError
        If MuJoCo is not installed.
    """

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
