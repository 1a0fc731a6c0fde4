"""Where the error of a degree of freedom comes from."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


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
