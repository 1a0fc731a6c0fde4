"""A rosbag 1, a rosbag 2 or MCAP files: images and poses in messages."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Generator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.data.trajectory import Trajectory
from servoscope.errors import DataSetError
from servoscope.formats.bag_files import FRAMES, Bag, open_bag
from servoscope.formats.bag_poses import (
    JOINTS,
    POSES,
    FrameChain,
    Joints,
    PoseSource,
    StampedPoses,
    stamp_of,
)
from servoscope.formats.conventions import METRES
from servoscope.formats.frames import EQUAL_STAMPS, Drops, Frames
from servoscope.formats.images import Decoded, resized
from servoscope.formats.kinematic_chain import read_chain
from servoscope.formats.pose_text import as_T_world_cam
from servoscope.formats.recordings import RecordingOptions, assemble_recording
from servoscope.formats.ros_images import COMPRESSED, RAW, grey_of_message
from servoscope.formats.stamps import without_equal_stamps

_LONGEST_SKIP = 200  # images that are read over rather than sought


@dataclass(frozen=True, kw_only=True)
class BagOptions(RecordingOptions):
    """Options of bags, besides those of every recording.

    Parameters
    ----------
    image_topic : str, optional
        Topic of the images; the only one by default.
    pose_topic : str, optional
        Topic of the poses, of the joints, or of frames; the only one by default.
    base, camera : str, optional
        Frames, or links with a URDF, whose pose in each other is taken: by default the root, and
        the frame that the images name.
    urdf : str, optional
        File that describes the arm whose joints are in the bag.
    stamps : {"header", "log"}
        Times of messages: their stamps, or when they were logged.
    max_gap_s : float
        Largest gap between an image and the pose nearest in time [s].

    Examples
    --------
    >>> BagOptions(image_topic="/camera/image_raw", base="base_link").max_gap_s
    0.1
    """

    image_topic: str | None = None
    pose_topic: str | None = None
    base: str | None = None
    camera: str | None = None
    urdf: str | None = None
    stamps: Literal["header", "log"] = "header"
    max_gap_s: float = 0.1


def read_bag(
    src: str | PathLike[str],
    options: BagOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a rosbag 1 file, a rosbag 2 folder, or MCAP or SQLite files.

    Messages are read one after the other, and images decoded where they are kept, so that the bag
    may be far larger than the memory. Images are ``sensor_msgs/Image`` and ``CompressedImage``;
    poses are ``PoseStamped``, ``PoseWithCovarianceStamped``, ``TransformStamped``, ``Odometry``, a
    chain of frames in ``TFMessage``, or ``JointState`` with the URDF of the arm.

    Parameters
    ----------
    src : path-like
        A file, or a folder of files of one recording.
    options : BagOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order in which images were logged.

    Raises
    ------
    DataSetError
        If a file is damaged, topics or frames are not there or must be chosen, or no image has a
        pose near in time.

    Warns
    -----
    ServoscopeWarning
        If anything was left out, with counts and reasons, or the clocks differ.

    Examples
    --------
    >>> options = BagOptions(base="base_link", camera="camera_optical_frame", image_width=320)
    >>> data = read_bag("recording", options)  # doctest: +SKIP
    """
    options = BagOptions() if options is None else options
    drops = Drops()
    with open_bag(Path(src)) as bag:
        topic = _chosen(bag, (RAW, COMPRESSED), options.image_topic, "--image-topic", "images")
        source = _pose_source(bag, topic, options)
        images = _Images(bag, topic)
        for message in bag.messages({topic, *source.topics}):
            if message.topic == topic:
                images.add(message.file, message.logged, stamp_of(message, options.stamps))
            else:
                source.add(message, stamp_of(message, options.stamps))
        trajectory = _trajectory(source, options, drops, str(src))
        frames = images.frames(Path(src))
        facts = {"image_topic": topic, "pose_topics": list(source.topics)}
        called = (f"images of {topic}", ", ".join(source.topics))
        return assemble_recording(
            frames, trajectory, options, drops, "bag", on_progress, called=called, facts=facts
        )


class _Images:
    """When the images of a topic were taken and logged; decodes those that are asked for."""

    def __init__(self, bag: Bag, topic: str) -> None:
        self._bag, self._topic = bag, topic
        self._logged, self._files, self._times = array("q"), array("q"), array("d")

    def add(self, file: int, logged: int, time: float) -> None:
        self._files.append(file)
        self._logged.append(logged)
        self._times.append(time)

    def frames(self, src: Path) -> Frames:
        n = len(self._times)
        if not n:
            raise DataSetError(f"{src} holds no image of {self._topic}.")
        names = [f"{number:06d}" for number in range(n)]
        times = np.frombuffer(self._times).copy()
        return Frames(src, names, np.arange(n), np.empty((n, 4, 4)), times, self.read)

    def read(self, frames: Frames, width: int | None) -> Generator[Decoded, None, None]:
        """The images of frames in the order of their numbers."""
        logged, files = np.frombuffer(self._logged, np.int64), np.frombuffer(self._files, np.int64)
        numbers = frames.numbers
        breaks = (np.diff(numbers) > _LONGEST_SKIP) | (np.diff(files[numbers]) != 0)
        for run in np.split(numbers, np.flatnonzero(breaks) + 1):
            file, first, last = int(files[run[0]]), int(logged[run[0]]), int(logged[run[-1]])
            own = np.flatnonzero(files == file)
            number = int(own[np.searchsorted(logged[own], first)])
            wanted = set(run.tolist())
            for message in self._bag.messages([self._topic], file, first, last + 1):
                if number in wanted:
                    yield self._decoded(
                        message.fields, f"{frames.folder}, image {number:06d}", width
                    )
                number += 1

    def _decoded(self, fields: object, where: str, width: int | None) -> Decoded:
        try:
            levels = grey_of_message(fields, self._bag.types[self._topic], where)
            return resized(levels, width, where)
        except DataSetError as error:
            return error


def _chosen(bag: Bag, types: tuple[str, ...], asked: str | None, option: str, what: str) -> str:
    """The topic of some types that is asked for, or the only one."""
    found = bag.of_types(types)
    if asked is not None:
        for topic in (asked, f"/{asked}"):
            if topic in found:
                return topic
        raise DataSetError(
            f"{bag.path} has no {what} in {asked!r}, which {option} names; its topics are "
            f"{bag.listing()}."
        )
    if len(found) == 1:
        return found[0]
    if not found:
        raise DataSetError(f"{bag.path} holds no {what}; its topics are {bag.listing()}.")
    raise DataSetError(f"{bag.path} has {what} in {', '.join(found)}; choose one with {option}.")


def _pose_source(bag: Bag, image_topic: str, options: BagOptions) -> PoseSource:
    asked = options.pose_topic
    if options.urdf is not None:
        topic = _chosen(bag, (JOINTS,), asked, "--pose-topic", "joints")
        camera = options.camera or _frame_of_images(bag, image_topic)
        chain = read_chain(Path(options.urdf), options.base, camera)
        return Joints(topic, chain, Path(options.urdf))
    singles, has_frames = bag.of_types(POSES), bool(bag.of_types(FRAMES))
    wants_frames = asked is None and (options.base is not None or options.camera is not None)
    if asked is not None:
        topic = _chosen(bag, (*POSES, *FRAMES, JOINTS), asked, "--pose-topic", "poses")
        if bag.types[topic] == JOINTS:
            raise DataSetError(f"{topic} holds joints; give the arm's --urdf as well.")
        if bag.types[topic] not in FRAMES:
            return StampedPoses(bag, topic)
        wants_frames = True
    if wants_frames or (has_frames and not singles):
        if not has_frames:
            raise DataSetError(f"{bag.path} holds no frames; its topics are {bag.listing()}.")
        return FrameChain(
            bag,
            options.base,
            options.camera,
            _frame_of_images(bag, image_topic),
            options.max_gap_s,
        )
    if len(singles) == 1 and not has_frames:
        return StampedPoses(bag, singles[0])
    choice = "choose poses with --pose-topic, or frames with --base and --camera"
    if not singles:
        choice = "joints (sensor_msgs/JointState) need --urdf"
    raise DataSetError(
        f"{bag.path}: which poses are meant is not known; {choice}. Its topics are {bag.listing()}."
    )


def _frame_of_images(bag: Bag, topic: str) -> str:
    message = next(iter(bag.messages([topic])))
    return str(message.fields.header.frame_id)


def _trajectory(source: PoseSource, options: BagOptions, drops: Drops, where: str) -> Trajectory:
    found = source.trajectory(options.skip_bad, drops)
    T = found.T_world_cam.copy()
    T[:, :3, 3] *= METRES[options.length_unit]
    T = as_T_world_cam(T, direction=options.direction, axes=options.axes)
    trajectory, conflicts = without_equal_stamps(
        Trajectory(found.times, T), f"{where}, {source.topics[0]}", skip_bad=options.skip_bad
    )
    drops.add(EQUAL_STAMPS, [f"{time:.6f}" for time in conflicts])
    return trajectory
