"""Robots and cameras of one's own, opened by what is written on the command line.

A further kind needs one file and one line in `ROBOT_KINDS` or `CAMERA_KINDS`, or an entry point
``servoscope.robot_kinds`` or ``servoscope.camera_kinds``: what makes a device of the text after
``kind:``.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, cast

from servoscope.errors import (
    InvalidInputError,
    PluginError,
    ServoscopeError,
    ServoscopeWarning,
)
from servoscope.plugins import Registry
from servoscope.wording import one_line

Opener = Callable[[str], Any]
"""Makes a device of the text after ``kind:``."""


class Kind(NamedTuple):
    """A kind of device.

    Parameters
    ----------
    form : str
        How one is written, such as ``recorded:FOLDER``.
    open : callable
        Makes one of the text after ``kind:``.
    """

    form: str
    open: Opener


def _from(module: str, opener: str) -> Opener:
    """A function of a module of this room, imported when it is called."""

    def opened(rest: str) -> Any:
        return getattr(importlib.import_module(f"servoscope.robots.{module}"), opener)(rest)

    return opened


def _recorded(rest: str) -> Any:
    from servoscope.data.images import PoseImageSet
    from servoscope.robots.recorded import RecordedRobot

    return RecordedRobot(PoseImageSet.load(rest))


def _checked(name: str, opener: Any) -> Kind:
    if not callable(opener):
        raise InvalidInputError(f"the kind {name!r} must be callable, got {repr(opener)[:80]}")
    return Kind(f"{name}:...", cast(Opener, opener))


_RECORDED = Kind("recorded:FOLDER", _recorded)

ROBOT_KINDS = Registry(
    "servoscope.robot_kinds",
    {
        "ur": Kind("ur:HOST", _from("ur_arm", "ur_arm")),
        "ros": Kind("ros:HOST:PORT?pose=TOPIC&goal=TOPIC", _from("ros_bridge", "ros_robot")),
        "recorded": _RECORDED,
    },
    _checked,
)
"""Robots that `open_robot` opens."""

CAMERA_KINDS = Registry(
    "servoscope.camera_kinds",
    {
        "opencv": Kind("opencv:N", _from("opencv_camera", "opencv_camera")),
        "folder": Kind("folder:PATH", _from("folder_camera", "folder_camera")),
        "gentl": Kind("gentl:FILE.cti", _from("gentl_camera", "gentl_camera")),
        "ros": Kind("ros:HOST:PORT?image=TOPIC", _from("ros_bridge", "ros_camera")),
        "recorded": _RECORDED,
    },
    _checked,
)
"""Cameras that `open_camera` opens."""


def open_robot(spec: str) -> Any:
    """A robot as it is written on the command line.

    Parameters
    ----------
    spec : str
        ``kind:rest`` with one of `ROBOT_KINDS`, or ``module:Class`` of a class or a function that
        is called without arguments. The module may lie in the current folder.

    Returns
    -------
    Robot
        What has a pose and can be moved, see `servoscope.positioning.interfaces.Robot`. It may be
        the camera too.

    Raises
    ------
    InvalidInputError
        If nothing is called so, or what is made is no robot.
    PluginError
        If the module or the class fails.
    RobotFaultError
        If the robot cannot be reached.

    Examples
    --------
    >>> open_robot("legs")
    Traceback (most recent call last):
    ...
    servoscope.errors.InvalidInputError: The robot must be ur:HOST, ros:HOST:PORT?pose=TOPIC&goal=TOPIC, recorded:FOLDER or module:Class of your own, got 'legs'.
    """  # noqa: E501
    robot = _opened("robot", ROBOT_KINDS, spec)
    if not _has(robot, "pose") or not (_has(robot, "move_to") or _has(robot, "move")):
        raise InvalidInputError(
            f"The robot {spec!r} must have a property `pose` and a method `move_to(pose)`, but a "
            f"{type(robot).__name__} has not; see docs/robots.md."
        )
    return robot


def open_camera(spec: str) -> Any:
    """A camera as it is written on the command line.

    Parameters
    ----------
    spec : str
        ``kind:rest`` with one of `CAMERA_KINDS`, or ``module:Class`` as of `open_robot`.

    Returns
    -------
    Camera
        What can be read, see `servoscope.positioning.interfaces.Camera`.

    Raises
    ------
    InvalidInputError
        If nothing is called so, or what is made is no camera.
    PluginError
        If the module or the class fails.
    CameraFaultError
        If the camera cannot be reached.
    """
    return _checked_camera(_opened("camera", CAMERA_KINDS, spec), spec)


def open_both(robot: str, camera: str | None) -> tuple[Any, Any]:
    """A robot, and its camera: the robot itself if no other is given, or the same.

    Raises
    ------
    ServoscopeError
        As `open_robot` and `open_camera` do.
    """
    opened = open_robot(robot)
    try:
        if camera is not None and camera != robot:
            return opened, open_camera(camera)
        if camera is None and not _has(opened, "read"):
            raise InvalidInputError(
                f"The robot {robot!r} gives no images; say which camera it carries, such as "
                "--camera opencv:0."
            )
        return opened, _checked_camera(opened, robot)
    except BaseException:
        with closing(opened):
            raise


def forms(kinds: Registry[Kind]) -> str:
    """How devices of these kinds are written, for messages."""
    return f"{', '.join(kinds[name].form for name in kinds)} or module:Class of your own"


@contextmanager
def closing(*devices: Any) -> Iterator[None]:
    """Close devices at the end, each once, if they offer ``close()``.

    Warns
    -----
    ServoscopeWarning
        If one fails to.
    """
    try:
        yield
    finally:
        for device in {id(device): device for device in devices}.values():
            try:
                getattr(device, "close", lambda: None)()
            except Exception as error:
                reason = f"A {type(device).__name__} could not be closed: {_said(error)}."
                warnings.warn(reason, ServoscopeWarning, stacklevel=3)


def _opened(what: str, kinds: Registry[Kind], spec: str) -> Any:
    kind, _, rest = spec.partition(":")
    if rest and kind in kinds:
        return kinds[kind].open(rest)
    wanted = f"The {what} must be {forms(kinds)}, got {spec!r}"
    if not (kind and rest) or kind in kinds:
        raise InvalidInputError(f"{wanted}.")
    return _made(what, _of_module(kind, rest, wanted), spec)


def _of_module(module: str, name: str, wanted: str) -> Any:
    """What a module calls by a name; the module may lie in the current folder."""
    if not all(word.isidentifier() for word in f"{module}.{name}".split(".")):
        raise InvalidInputError(f"{wanted}.")
    here, place = str(Path.cwd()), Path.cwd().joinpath(*module.split("."))
    if here not in sys.path and (place.is_dir() or place.with_suffix(".py").is_file()):
        sys.path.insert(0, here)
        importlib.invalidate_caches()
    try:
        loaded = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        missing = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if missing and f"{module}.".startswith(f"{missing}."):
            raise InvalidInputError(
                f"{wanted}, but there is no module {module!r}, here or installed."
            ) from None
        raise PluginError(
            f"The module {module!r} cannot be imported ({_said(error)}); mend it, or install what "
            "it needs."
        ) from error
    try:
        return attrgetter(name)(loaded)
    except AttributeError:
        raise InvalidInputError(f"{wanted}, but the module {module!r} has no {name!r}.") from None


def _made(what: str, maker: Any, spec: str) -> Any:
    if not callable(maker):
        raise InvalidInputError(
            f"The {what} {spec!r} must be a class, or a function that makes one, got one of type "
            f"{type(maker).__name__}."
        )
    try:
        return maker()
    except ServoscopeError:
        raise
    except (Exception, SystemExit) as error:
        raise PluginError(
            f"The {what} {spec!r} cannot be opened ({_said(error)}); see that it is connected. It "
            "is called without arguments."
        ) from error


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {one_line(error)}"


def _checked_camera(camera: Any, spec: str) -> Any:
    if not _has(camera, "read"):
        raise InvalidInputError(
            f"The camera {spec!r} must have a method `read()`, but a {type(camera).__name__} has "
            "none; see docs/robots.md."
        )
    return camera


def _has(device: Any, name: str) -> bool:
    """Whether a device has an attribute; a property of its class is not called for that."""
    return hasattr(type(device), name) or hasattr(device, name)
