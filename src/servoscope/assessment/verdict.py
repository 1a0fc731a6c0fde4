"""How well a degree of freedom is told, and what stands in the way of more."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from servoscope.assessment.budget import ErrorBudget
from servoscope.assessment.repetition import Repetition
from servoscope.poses import DOFS
from servoscope.wording import listing

WELL, ROUGHLY, HARDLY = 0.25, 0.6, 0.9
"""Shares of the error of answering the mean, up to which a dof is told well, roughly, hardly."""

GRADES = ("well", "roughly", "hardly", "not")

LIMITS = {
    "noise": "pixel noise",
    "pose_labels": "pose labels",
    "too_few_images": "too few images",
    "regressor": "regressor",
    "weak_features": "weak features",
}
"""What the largest share of the error budget is called."""

STILL, CONSTANT, UNTOLD, REPEATING = (
    "never moves",
    "images do not change",
    "nothing tells it",
    "repeating pattern",
)
"""Limits that no budget tells."""


def grade(share: float) -> str:
    """How well a dof is told, one of `GRADES`.

    Parameters
    ----------
    share : float
        RMS error over that of always answering the mean.

    Examples
    --------
    >>> grade(0.1), grade(0.95)
    ('well', 'not')
    """
    for name, limit in zip(GRADES, (WELL, ROUGHLY, HARDLY), strict=False):
        if share <= limit:
            return name
    return "not"


def name_limit(told: str, budget: ErrorBudget, repetition: Repetition) -> str:
    """What limits a dof that moves in images that change.

    Parameters
    ----------
    told : str
        Its grade.
    budget : ErrorBudget
    repetition : Repetition
        Of the reference image; it counts where the dof is not told well.
    """
    if repetition.repeats and told != "well":
        return REPEATING
    if told == "not":
        return UNTOLD
    return LIMITS[budget.largest]


def conclude(shares: Mapping[str, float]) -> str:
    """One sentence on all dofs that move.

    Parameters
    ----------
    shares : dict
        RMS error of each over that of always answering the mean. Translations or rotations as a
        kind are judged by the geometric mean of theirs.

    Examples
    --------
    >>> conclude(dict(tx=0.7, ty=0.95, tz=0.8, rx=0.1, ry=0.4, rz=0.5))
    'Rotations are told, translations are not (27 % and 81 % of the error of the mean are left): \
tx and tz hardly, ty not at all.'
    >>> conclude(dict.fromkeys(("tx", "ty", "tz", "rx", "ry", "rz"), 1.0))
    'Nothing can be learned from these images.'
    """
    told = {dof: grade(share) for dof, share in shares.items()}
    poor = {dof: name for dof, name in told.items() if name in ("hardly", "not")}
    if not told:
        return "Nothing can be learned from these images: nothing moves."
    if all(name == "not" for name in told.values()):
        return "Nothing can be learned from these images."
    if not poor:
        which = "" if len(told) == len(DOFS) else " that moves"
        roughly = [dof for dof, name in told.items() if name == "roughly"]
        return f"Every degree of freedom{which} is told{_except(roughly)}."
    kinds = _kinds(shares)
    if len(kinds) == 2 and min(kinds.values()) <= ROUGHLY < max(kinds.values()):
        good, bad = sorted(kinds, key=lambda kind: kinds[kind])
        left = f"{100 * kinds[good]:.0f} % and {100 * kinds[bad]:.0f} %"
        return (
            f"{good.capitalize()} are told, {bad} are not ({left} of the error of the mean are "
            f"left): {_poor(poor)}."
        )
    good_ones = [dof for dof in told if dof not in poor]
    verb = "is" if len(good_ones) == 1 else "are"
    if not good_ones:
        return f"Little can be learned from these images: {_poor(poor)}."
    return f"{listing(good_ones)} {verb} told; {_poor(poor)}."


def _kinds(shares: Mapping[str, float]) -> dict[str, float]:
    """Geometric mean of the shares of translations and of rotations, where they move."""
    kinds = {"translations": "t", "rotations": "r"}
    of_kind = {
        kind: [share for dof, share in shares.items() if dof[0] == letter]
        for kind, letter in kinds.items()
    }
    return {
        kind: float(np.exp(np.mean(np.log(np.maximum(values, 1e-12)))))
        for kind, values in of_kind.items()
        if values
    }


def _except(roughly: list[str]) -> str:
    return f", {listing(roughly)} only roughly" if roughly else " well"


def _poor(poor: Mapping[str, str]) -> str:
    parts = []
    for grade, words in (("hardly", "hardly"), ("not", "not at all")):
        dofs = [dof for dof, told in poor.items() if told == grade]
        if dofs:
            parts.append(f"{listing(dofs)} {words}")
    return ", ".join(parts)
