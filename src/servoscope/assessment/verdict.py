"""How well a degree of freedom is told, and what stands in the way of more."""

from __future__ import annotations

from collections.abc import Mapping

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


def grade(rms: float, baseline: float) -> str:
    """How well a dof is told, one of `GRADES`.

    Parameters
    ----------
    rms : float
        RMS error.
    baseline : float
        That of always answering the mean.

    Examples
    --------
    >>> grade(0.1, 1.0), grade(0.95, 1.0)
    ('well', 'not')
    """
    share = rms / baseline if baseline > 0 else 1.0
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


def conclude(told: Mapping[str, str]) -> str:
    """One sentence on all dofs.

    Parameters
    ----------
    told : dict
        The grade of every dof, or ``"still"`` for one that never moves.

    Examples
    --------
    >>> conclude(dict(tx="hardly", ty="not", tz="hardly", rx="well", ry="well", rz="roughly"))
    'Rotations are told, translations are not: tx and tz hardly, ty not at all.'
    >>> conclude(dict.fromkeys(("tx", "ty", "tz", "rx", "ry", "rz"), "not"))
    'Nothing can be learned from these images.'
    """
    moving = {dof: told[dof] for dof in DOFS if told[dof] != "still"}
    poor = {dof: grade for dof, grade in moving.items() if grade in ("hardly", "not")}
    if not moving:
        return "Nothing can be learned from these images: nothing moves."
    if all(grade == "not" for grade in moving.values()):
        return "Nothing can be learned from these images."
    if not poor:
        which = "" if len(moving) == len(DOFS) else " that moves"
        roughly = [dof for dof, grade in moving.items() if grade == "roughly"]
        return f"Every degree of freedom{which} is told{_except(roughly)}."
    kinds = {"t": "translations", "r": "rotations"}
    for kind, name in kinds.items():
        of_kind = [dof for dof in moving if dof[0] == kind]
        if of_kind and set(of_kind) == set(poor) and len(moving) > len(poor):
            other = kinds["r" if kind == "t" else "t"]
            return f"{other.capitalize()} are told, {name} are not: {_poor(poor)}."
    good = [dof for dof in moving if dof not in poor]
    told_ones = f"{listing(good)} {'is' if len(good) == 1 else 'are'} told; " if good else ""
    return f"{told_ones}{_poor(poor)}."


def _except(roughly: list[str]) -> str:
    return f", {listing(roughly)} only roughly" if roughly else " well"


def _poor(poor: Mapping[str, str]) -> str:
    parts = []
    for grade, words in (("hardly", "hardly"), ("not", "not at all")):
        dofs = [dof for dof, told in poor.items() if told == grade]
        if dofs:
            parts.append(f"{listing(dofs)} {words}")
    return ", ".join(parts)
