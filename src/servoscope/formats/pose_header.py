"""What a line of column names says of the order of a pose's numbers."""

from __future__ import annotations

import re

from servoscope.errors import DataSetError

_AXIS = re.compile(r"(?:[\w./]*[_./])?(?:[tpqr]|pos|quat|rot)?([wxyz])")
_PART_OF_QUATERNION = re.compile(r"q\w*[wxyz]")
_ORDERS = ("xyzw", "wxyz")


def check_pose_header(line: str, quaternion_order: str, where: str) -> None:
    """Check that column names, if a line holds them, do not contradict what is read.

    Names such as ``tx``, ``q_w``, ``pose.orientation.x`` or ``q_RS_w []`` are known by the axis
    that they end with. A line holds names if it has seven of them, four of a quaternion, or the
    word ``xyzw`` or ``wxyz``.

    Raises
    ------
    DataSetError
        If seven names of axes are in another order than translation and quaternion.

    Examples
    --------
    >>> check_pose_header("# timestamp tx ty tz qx qy qz qw", "xyzw", "groundtruth.txt, line 1")
    """
    words = re.split(r"[\s,;|:=()\[\]]+", line.lower().lstrip("#%/ "))
    names = [word for word in words if _AXIS.fullmatch(word)][:7]
    letters = "".join(name[-1] for name in names)
    if sorted(letters) == sorted("xyzwxyz"):
        is_as_read = letters == "xyz" + quaternion_order
        order = letters[3:] if letters.startswith("xyz") else ""
    else:
        names = [word for word in words if _PART_OF_QUATERNION.fullmatch(word)]
        names = names if len(names) == 4 else [word for word in words if word in _ORDERS][:1]
        order = "".join(name[-1] for name in names) if len(names) == 4 else "".join(names)
        is_as_read = order == quaternion_order or sorted(order) != sorted("wxyz")
    if is_as_read:
        return
    advice = "put the columns in that order"
    if order in _ORDERS:
        advice = f"say --quaternion-order {order}"
    raise DataSetError(
        f"{where}: the columns are called {' '.join(names)!r}, but are read as tx ty tz and a "
        f"quaternion {quaternion_order}; {advice}, or mend the line."
    )
