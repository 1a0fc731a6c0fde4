"""How well each dof is observable, where its error comes from, and the verdict on all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from servoscope.wording import listing, plain_number

WELL, ROUGHLY, HARDLY = 0.25, 0.6, 0.9
"""Shares of the error of predicting the mean, up to which a dof is observable so well."""

GRADES = ("well", "roughly", "hardly", "not")

LIMITS = {
    "noise": "pixel noise",
    "pose_labels": "pose labels",
    "too_few_images": "too few images",
    "regressor": "regressor",
    "weak_features": "weak features",
}
"""What the largest share of the error budget is called."""

STILL, LEFT_OUT, CONSTANT, UNPREDICTED, REPEATING = (
    "never moves",
    "not asked for",
    "images do not change",
    "no feature predicts it",
    "repeating pattern",
)
"""Limits that are in no budget."""

VIEW = "the view itself"
"""The limit of what is read nearly as well as the grey levels allow."""

_NEAR_LIMIT = 2.0
_ENOUGH_ARRIVE = 0.9


@dataclass(frozen=True)
class ErrorBudget:
    """Shares of the squared error of one dof; together they are 1.

    Parameters
    ----------
    noise : float
        Of the pixels.
    pose_labels : float
        The robot, or whatever tells the poses, errs.
    too_few_images : float
        What ten times as many images would take away.
    regressor : float
        What another regressor did better on the same features.
    weak_features : float
        The rest: these features tell no more.

    Examples
    --------
    >>> budget = share_out(1.0, noise=0.3, labels=0.1, at_ten_times=0.8, best_regressor=1.0)
    >>> round(budget.noise, 2), round(budget.too_few_images, 2), budget.largest
    (0.09, 0.36, 'weak_features')
    """

    noise: float
    pose_labels: float
    too_few_images: float
    regressor: float
    weak_features: float

    @property
    def largest(self) -> str:
        """The name of the largest share."""
        return max((field.name for field in fields(self)), key=lambda name: getattr(self, name))


def share_out(
    rms: float, *, noise: float, labels: float, at_ten_times: float, best_regressor: float
) -> ErrorBudget:
    """The budget of an RMS error, from parts that were found one by one.

    Parameters
    ----------
    rms : float
        The error to explain, in any unit.
    noise, labels : float
        RMS errors that pixel noise and pose labels make alone, in that unit.
    at_ten_times : float
        RMS error with ten times the images.
    best_regressor : float
        RMS error of the best regressor on these features.

    Notes
    -----
    Independent errors add in squares. The parts were estimated one by one, so that together they
    may come to more than there is: they are served in the order of the arguments, each with what
    is left.
    """
    total = rms**2
    wanted = {
        "noise": noise**2,
        "pose_labels": labels**2,
        "too_few_images": total - at_ten_times**2,
        "regressor": total - best_regressor**2,
    }
    left, shares = 1.0, {}
    for name, squared in wanted.items():
        share = squared / total if total > 0 else 0.0
        shares[name] = float(np.clip(share, 0.0, left))
        left -= shares[name]
    return ErrorBudget(**shares, weak_features=left)


def grade(share: float) -> str:
    """How well a dof is observable, one of `GRADES`.

    Parameters
    ----------
    share : float
        RMS error over that of predicting the mean.

    Examples
    --------
    >>> grade(0.1), grade(0.95)
    ('well', 'not')
    """
    for name, limit in zip(GRADES, (WELL, ROUGHLY, HARDLY), strict=False):
        if share <= limit:
            return name
    return "not"


def name_limit(
    observable: str,
    budget: ErrorBudget,
    *,
    is_at_period: bool = False,
    rms: float = np.inf,
    view_limit: float | None = None,
) -> str:
    """What limits a dof that moves in images that change.

    Parameters
    ----------
    observable : str
        Its grade.
    budget : ErrorBudget
    is_at_period : bool
        Whether its errors cluster where the view repeats.
    rms, view_limit : float
        Its error, and what no estimate from one image goes below.
    """
    if view_limit is not None and rms <= _NEAR_LIMIT * view_limit:
        return VIEW
    if is_at_period:
        return REPEATING
    if observable == "not":
        return UNPREDICTED
    return LIMITS[budget.largest]


def conclude(dofs: Mapping[str, Mapping[str, Any]], loop: Mapping[str, Any] | None) -> str:
    """The verdict on all dofs, one or two sentences.

    Parameters
    ----------
    dofs : dict
        Rows of `servoscope.assessment.as_json`.
    loop : dict or None
        Of the rehearsed loop, see `ViewFindings`.
    """
    moving = {dof: row for dof, row in dofs.items() if row["forecast_rms"] is not None}
    asked = {dof: row for dof, row in dofs.items() if row["tolerance"] is not None}
    if not moving:
        return "Nothing can be learned from these images: nothing moves."
    if loop is None and all(row["observable"] == "not" for row in moving.values()):
        return "Nothing can be learned from these images."
    if asked:
        return _on_tolerances(asked, loop)
    if loop is None:
        return f"From features alone: {_on_observability(moving)} No keyframe explains the view."
    return f"{_on_loop(loop)} From features, one image each: {_on_observability(moving)}"


def is_met(error: float | None, row: Mapping[str, Any]) -> bool | None:
    """Whether an error is within the tolerance of a dof; None where none was asked for."""
    if row["tolerance"] is None:
        return None
    return error is not None and error <= row["tolerance"]


def arrives(loop: Mapping[str, Any] | None) -> bool:
    """Whether nearly all rehearsed starts arrive."""
    return loop is not None and loop["success"] >= _ENOUGH_ARRIVE


def _on_tolerances(asked: Mapping[str, Mapping[str, Any]], loop: Mapping[str, Any] | None) -> str:
    n = len(asked)
    in_look = sum(bool(row["met_in_one_look"]) for row in asked.values())
    in_loop = sum(bool(row["met_in_loop"]) for row in asked.values())
    if loop is None:
        said = f"{in_look} of {n} tolerances met in one look"
        said += "; the loop is not forecast, as no keyframe explains the view"
    else:
        said = f"{in_loop} of {n} tolerances met in the loop, {in_look} of {n} in one look"
    missed = [
        row
        for row in asked.values()
        if not row["met_in_loop" if loop is not None else "met_in_one_look"]
    ]
    if not missed:
        return f"{said}; next: train a model, servoscope train."
    if loop is not None and not arrives(loop):
        step = "train a model, servoscope train, and rehearse it from nearer"
        return f"{said}; {_arrived(loop)}; next: {step}."
    advice = next((row["advice"][0] for row in missed if row["advice"]), "take more images")
    return f"{said}; next: {advice}."


def _on_loop(loop: Mapping[str, Any]) -> str:
    if not arrives(loop):
        return f"The loop is not safe: {_arrived(loop)}."
    mm, deg = plain_number(loop["end_mm"]), plain_number(loop["end_deg"])
    return (
        f"The loop is forecast to end {mm} mm and {deg} deg from the reference; {_arrived(loop)}."
    )


def _arrived(loop: Mapping[str, Any]) -> str:
    n_starts = loop["starts"]
    return f"{round(loop['success'] * n_starts)} of {n_starts} rehearsed starts arrive"


def _on_observability(rows: Mapping[str, Mapping[str, Any]]) -> str:
    parts = []
    for name, words in (("well", "well"), ("roughly", "roughly"), ("hardly", "hardly")):
        dofs = [dof for dof, row in rows.items() if row["observable"] == name]
        if dofs:
            parts.append(f"{listing(dofs)} {words} observable")
    dofs = [dof for dof, row in rows.items() if row["observable"] == "not"]
    if dofs:
        parts.append(f"{listing(dofs)} not observable")
    return f"{'; '.join(parts)}."
