"""
A camera and a robot of your own
================================

``MyCamera`` and ``MyRobot`` are all that servoscope needs to know of them. ``driver`` stands for
whatever your robot is commanded by: it has ``get_pose()``, a 4 x 4 matrix in metres of the flange
(or of any frame that moves with the camera), ``move_linear(pose)``, which returns when the robot
stands still, and ``stop()``. Jog the robot to its reference view, then, with Python started in
``examples/``::

    import servoscope as sv
    from own_robot import MyCamera, MyRobot, agreed
    from servoscope.positioning.training import train

    robot, camera = MyRobot(driver), MyCamera()
    # the robot moves: within 10 mm and 5 deg of a point 300 mm before the flange, times 1.6
    data = sv.acquire_from(
        robot, camera, "my_part", translation_mm=10, rotation_deg=5, pivot_mm=300,
        confirm=agreed,
    )
    train(data).save("my_model")

    positioner = sv.Positioner.load("my_model")
    print(positioner.run(robot, camera, dry_run=True).message)
    print(positioner.run(robot, camera).message)
"""

# sphinx_gallery_thumbnail_path = "images/view.png"

import cv2
import numpy as np


def agreed(plan):
    """Whether a person agrees to what the robot will do."""
    return input(f"{plan}\nMove the robot? ") == "yes"


class MyCamera:
    """The middle of an OpenCV camera's images, in grey."""

    def __init__(self, device=0, size=256):
        self.video, self.size = cv2.VideoCapture(device), size

    def read(self):
        for _ in range(3):  # older images may wait in the driver
            ok, frame = self.video.read()
        if not ok:
            raise RuntimeError("the camera gave no image")
        grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
        side = min(grey.shape)
        top, left = (np.array(grey.shape) - side) // 2
        square = grey[top : top + side, left : left + side]
        return cv2.resize(square, (self.size, self.size), interpolation=cv2.INTER_AREA)


class MyRobot:
    """A robot that reports its pose and goes to another."""

    def __init__(self, driver):
        self.driver = driver

    @property
    def pose(self):
        return self.driver.get_pose()

    def move_to(self, pose):
        self.driver.move_linear(pose)

    def stop(self):
        self.driver.stop()
