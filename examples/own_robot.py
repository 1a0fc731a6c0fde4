"""Positioning with a camera and a robot of your own.

`MyCamera` and `MyRobot` are all that servoscope needs to know of them. `driver` stands for whatever
your robot is commanded by: it has `get_pose()`, a 4 x 4 matrix in metres of the flange (or of any
frame that moves with the camera), `move_linear(pose)`, which returns when the robot stands still,
and `stop()`. Jog the robot to its reference view, then, with Python started in `examples/`:

    import servoscope as sv
    from own_robot import MyCamera, MyRobot, take_images
    from servoscope.positioning.training import train

    robot, camera = MyRobot(driver), MyCamera()
    take_images(robot, camera).save("my_part")  # the robot moves: mind what is around it
    train(sv.PoseImageSet.load("my_part")).save("my_model")

    positioner = sv.Positioner.load("my_model")
    print(positioner.run(robot, camera, dry_run=True).message)
    print(positioner.run(robot, camera).message)
"""

import cv2
import numpy as np

import servoscope as sv
from servoscope.poses import inverse_transform, poses_from_displacements


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
    """A robot that reports its pose and moves to another."""

    def __init__(self, driver):
        self.driver = driver

    @property
    def pose(self):
        return self.driver.get_pose()

    def move(self, displacement):
        before = self.pose
        self.driver.move_linear(before @ displacement)
        return inverse_transform(before) @ self.pose

    def stop(self):
        self.driver.stop()


def take_images(
    robot, camera, schedule=((40, 1.0),), mm=(25, 25, 25), deg=(15, 15, 15), pivot=0.55, seed=0
):
    """Images at random displacements around where the robot stands, and back again.

    The frame swings about a point `pivot` metres ahead: with 25 mm and 15 degrees it is carried up
    to 25 + 550 sin(15 deg) = 167 mm to each side, and it jumps from one pose to any other.
    """
    rng = np.random.default_rng(seed)
    ranges = np.array([*np.multiply(mm, 1e-3), *np.radians(deg)])
    rings = [factor * ranges * rng.uniform(-1, 1, (n, 6)) for n, factor in schedule]
    T_ref = robot.pose
    reference = np.mean([camera.read() for _ in range(16)], axis=0).round().astype(np.uint8)
    images, poses = [], []
    for T in poses_from_displacements(T_ref, np.vstack(rings), pivot):
        robot.move(inverse_transform(robot.pose) @ T)
        images.append(camera.read())
        poses.append(robot.pose)
    robot.move(inverse_transform(robot.pose) @ T_ref)
    widest = max(factor for _, factor in schedule)
    return sv.PoseImageSet(
        np.array(images),
        np.array(poses),
        T_ref,
        reference,
        pivot=pivot,
        pivot_ranges=widest * ranges,
    )
