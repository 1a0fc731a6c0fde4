"""What an assessment found, before it is put into mm, degrees and words."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.decision import Decision, Measured
from servoscope.assessment.image_facts import ImageFacts
from servoscope.assessment.rendered import Sample
from servoscope.assessment.view import ViewFindings
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import IndependentGroups
from servoscope.data.splits import Split
from servoscope.pipeline import Fitted, PosePipeline
from servoscope.selection import LearningCurve

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Assessment:
    """Everything that was measured; errors in units of the range.

    Parameters
    ----------
    decision : Decision
        The images, what was chosen for each dof, and what it is forecast to reach and reaches.
    images : ImageFacts
    measured : Measured
        What the choice errs on test images.
    pipeline : PosePipeline or None
        Of the chosen recipes; None where nothing moves.
    best_features : dict of tuple of str
        By dof, the features that count most, the first most of all.
    curves : dict of LearningCurve
        By dof, on the chosen features.
    noise : dict
        RMS error by dof that the noise of the pixels makes.
    disturbed : dict
        RMS test error by disturbance and dof.
    without_border : dict
        Forecasts by dof from the middle of the view; None where it is too small.
    at_random : dict or None
        Forecasts by dof, as of the candidates, that take dependent images for independent ones.
    view : ViewFindings or None
        What a keyframe reaches; None if none explains the view.
    regressors, regressors_on_moments : list of Fitted
        Other regressors on the chosen features, and on the paper's; none unless asked for.
    """

    decision: Decision = field(repr=False)
    images: ImageFacts
    measured: Measured = field(repr=False)
    pipeline: PosePipeline | None = field(repr=False)
    best_features: dict[str, tuple[str, ...]]
    curves: dict[str, LearningCurve] = field(repr=False)
    noise: dict[str, float]
    disturbed: dict[str, dict[str, float]]
    without_border: dict[str, float | None] = field(repr=False)
    at_random: dict[str, float] | None
    view: ViewFindings | None = field(repr=False)
    regressors: list[Fitted] = field(repr=False)
    regressors_on_moments: list[Fitted] = field(repr=False)

    @property
    def sample(self) -> Sample:
        """The images, and which of them test."""
        return self.decision.sample

    @property
    def data(self) -> PoseImageSet:
        """The images: the real ones first."""
        return self.sample.data

    @property
    def split(self) -> Split:
        """Which of them train, validate and test."""
        return self.sample.split

    @property
    def independence(self) -> IndependentGroups:
        """How they depend on each other."""
        return self.sample.independence

    @property
    def learned_targets(self) -> Array:
        """Displacements of the images that were learned from, in units of the range."""
        return self.data.delta_p()[self.split.learned] / self.data.ranges()
