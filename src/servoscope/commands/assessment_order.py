"""What ``assess`` is asked for, of one data set or of each of several."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from servoscope.commands.options import with_dofs
from servoscope.commands.run_assessment import reported_pose_errors, run_assessment
from servoscope.commands.run_study import finish_run
from servoscope.data.checks import check_data
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import check_enough_images, mark_sequence
from servoscope.data.splits import MOST_IMAGES
from servoscope.errors import ServoscopeWarning
from servoscope.processes import ProgressBar
from servoscope.storage.addresses import absolute
from servoscope.storage.run_folder import RunFolder
from servoscope.study import StudyConfig


@dataclass(frozen=True)
class AssessmentOrder:
    """The options of ``assess`` that say what is to be found out.

    Parameters
    ----------
    config : StudyConfig
        Whose seed is that of the assessment too.
    families : tuple of str
    regressor : str
    dofs : str, optional
        As of ``--dofs``.
    tolerances, pose_errors : dict
        By dof, [mm] and [deg].
    study : bool
        Whether the paper's study is made as well.
    memory : str
        As of ``--memory``.
    """

    config: StudyConfig
    families: tuple[str, ...]
    regressor: str
    dofs: str | None
    tolerances: Mapping[str, float]
    pose_errors: Mapping[str, float]
    study: bool
    memory: str

    def load(self, dataset: str) -> tuple[PoseImageSet, list[str]]:
        """The images that are assessed, and what was found in all of the set.

        Raises
        ------
        DataSetError
            If it cannot be read.
        InvalidInputError
            If there are too few images.
        """
        data = self._whole(dataset)
        check_enough_images(data)
        findings = [finding.text for finding in check_data(data)]
        return self._sample(data), findings

    def fingerprint(self, dataset: str) -> str:
        """That of the images that `load` gives.

        Raises
        ------
        DataSetError
            If the data set cannot be read.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ServoscopeWarning)
            return self._sample(self._whole(dataset)).fingerprint()

    def _whole(self, dataset: str) -> PoseImageSet:
        return with_dofs(PoseImageSet.load(dataset, memory=self.memory), self.dofs)

    def _sample(self, data: PoseImageSet) -> PoseImageSet:
        """What is assessed of a data set; a random split of a sequence would flatter."""
        return mark_sequence(data.thinned(MOST_IMAGES, self.memory))

    def asked(self) -> dict[str, Any]:
        """All but the data set, as plain JSON values."""
        asked = {**asdict(self.config), "tolerance": dict(self.tolerances)}
        asked |= {"pose_error": dict(self.pose_errors), "families": list(self.families)}
        return asked | {"regressor": self.regressor, "dofs": self.dofs, "study": self.study}

    def settings(self, dataset: str, data: PoseImageSet) -> dict[str, Any]:
        """The settings of the run folder of one data set."""
        of = {"command": "assess", "dataset": absolute(dataset)}
        return self.asked() | of | {"dofs": list(data.dofs)}

    def run(
        self, run: RunFolder, data: PoseImageSet, n_jobs: int, progress: ProgressBar
    ) -> dict[str, Any]:
        """Go through what is not finished of the run; returns its summary."""
        assessment = run_assessment(
            run,
            data,
            families=self.families,
            regressor=self.regressor,
            seed=self.config.seed,
            tolerances=self.tolerances,
            label_errors=reported_pose_errors(data) | dict(self.pose_errors),
            compare=self.study,
            n_jobs=n_jobs,
            progress=progress,
        )
        return finish_run(
            run,
            data,
            self.config,
            n_jobs,
            assessment=assessment,
            study=self.study,
            progress=progress,
        )
