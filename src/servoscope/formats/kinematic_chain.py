"""Where a link of an arm is, from the positions of its joints and the arm's URDF."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import DataSetError
from servoscope.poses import inverse_transform, rigid_transform
from servoscope.storage.reading import LARGEST_JSON, read_bytes

Array = NDArray[np.float64]

_TURNS, _SLIDES, _FIXED = ("revolute", "continuous"), ("prismatic",), ("fixed",)


@dataclass(frozen=True)
class Joint:
    """A joint between two links.

    Parameters
    ----------
    name, kind, parent, child : str
    origin : ndarray of shape (4, 4)
        The joint in the parent's frame, [m].
    axis : ndarray of shape (3,)
        Unit vector.
    mimic : tuple of (str, float, float), optional
        The joint that it follows, with multiplier and offset.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    axis: Array
    mimic: tuple[str, float, float] | None = None

    @property
    def source(self) -> str | None:
        """The joint whose position moves it; None if it is fixed."""
        if self.kind in _FIXED:
            return None
        return self.mimic[0] if self.mimic else self.name

    def transforms(self, positions: Mapping[str, Array], n: int) -> Array:
        """Child in parent, (n, 4, 4), at positions of (n,) by joint, [rad] or [m]."""
        if self.source is None:
            return np.broadcast_to(self.origin, (n, 4, 4))
        _, multiplier, offset = self.mimic or ("", 1.0, 0.0)
        along = (multiplier * positions[self.source] + offset)[:, None] * self.axis
        if self.kind in _TURNS:
            motion = rigid_transform(Rotation.from_rotvec(along).as_matrix(), np.zeros(3))
        else:
            motion = rigid_transform(np.eye(3), along)
        return self.origin @ motion


@dataclass(frozen=True)
class KinematicChain:
    """The joints from the root of an arm to its base and to the link of the camera.

    Parameters
    ----------
    to_base, to_camera : sequences of Joint
    """

    to_base: Sequence[Joint]
    to_camera: Sequence[Joint]

    @property
    def joint_names(self) -> list[str]:
        """The joints whose positions are needed."""
        joints = [*self.to_base, *self.to_camera]
        return list(dict.fromkeys(j.source for j in joints if j.source is not None))

    def poses(self, positions: Array) -> Array:
        """``T_base_camera`` of shape (n, 4, 4), [m], at positions (n, n_joints), [rad] or [m]."""
        by_name = dict(zip(self.joint_names, positions.T, strict=True))
        T_root_base, T_root_camera = (
            _product([joint.transforms(by_name, len(positions)) for joint in part], len(positions))
            for part in (self.to_base, self.to_camera)
        )
        return inverse_transform(T_root_base) @ T_root_camera


def read_chain(path: Path, base: str | None, camera: str) -> KinematicChain:
    """The chain between two links of the arm that a URDF file describes.

    Parameters
    ----------
    path : Path
    base : str, optional
        The root by default.
    camera : str

    Raises
    ------
    DataSetError
        If the file is no URDF, or has no such links, or joints of another kind between them.
    """
    joints = _read_joints(path)
    by_child = {joint.child: joint for joint in joints}
    links = {link for joint in joints for link in (joint.parent, joint.child)}
    roots = sorted(links - set(by_child))
    if len(roots) != 1 or len(by_child) != len(joints):
        raise DataSetError(f"{path}: the links must form one tree, got the roots {roots}.")
    for link, option in ((base or roots[0], "--base"), (camera, "--camera")):
        if link not in links:
            raise DataSetError(
                f"{path} has no link {link!r}, which {option} names; it has "
                f"{', '.join(sorted(links))}."
            )
    chain = KinematicChain(
        _joints_to(base or roots[0], by_child, path), _joints_to(camera, by_child, path)
    )
    for joint in (*chain.to_base, *chain.to_camera):
        if joint.kind not in (*_TURNS, *_SLIDES, *_FIXED):
            raise DataSetError(
                f"{path}: the joint {joint.name} is {joint.kind}; joints between base and camera "
                "must be revolute, continuous, prismatic or fixed."
            )
    return chain


def _joints_to(link: str, by_child: Mapping[str, Joint], path: Path) -> list[Joint]:
    found: list[Joint] = []
    while link in by_child:
        if len(found) > len(by_child):
            raise DataSetError(f"{path}: the links form a circle at {link}.")
        found.append(by_child[link])
        link = by_child[link].parent
    return found[::-1]


def _read_joints(path: Path) -> list[Joint]:
    content = read_bytes(path, DataSetError, LARGEST_JSON)
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise DataSetError(f"{path} declares entities, which a URDF has no need of; remove them.")
    try:
        root = ElementTree.fromstring(content)  # noqa: S314  no entities are left to expand
        joints = [_joint(element) for element in root.findall("joint")]
    except (ElementTree.ParseError, AttributeError, KeyError, ValueError) as error:
        raise DataSetError(
            f"{path} is no URDF ({type(error).__name__}: {error}); expand xacro files first."
        ) from error
    if not joints:
        raise DataSetError(f"{path} holds no joint; name the URDF of the arm.")
    return joints


def _joint(element: ElementTree.Element) -> Joint:
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise ValueError(f"the joint {element.get('name')!r} lacks a parent or a child")
    origin, axis, mimic = (element.find(tag) for tag in ("origin", "axis", "mimic"))
    empty = ElementTree.Element("none")
    origin = empty if origin is None else origin
    rotation = Rotation.from_euler("xyz", _three(origin.get("rpy", "0 0 0")))
    direction = _three("1 0 0" if axis is None else axis.get("xyz", "1 0 0"))
    length = float(np.linalg.norm(direction))
    if length < 1e-9:
        raise ValueError(f"the joint {element.get('name')!r} has an axis of zero length")
    follows = None
    if mimic is not None:
        numbers = float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))
        follows = (mimic.attrib["joint"], *numbers)
    return Joint(
        element.attrib["name"],
        element.attrib["type"],
        parent.attrib["link"],
        child.attrib["link"],
        rigid_transform(rotation.as_matrix(), _three(origin.get("xyz", "0 0 0"))),
        direction / length,
        follows,
    )


def _three(text: str) -> Array:
    numbers = [float(part) for part in text.split()]
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{text!r} must be three finite numbers")
    return np.array(numbers)


def _product(transforms: Sequence[Array], n: int) -> Array:
    T = np.broadcast_to(np.eye(4), (n, 4, 4))
    for part in transforms:
        T = T @ part
    return T
