"""
A robot of your own
===================

A robot has ``pose``, ``move_to(pose)`` and ``stop()``; a camera has ``read()``. That is all that is
needed to take images, train, and come back. Here a simulated cell stands in for the robot's
controller and for the camera.
"""

# %%
# The robot and its camera
# ------------------------
# Replace the three marked lines by those of your driver. ``examples/own_robot.py`` has both classes
# for OpenCV and a generic driver.

from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from small_model import IMAGE_SIZE, head_model

import servoscope as sv
from servoscope.poses import pose_error
from servoscope.scoreboard.cell import robot_at_reference

CELL = robot_at_reference("cylinder_head", "free", IMAGE_SIZE)


class MyRobot:
    """Counts its moves, and keeps the way that it went."""

    def __init__(self):
        self.way = [self.pose]

    @property
    def pose(self):
        return CELL.pose  # your driver: where the flange is, 4 x 4, in metres

    def move_to(self, pose):
        CELL.move_to(pose)  # your driver: returns once the robot stands there
        self.way.append(self.pose)

    def stop(self):
        print("stopped")


class MyCamera:
    def read(self):
        return CELL.read()  # your camera: a grey uint8 image taken after the call


# %%
# Images, with a plan first
# -------------------------
# ``confirm`` is given the plan. Nothing moves unless it returns True.


def agreed(plan):
    print(plan)
    return True


robot, camera = MyRobot(), MyCamera()
reference = robot.pose
with TemporaryDirectory() as folder:
    data = sv.acquire_from(
        robot,
        camera,
        f"{folder}/part",
        confirm=agreed,
        n_images=20,
        translation_mm=10,
        rotation_deg=5,
        pivot_mm=550,
    )
print(len(data), "images")
way = 1e3 * (np.array(robot.way)[:, :3, 3] - reference[:3, 3])

figure, ax = plt.subplots(figsize=(6, 4.5), layout="constrained")
ax.plot(way[:, 0], way[:, 1], "o-", color="0.5", markersize=4, label="the way of the robot")
ax.plot(0, 0, "x", color="black", markersize=12, label="reference")
ax.set_aspect("equal", "datalim")
ax.set_xlabel("x from the reference [mm]")
ax.set_ylabel("y from the reference [mm]")
ax.legend()

# %%
# A dry run, and the way back
# ---------------------------
# ``servoscope.positioning.train(data)`` makes a model of these images. To keep this page quick, the
# one of ``small_model.py`` is taken, which was trained on such images of the same view. The robot
# is put aside by 8, 6 and 4 mm. A dry run looks once and says what it would do.

positioner = sv.Positioner(head_model())
aside = np.eye(4)
aside[:3, 3] = 0.008, -0.006, 0.004
robot.move_to(reference @ aside)
print(positioner.run(robot, camera, dry_run=True).message)
result = positioner.run(robot, camera)
m, rad = pose_error(reference, robot.pose[None])
print(result.message)
print(f"truly {1e3 * m[0]:.3f} mm and {np.degrees(rad[0]):.4f} deg away")
