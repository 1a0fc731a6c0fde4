"""How poses are written in numbers: one registry of conventions.

A convention says which numbers stand for a pose and in which order, in which units the controllers
that use it show them, and what rotation they mean. Nothing is guessed from the numbers.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.formats.options import ImportOptions, Units
from servoscope.poses import FARTHEST, rigid_transform

Array = NDArray[np.float64]
AngleUnit = Literal["deg", "rad"]

METRES = {"m": 1.0, "mm": 1e-3}
"""Metres of each unit."""

_RADIANS = {"deg": np.pi / 180, "rad": 1.0}
_MOST_TURNS = 1.05  # angles beyond a turn and a bit are in another unit
_NOT_ORTHONORMAL = 0.01
_ORDER = re.compile(r"(?!.*(.)\1)([xyz]{3}|[XYZ]{3})")


@dataclass(frozen=True)
class PoseConvention:
    """How a pose is written in numbers.

    Parameters
    ----------
    meaning : str
        The rotation that the numbers mean.
    columns : tuple of str
        Names of the numbers in their order, translation first where it stands apart.
    length_unit, angle_unit : str, optional
        What controllers that use it show; where there is none, the user must say.
    rotation : callable
        Makes a `Rotation` of n from the (n, k) numbers behind the translation, angles in radians.
    example : tuple of float
        Numbers for which docs/conventions.md works out the rotation, in the units above.
    by_column : bool
        Whether the sixteen numbers of a matrix stand column by column.
    """

    meaning: str
    columns: tuple[str, ...]
    length_unit: Units | None
    angle_unit: AngleUnit | None
    rotation: Callable[[Array], Rotation]
    example: tuple[float, ...] = ()
    by_column: bool = False

    @property
    def is_matrix(self) -> bool:
        """Whether the numbers are those of a matrix, among which the translation stands."""
        return "r11" in self.columns

    @property
    def has_angles(self) -> bool:
        """Whether the numbers of the rotation are angles, or a rotation vector."""
        return not self.is_matrix and len(self.columns) == 6


TRANSLATION = ("tx", "ty", "tz")

MATRIX_COLUMNS = ("r11", "r12", "r13", "tx", "r21", "r22", "r23", "ty", "r31", "r32", "r33", "tz")
"""Names of the twelve numbers of a matrix, row by row, as which all matrices are handed on."""


def _angles(
    meaning: str, names: str, order: str, length: Units | None, unit: AngleUnit | None, *at: float
) -> PoseConvention:
    return PoseConvention(
        meaning,
        (*TRANSLATION, *names.split()),
        length,
        unit,
        lambda angles: Rotation.from_euler(order, angles),
        at,
    )


def _scalar_first(numbers: Array) -> Rotation:
    return Rotation.from_quat(numbers, scalar_first=True)


def _of_matrices(numbers: Array) -> Rotation:
    """The rotations nearest to matrices of (n, 9) numbers: those of files are rounded."""
    u, _, v = np.linalg.svd(numbers.reshape(-1, 3, 3))
    return Rotation.from_matrix(u @ v)


_ROTATION_VECTOR = PoseConvention(
    "a turn by the vector's length about the vector",
    (*TRANSLATION, "rx", "ry", "rz"),
    "m",
    "rad",
    Rotation.from_rotvec,
    (0.4, 1.2, -0.3),
)

CONVENTIONS: dict[str, PoseConvention] = {
    "xyzw": PoseConvention(
        "unit quaternion, scalar last (ROS, TUM, SciPy)",
        (*TRANSLATION, "qx", "qy", "qz", "qw"),
        "m",
        None,
        Rotation.from_quat,
        (0.2, 0.4, 0.4, 0.8),
    ),
    "wxyz": PoseConvention(
        "unit quaternion, scalar first (COLMAP, Eigen's constructor, MuJoCo)",
        (*TRANSLATION, "qw", "qx", "qy", "qz"),
        "m",
        None,
        _scalar_first,
        (0.8, 0.2, 0.4, 0.4),
    ),
    "matrix": PoseConvention(
        "matrix of 3 x 4 or 4 x 4 numbers, row by row",
        MATRIX_COLUMNS,
        "m",
        None,
        _of_matrices,
        (0.0, -1.0, 0.0, 0.8, 0.0, -0.6, 0.6, 0.0, 0.8),
    ),
    "franka": PoseConvention(
        "O_T_EE of libfranka: matrix of 4 x 4 numbers, column by column",
        (
            *("r11", "r21", "r31", "r41", "r12", "r22", "r32", "r42"),
            *("r13", "r23", "r33", "r43", "tx", "ty", "tz", "r44"),
        ),
        "m",
        None,
        _of_matrices,
        (0.0, 0.8, 0.6, -1.0, 0.0, 0.0, 0.0, -0.6, 0.8),
        by_column=True,
    ),
    "rotvec": _ROTATION_VECTOR,
    "ur": _ROTATION_VECTOR,
    "abb-quaternion": PoseConvention(
        "q1 q2 q3 q4 of RAPID: unit quaternion, scalar first",
        (*TRANSLATION, "q1", "q2", "q3", "q4"),
        "mm",
        None,
        _scalar_first,
        (0.8, 0.2, 0.4, 0.4),
    ),
    "kuka-abc": _angles(
        "Rz(A) Ry(B) Rx(C)", "a b c", "ZYX", "mm", "deg", 30.0, 20.0, 110.0
    ),
    "fanuc-wpr": _angles(
        "Rz(R) Ry(P) Rx(W)", "w p r", "xyz", "mm", "deg", 110.0, 20.0, 30.0
    ),
    "yaskawa-rxryrz": _angles(
        "Rz(Rz) Ry(Ry) Rx(Rx)", "rx ry rz", "xyz", "mm", "deg", 110.0, 20.0, 30.0
    ),
    "mitsubishi-abc": _angles(
        "Rz(C) Ry(B) Rx(A)", "a b c", "xyz", "mm", "deg", 110.0, 20.0, 30.0
    ),
    "epson-uvw": _angles(
        "Rz(U) Ry(V) Rx(W)", "u v w", "ZYX", "mm", "deg", 30.0, 20.0, 110.0
    ),
    "techman-rxryrz": _angles(
        "Rz(Rz) Ry(Ry) Rx(Rx)", "rx ry rz", "xyz", "mm", "deg", 110.0, 20.0, 30.0
    ),
    "ufactory-rpy": _angles(
        "Rz(yaw) Ry(pitch) Rx(roll)", "roll pitch yaw", "xyz", "mm", "deg", 110.0, 20.0, 30.0
    ),
    "staubli-rxryrz": _angles(
        "Rx(Rx) Ry(Ry) Rz(Rz)", "rx ry rz", "XYZ", "mm", "deg", 110.0, 20.0, 30.0
    ),
    "mecademic-abc": _angles(
        "Rx(alpha) Ry(beta) Rz(gamma)", "alpha beta gamma", "XYZ", "mm", "deg", 110.0, 20.0, 30.0
    ),
    "kawasaki-oat": _angles(
        "Rz(O) Ry(A) Rz(T)", "o a t", "ZYZ", "mm", "deg", 30.0, 70.0, 40.0
    ),
    "doosan-abc": _angles(
        "Rz(A) Ry(B) Rz(C)", "a b c", "ZYZ", "mm", "deg", 30.0, 70.0, 40.0
    ),
    "adept-ypr": _angles(
        "Rz(yaw) Ry(pitch) Rz(roll)", "yaw pitch roll", "ZYZ", "mm", "deg", 30.0, 70.0, 40.0
    ),
    "comau-zyz": _angles(
        "Rz(A) Ry(E) Rz(R)", "a e r", "ZYZ", "mm", "deg", 30.0, 70.0, 40.0
    ),
    "ros-rpy": _angles(
        "Rz(yaw) Ry(pitch) Rx(roll)", "roll pitch yaw", "xyz", "m", "rad", 1.9, 0.35, 0.5
    ),
}  # fmt: skip
"""Conventions by the name that the command line knows them by."""


def find_convention(name: str) -> PoseConvention:
    """The convention of a name of `CONVENTIONS`, or of an order of axes as SciPy writes them.

    Small letters turn about axes that stay, capitals about those of the body; the numbers come in
    the order of the letters. In other names capitals, underscores and umlauts make no difference,
    and the maker alone is enough: `KUKA_ABC` and `kuka` are `kuka-abc`.

    Raises
    ------
    InvalidInputError
        If there is none.

    Examples
    --------
    >>> find_convention("kuka-abc").columns
    ('tx', 'ty', 'tz', 'a', 'b', 'c')
    >>> find_convention("ZYX").columns
    ('tx', 'ty', 'tz', 'rz', 'ry', 'rx')
    """
    if known := _known(name):
        return CONVENTIONS[known]
    if not _ORDER.fullmatch(name):
        raise InvalidInputError(
            f"rotation must be one of {', '.join(CONVENTIONS)}, or an order of three axes such as "
            f"zyx (axes that stay) or ZYX (those of the body), got {name!r}."
        )
    names = [f"r{axis}" for axis in name.lower()]
    if len(set(names)) < 3:
        names = ["angle1", "angle2", "angle3"]
    body = "the body" if name.isupper() else "the world"
    return _angles(
        f"turns about {', '.join(name.lower())} of {body}", " ".join(names), name, None, None
    )


def _known(name: str) -> str | None:
    """The name of `CONVENTIONS` that is meant, if any."""
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().strip().lower()
    plain = re.sub(r"[_\s]+", "-", plain)
    return next((known for known in CONVENTIONS if plain in (known, known.split("-")[0])), None)


@dataclass(frozen=True, kw_only=True)
class ConventionOptions(ImportOptions):
    """What a user says of poses that are written as numbers, besides what holds for every format.

    Parameters
    ----------
    rotation : str, optional
        How the rotations are written: xyzw, wxyz, matrix, franka, rotvec, ur, abb-quaternion,
        kuka-abc, fanuc-wpr, ros-rpy and others of docs/conventions.md, or an order of axes as SciPy
        has it, such as zyx or ZYX. By default quaternions whose columns are called qx, qy, qz and
        qw.
    angle_unit : {"deg", "rad"}, optional
        Of angles and rotation vectors; by default that of the convention.
    columns : str, optional
        Names of the columns that hold the pose, or their numbers from 1, with commas, in the order
        of the convention; by default its own names.

    Examples
    --------
    >>> ConventionOptions(rotation="kuka-abc").length_unit
    'mm'
    """

    rotation: str | None = None
    angle_unit: AngleUnit | None = None
    columns: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        convention = self.convention
        if convention is not None and convention.has_angles:
            if (self.angle_unit or convention.angle_unit) is None:
                raise InvalidInputError(
                    f"The angles of {self.rotation} may be in degrees or radians; say which with "
                    "--angle-unit deg or --angle-unit rad."
                )
        elif self.angle_unit is not None:
            raise InvalidInputError(
                f"angle_unit {self.angle_unit} has no angles to be of; give rotation, or leave it "
                "out."
            )

    @property
    def convention(self) -> PoseConvention | None:
        """How poses are written, if it is said."""
        return None if self.rotation is None else find_convention(self.rotation)

    @property
    def length_unit(self) -> Units:
        """Unit of the translations: as the user says, or what controllers of the convention show.

        An order of axes belongs to no controller: metres.
        """
        convention = self.convention
        return self.units or (convention.length_unit if convention else None) or "m"


def poses_from_numbers(
    numbers: ArrayLike,
    convention: PoseConvention,
    *,
    length_unit: Units,
    angle_unit: AngleUnit | None = None,
) -> Array:
    """Rigid transforms of poses that are written in a convention.

    Parameters
    ----------
    numbers : array of shape (n, k)
        In the order of the convention's columns; of matrices the upper three rows, row by row.
    convention : PoseConvention
    length_unit : {"m", "mm"}
    angle_unit : {"deg", "rad"}, optional
        Of angles and rotation vectors; the convention's by default.

    Returns
    -------
    ndarray of shape (n, 4, 4)
        [m].

    Examples
    --------
    >>> kuka = find_convention("kuka-abc")
    >>> poses_from_numbers([[500, 0, 0, 90, 0, 0]], kuka, length_unit="mm")[0].round(3) + 0.0
    array([[ 0. , -1. ,  0. ,  0.5],
           [ 1. ,  0. ,  0. ,  0. ],
           [ 0. ,  0. ,  1. ,  0. ],
           [ 0. ,  0. ,  0. ,  1. ]])
    """
    translations, rest = _parts(np.asarray(numbers, dtype=float), convention)
    if not len(rest):
        return np.empty((0, 4, 4))
    if convention.has_angles:
        rest = rest * _RADIANS[_angle_unit(convention, angle_unit)]
    rotations = convention.rotation(rest).as_matrix()
    return rigid_transform(rotations, translations * METRES[length_unit])


def problem_of_pose(
    numbers: list[float],
    convention: PoseConvention,
    *,
    length_unit: Units,
    angle_unit: AngleUnit | None = None,
) -> str:
    """What makes finite numbers no pose, and what may help; empty if nothing does.

    Examples
    --------
    >>> problem_of_pose([0, 0, 0, 0, 0, 0, 0], CONVENTIONS["xyzw"], length_unit="m")
    'the quaternion [0.0, 0.0, 0.0, 0.0] has zero length; mend the line'
    """
    (translation,), (rest,) = _parts(np.array([numbers], dtype=float), convention)
    if np.abs(translation).max() * METRES[length_unit] > FARTHEST:
        return f"the translation {translation.tolist()} is in no room; check --units"
    if convention.is_matrix:
        return _problem_of_matrix(rest.reshape(3, 3))
    largest = float(np.abs(rest).max())
    if convention.has_angles:
        unit = _angle_unit(convention, angle_unit)
        if largest * _RADIANS[unit] <= 2 * np.pi * _MOST_TURNS:
            return ""
        other = "; are they in deg? Check --angle-unit" if unit == "rad" else "; mend the line"
        return f"the angles {rest.tolist()} {unit} go beyond a whole turn{other}"
    if largest < 1e-6:
        return f"the quaternion {rest.tolist()} has zero length; mend the line"
    if largest > 1e6:
        return f"the quaternion {rest.tolist()} is none; mend the line"
    return ""


def _problem_of_matrix(R: Array) -> str:
    error = float(np.abs(R @ R.T - np.eye(3)).max()) if np.abs(R).max() < 1e6 else np.inf
    if error > _NOT_ORTHONORMAL:
        return (
            f"the rows of the rotation must be orthonormal, but are off by {error:.3g}; check that "
            "the matrix stands row by row and is not scaled"
        )
    if np.linalg.det(R) < 0:
        return "the matrix mirrors, and is no rotation; check the signs of its columns"
    return ""


def _parts(numbers: Array, convention: PoseConvention) -> tuple[Array, Array]:
    """Translations (n, 3), and the numbers of the rotations."""
    columns = MATRIX_COLUMNS if convention.is_matrix else convention.columns
    is_translation = [column in TRANSLATION for column in columns]
    numbers = numbers.reshape(-1, len(is_translation))
    return numbers[:, is_translation], numbers[:, np.logical_not(is_translation)]


def _angle_unit(convention: PoseConvention, asked: AngleUnit | None) -> AngleUnit:
    unit = asked or convention.angle_unit
    if unit is None:
        raise InvalidInputError(
            "The unit of angles in an order of axes must be said: angle_unit deg or rad."
        )
    return unit
