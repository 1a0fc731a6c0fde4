"""What training a network from one start gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Status = Literal["stopped_early", "converged", "max_iter", "damping_limit"]


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """What training from one start gave.

    Attributes
    ----------
    weights : ndarray of shape (n_weights,)
        Those of the best iteration.
    status : {"stopped_early", "converged", "max_iter", "damping_limit"}
        Why training ended: the validation error stopped falling, the training error did, the
        steps ran out, or no damping gave a step that lowers the training error.
    n_iter : int
        Number of steps taken.
    best_iteration : int
        The step after which the validation error was least; the last one without validation.
    training_rms, validation_rms : ndarray of shape (n_iter + 1,)
        Error before the first step and after each, in units of the target; the validation error
        is NaN without validation.
    """

    weights: NDArray[np.float64]
    status: Status
    n_iter: int
    best_iteration: int
    training_rms: NDArray[np.float64]
    validation_rms: NDArray[np.float64]

    @property
    def best_rms(self) -> float:
        """Validation error of `weights`, or training error where there was no validation."""
        rms = self.training_rms if np.isnan(self.validation_rms).any() else self.validation_rms
        return float(rms[self.best_iteration])

    @property
    def loss(self) -> float:
        """By which the best of several starts is chosen, the least one: `best_rms`."""
        return self.best_rms
