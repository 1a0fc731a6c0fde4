"""The paper's study of a data set, in stages that are each done once."""

from __future__ import annotations

from dataclasses import asdict
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope import __version__
from servoscope.data.images import PoseImageSet
from servoscope.data.independence import split_data
from servoscope.data.splits import Split
from servoscope.errors import InvalidInputError
from servoscope.features import GeometricMoments, compute_image_basis
from servoscope.pipeline import FeatureTable
from servoscope.poses import DISPLACEMENTS, DOFS
from servoscope.processes import ProgressBar, no_progress
from servoscope.storage.folders import write_arrays, write_json, write_text
from servoscope.storage.run_folder import RunFolder, read_arrays, read_json
from servoscope.study.information import (
    Assessment,
    FeaturePictures,
    assess_features,
    compute_feature_table,
    measure_chance,
    rankings_as_csv,
    study_table,
)
from servoscope.study.networks import choose_best, plan_sweeps, summarise, train_study_nets
from servoscope.study.paper import FAMILIES, N_EIGENVECTORS, StudyConfig, check_n_images

Unit = tuple[str, str]
"""A protocol and a displacement form."""


class Study:
    """The study of one data set in a run folder; `run` goes through what is not finished yet.

    Parameters
    ----------
    folder : RunFolder
    data : PoseImageSet
    config : StudyConfig
    split : Split, optional
        Images that train, decide and test; drawn at random by default, independent groups as a
        whole.

    Raises
    ------
    InvalidInputError
        If there are too few images.
    """

    def __init__(
        self,
        folder: RunFolder,
        data: PoseImageSet,
        config: StudyConfig,
        *,
        split: Split | None = None,
        n_jobs: int = -1,
        progress: ProgressBar = no_progress,
    ) -> None:
        if split is None:
            check_data(data, config)
        self.folder, self.data, self.config, self.given = folder, data, config, split
        self.n_jobs, self.progress = n_jobs, progress
        self.units: list[Unit] = [(p, d) for p in config.protocols for d in DISPLACEMENTS]

    def run(self) -> None:
        """Compute features, assess them, train the nets, and write ``summary.json``."""
        inputs = self.inputs
        names = ["_".join(unit) for unit in self.units]
        features = ["features.npz", *(f"vectors/{name}.npz" for name in names)]
        self.folder.run_stage("features", inputs, self._compute_features, features)
        ranking = ["ranking.csv", "selection.npz"]
        self.folder.run_stage("assessment", inputs, self._assess, ranking)
        self.folder.run_stage("chance", inputs, self._measure_chance, ["chance.json"])
        for unit, name in zip(self.units, names, strict=True):
            models = [f"models/{name}.npz", f"models/{name}.json"]
            train = partial(self._train, unit)
            self.folder.run_stage(f"networks_{name}", inputs, train, models)
        write_json(self.folder.path / "summary.json", self._summary())

    @cached_property
    def inputs(self) -> dict[str, Any]:
        """What every stage depends on."""
        return {
            "data": self.data.fingerprint(),
            "config": asdict(self.config),
            **({} if self.given is None else {"test": self.given.test.tolist()}),
            "servoscope": __version__,
        }

    def split(self, protocol: str) -> Split:
        """The images that train, decide and test."""
        if self.given is not None:
            test = self.given.test
            return self.given if protocol == "honest" else Split(self.given.learned, test, test)
        return split_data(self.data, protocol, self.config.seed)

    def targets(self, displacement: str) -> NDArray[np.float64]:
        """Displacements scaled to [-1, 1]; exactly 0 for a dof that never moves."""
        targets = self.data.delta_p(displacement) / self.data.ranges(displacement)
        return np.where(self.data.moves(displacement), targets, 0.0)

    @cached_property
    def tables(self) -> dict[Unit, FeatureTable]:
        """The feature tables that the first stage left in ``features.npz``."""
        keys = ["_".join(unit) for unit in self.units]
        arrays = read_arrays(self.folder.path / "features.npz", ["names", *keys])
        names = tuple(map(str, arrays["names"]))
        return {
            unit: study_table(arrays[key], names)
            for unit, key in zip(self.units, keys, strict=True)
        }

    @cached_property
    def assessments(self) -> dict[Unit, Assessment]:
        """What mutual information says of the candidates, by protocol and form."""
        return {
            (protocol, displacement): assess_features(
                self.tables[protocol, displacement],
                self.targets(displacement),
                self._assessed(protocol),
                n_bins=self.config.n_bins,
                n_ranked=self.config.n_ranked,
            )
            for protocol, displacement in self.units
        }

    def _compute_features(self) -> None:
        moments = GeometricMoments().fit_transform(self.data.images)
        arrays: dict[str, Any] = {"reference_image": self.data.reference_image}
        arrays |= {f"delta_p_{form}": self.data.delta_p(form) for form in DISPLACEMENTS}
        pictures = self.folder.path / "vectors"
        pictures.mkdir(exist_ok=True)
        protocols = self.config.protocols
        with self.progress("features", len(protocols)) as advance:
            for n_done, protocol in enumerate(protocols, start=1):
                for unit, (table, shown) in self._tables_of(moments, protocol).items():
                    arrays["_".join(unit)] = table.values
                    arrays["names"] = np.array(table.names)
                    write_arrays(pictures / "{}_{}.npz".format(*unit), vars(shown))
                advance(n_done)
        write_arrays(self.folder.path / "features.npz", arrays)

    def _tables_of(
        self, moments: NDArray[np.float64], protocol: str
    ) -> dict[Unit, tuple[FeatureTable, FeaturePictures]]:
        train = self.split(protocol).train
        basis = compute_image_basis(self.data.images[train], N_EIGENVECTORS)
        return {
            (protocol, form): compute_feature_table(self.data, moments, basis, train, form)
            for form in DISPLACEMENTS
        }

    def _assess(self) -> None:
        write_text(self.folder.path / "ranking.csv", rankings_as_csv(self.assessments))
        redundancies = {
            f"{protocol}_{displacement}_{dof}": ranking.candidate_redundancy
            for (protocol, displacement), assessment in self.assessments.items()
            for dof, ranking in assessment.rankings.items()
        }
        write_arrays(self.folder.path / "selection.npz", redundancies)

    def _measure_chance(self) -> None:
        found: dict[str, dict[str, Any]] = {protocol: {} for protocol in self.config.protocols}
        for protocol, displacement in self.units:
            found[protocol][displacement] = measure_chance(
                self.assessments[protocol, displacement],
                self.tables[protocol, displacement],
                self.targets(displacement),
                in_order_of_time(self.data, self._assessed(protocol)),
                in_sequence=self.data.split == "blocks",
                n_bins=self.config.n_bins,
            )
        write_json(self.folder.path / "chance.json", found)

    def _assessed(self, protocol: str) -> NDArray[np.intp]:
        """The images from which mutual information is taken."""
        return np.arange(len(self.data)) if protocol == "paper" else self.split(protocol).train

    def _train(self, unit: Unit) -> None:
        protocol, displacement = unit
        table, assessment, split = self.tables[unit], self.assessments[unit], self.split(protocol)
        ranges = self.data.ranges(displacement)
        targets = self.targets(displacement)
        sweeps = plan_sweeps(assessment, self.config.thresholds)
        n_nets = len(FAMILIES) * len(DOFS) + sum(map(len, sweeps.values()))
        with self.progress(f"nets ({protocol}, {displacement})", n_nets) as advance:
            nets = train_study_nets(
                table,
                targets,
                split,
                sweeps,
                self.config,
                n_jobs=self.n_jobs,
                on_progress=advance,
            )
        best = {dof: choose_best(points).trained for dof, points in nets.sweeps.items()}
        arrays = {
            f"{dof}.{name}": array
            for dof, trained in best.items()
            for name, array in (
                {"columns": trained.columns} | trained.regressor.to_arrays()
            ).items()
        }
        path = self.folder.path / "models" / "_".join(unit)
        path.parent.mkdir(exist_ok=True)
        write_arrays(path.with_suffix(".npz"), arrays)
        results = summarise(assessment, nets, targets, split, ranges)
        write_json(path.with_suffix(".json"), results)

    def _summary(self) -> dict[str, Any]:
        chance = read_json(self.folder.path / "chance.json")
        return describe_run(self.folder, self.data) | {
            "protocols": {
                protocol: {
                    displacement: read_json(
                        self.folder.path / "models" / f"{protocol}_{displacement}.json"
                    )
                    | chance[protocol][displacement]
                    for displacement in DISPLACEMENTS
                }
                for protocol in self.config.protocols
            },
        }


def describe_run(folder: RunFolder, data: PoseImageSet) -> dict[str, Any]:
    """What a summary says whatever was found: of what, with which settings, and in which time."""
    return {
        "version": 1,
        "servoscope": __version__,
        "dataset": {
            "n_images": len(data),
            "image_shape": data.image_shape,
            "pivot_mm": 1e3 * data.pivot,
            "split": data.split,
            "source": data.source,
        },
        "settings": folder.settings,
        "timings_s": folder.timings(),
    }


def in_order_of_time(data: PoseImageSet, images: NDArray[np.intp]) -> NDArray[np.intp]:
    """Images in the order in which they were taken, as far as that is known."""
    ordered = np.sort(images)
    if data.times is None:
        return ordered
    return np.asarray(ordered[np.argsort(data.times[ordered], kind="stable")])


def check_data(data: PoseImageSet, config: StudyConfig) -> None:
    """Raise InvalidInputError unless a data set has enough images for a study."""
    check_n_images(len(data), config.protocols)
    for protocol in config.protocols:
        n_train = len(split_data(data, protocol, config.seed).train)
        if n_train <= N_EIGENVECTORS:
            raise InvalidInputError(
                f"A study needs more than {N_EIGENVECTORS} images that train, to find as many "
                f"eigenvectors; of the {len(data)} only {n_train} do. Use more images."
            )
