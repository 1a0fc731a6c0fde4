"""What an assessment found, before it is put into mm, degrees and words."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.candidates import Candidate
from servoscope.assessment.image_facts import ImageFacts
from servoscope.assessment.models import DofModel
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import IndependentGroups
from servoscope.data.splits import Split
from servoscope.regression import RegressorScore
from servoscope.selection import Forecast, LearningCurve

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Assessment:
    """Everything that was measured; errors in units of the range.

    Parameters
    ----------
    data : PoseImageSet
    split : Split
    independence : IndependentGroups
    images : ImageFacts
    candidates : dict of Candidate
    choice : dict
        The candidate that tells each dof best, for those that move in the images learned from.
    forecasts : dict of Forecast
        By dof, on the chosen features.
    trained : dict
        By candidate and dof.
    curves : dict of LearningCurve
        By dof, on the chosen features.
    noise : dict
        RMS error by dof that the noise of the pixels makes.
    disturbed : dict
        RMS test error by disturbance and dof.
    without_border : dict
        Forecasts by candidate from the middle of the view; None where it is too small.
    at_random : dict or None
        Forecasts by dof, as of the candidates, that take dependent images for independent ones.
    regressors, regressors_on_moments : list of RegressorScore
        On the chosen features, and on the paper's.
    """

    data: PoseImageSet = field(repr=False)
    split: Split = field(repr=False)
    independence: IndependentGroups = field(repr=False)
    images: ImageFacts
    candidates: dict[str, Candidate] = field(repr=False)
    choice: dict[str, str]
    forecasts: dict[str, Forecast] = field(repr=False)
    trained: dict[str, dict[str, DofModel]] = field(repr=False)
    curves: dict[str, LearningCurve] = field(repr=False)
    noise: dict[str, float]
    disturbed: dict[str, dict[str, float]]
    without_border: dict[str, Array | None] = field(repr=False)
    at_random: dict[str, float] | None
    regressors: list[RegressorScore] = field(repr=False)
    regressors_on_moments: list[RegressorScore] = field(repr=False)

    @property
    def learned_targets(self) -> Array:
        """Displacements of the images that were learned from, in units of the range."""
        return self.data.delta_p()[self.split.learned] / self.data.ranges()
