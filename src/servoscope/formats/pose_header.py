"""What a line of column names says of the order of a pose's numbers."""

from __future__ import annotations

import re
from itertools import groupby

from servoscope.errors import DataSetError

_UNIT = re.compile(r"[\[(][^\])]*[\])]")
_AXIS = re.compile(r"(?:[\w./]*[_./])?[a-z]{0,2}([wxyz])")
_N_NUMBERS = 7


def check_pose_header(line: str, quaternion_order: str, where: str) -> None:
    """Check that column names, if a line holds them, do not contradict what is read.

    Names such as ``tx``, ``q_w``, ``pose.orientation.x`` or ``q_RS_w []`` are known by the axis
    that they end with.

    Raises
    ------
    DataSetError
        If seven names of axes are in another order than translation and quaternion.

    Examples
    --------
    >>> check_pose_header("# timestamp tx ty tz qx qy qz qw", "xyzw", "groundtruth.txt, line 1")
    """
    axes = [_AXIS.fullmatch(name) for name in _names(line)]
    for is_axes, run in groupby(axes, bool):
        found = [match for match in run if match][:_N_NUMBERS]
        letters = "".join(match[1] for match in found)
        if not is_axes or sorted(letters) != sorted("xyzwxyz"):
            continue
        if letters == "xyz" + quaternion_order:
            return
        names = " ".join(match[0] for match in found)
        is_other = letters == "xyz" + {"xyzw": "wxyz", "wxyz": "xyzw"}[quaternion_order]
        order = "wxyz" if quaternion_order == "xyzw" else "xyzw"
        advice = f"say --quaternion-order {order}" if is_other else "put the columns in that order"
        raise DataSetError(
            f"{where}: the columns are called {names!r}, but are read as tx ty tz and a quaternion "
            f"{quaternion_order}; {advice}, or mend the line."
        )


def _names(line: str) -> list[str]:
    return re.split(r"[\s,;]+", _UNIT.sub(" ", line.lower().lstrip("# ")).strip())
