"""Whether a keyframe or levels read images better, decided on images that neither learned from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.keyframe import Keyframe
from servoscope.keyframe.fitting import evenly_spread
from servoscope.poses import displacements_from_poses
from servoscope.positioning.calibration import Calibration
from servoscope.positioning.interfaces import Array
from servoscope.positioning.ladder import HeldOut
from servoscope.positioning.model import PositioningModel

NEAR = 0.3
"""Displacements up to this share of the range are near the reference."""

_RIGHT = 0.25
_CLEARLY_MORE, _LEAST_NEAR = 0.05, 5
_MOST_FITTED, _MOST_READ = 40, 60


def compare_methods(
    levels: PositioningModel, data: PoseImageSet, held_out: HeldOut, calibration: Calibration
) -> dict[str, Any]:
    """Which method reads the images better that were held out, and the numbers of both.

    A keyframe is chosen if it reads more images right, or, of as many, reads them better.

    Parameters
    ----------
    levels : PositioningModel
        Learned without the images held out.
    data : PoseImageSet
    held_out : HeldOut
    calibration : Calibration

    Returns
    -------
    dict
        ``chosen``, and for each method ``share_right``, the share of images that were read within
        a quarter of the range, ``far`` and ``near``, median largest error of a dof in shares of
        the range, of images beyond and within `NEAR` of it; None where there are none.
    """
    read = evenly_spread(np.argsort(np.abs(held_out.p).max(axis=1), kind="stable"), _MOST_READ)
    images, p = held_out.images[read], held_out.p[read]
    said = np.stack([levels.estimate(image).displacement for image in images])
    found = {"levels": _summary(displacements_from_poses(np.eye(4), said, data.pivot), p, levels)}
    fitted = evenly_spread(held_out.kept, _MOST_FITTED)
    options = calibration.options(is_sequence=data.split == "blocks")
    try:
        keyframe = Keyframe.fit(
            data.images[fitted], data.T_world_cam[fitted], data.reference_image, data.T_world_ref,
            pivot=data.pivot, **options,
        )  # fmt: skip
    except InvalidInputError:
        return {"chosen": "levels", **found}
    said = np.stack([keyframe.align(image).delta_p for image in images])
    found["keyframe"] = _summary(said, p, levels)
    return {"chosen": "keyframe" if _is_better(**found) else "levels", **found}


def decision_text(decision: Mapping[str, Any]) -> str:
    """One line of what was chosen, and why.

    Examples
    --------
    >>> numbers = {"share_right": 0.9, "far": 0.02, "near": None}
    >>> decision_text({"chosen": "levels", "levels": numbers})
    'chosen: levels (of images held out 90 % read right; typical error 2 % of the range far away)'
    """
    parts = []
    for method in ("keyframe", "levels"):
        if method not in decision:
            continue
        numbers = decision[method]
        errors = [
            f"{100 * numbers[name]:.2g} % of the range {where}"
            for name, where in (("far", "far away"), ("near", "near the reference"))
            if numbers[name] is not None
        ]
        read = f"{100 * numbers['share_right']:.0f} % read right; typical error {', '.join(errors)}"
        parts.append(read if len(decision) == 2 else f"by {method} {read}")
    return f"chosen: {decision['chosen']} (of images held out {'; '.join(parts)})"


def _is_better(keyframe: dict[str, Any], levels: dict[str, Any]) -> bool:
    more = keyframe["share_right"] - levels["share_right"]
    if abs(more) > _CLEARLY_MORE:
        return bool(more > 0)
    where = "near" if min(keyframe["n_near"], levels["n_near"]) >= _LEAST_NEAR else "far"
    return bool(keyframe[where] < levels[where])


def _summary(delta_p: Array, p: Array, levels: PositioningModel) -> dict[str, Any]:
    errors = np.abs(delta_p / levels.reach - p).max(axis=1)
    is_near = np.abs(p).max(axis=1) <= NEAR
    parts = {"far": errors[~is_near], "near": errors[is_near]}
    medians = {name: float(np.median(e)) if e.size else None for name, e in parts.items()}
    counts = {"n_near": int(is_near.sum())}
    return {"share_right": float(np.mean(errors <= _RIGHT)), **medians, **counts}
