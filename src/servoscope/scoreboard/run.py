"""The scoreboard, in stages that are each done once."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from dataclasses import asdict
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from servoscope import __version__
from servoscope.errors import RunFolderError
from servoscope.positioning import Estimator
from servoscope.processes import ProgressBar, in_processes, no_progress
from servoscope.scoreboard.cell import CONDITIONS, SCENES
from servoscope.scoreboard.methods import loop_settings
from servoscope.scoreboard.plan import Factory, Plan, Stages
from servoscope.scoreboard.summary import check_targets, summarise
from servoscope.scoreboard.trial import Trial, run_start
from servoscope.storage.folders import write_json
from servoscope.storage.reading import read_json

TRIALS_PER_CALL = 5
"""Starts that a process is given at once: the estimator is sent along with them."""


class Scoreboard:
    """The comparison of all methods; `run` goes through what is not finished yet.

    Images, models, trials and ``scoreboard.json`` are written in the folder. Every number of
    processes gives the same trials, but for the time that decisions take.
    """

    def __init__(
        self,
        folder: Stages,
        plan: Plan,
        *,
        n_jobs: int = -1,
        progress: ProgressBar = no_progress,
    ) -> None:
        self.folder, self.plan = folder, plan
        self.n_jobs, self.progress = n_jobs, progress

    def run(self) -> dict[str, Any]:
        """Take images, train, run all trials, and write ``scoreboard.json``.

        Returns
        -------
        dict
            ``results[scene][condition][method]`` of `summarise`, ``targets``, and how it was made.
        """
        inputs = {"plan": asdict(self.plan), "servoscope": __version__}
        robots: dict[tuple[str, tuple[str, ...]], list[str]] = {}
        for name in self.plan.conditions:
            robots.setdefault((CONDITIONS[name].robot, CONDITIONS[name].dofs), []).append(name)
        for scene, ((robot, dofs), conditions) in product(SCENES, robots.items()):
            factory = Factory(
                self.folder, self.plan, scene, robot, dofs,
                n_jobs=self.n_jobs, progress=self.progress,
            )  # fmt: skip
            factory.prepare()
            for condition in conditions:
                run_trials = partial(self._run_trials, factory, condition)
                path = _trials_file(scene, condition)
                self.folder.run_stage(f"trials_{path.stem}", inputs, run_trials, [str(path)])
        scoreboard = self._summary()
        write_json(self.folder.path / "scoreboard.json", scoreboard)
        return scoreboard

    def trials(self, scene: str) -> dict[str, dict[str, list[Trial]]]:
        """The finished trials of a scene, by condition and method.

        Raises
        ------
        RunFolderError
            If some are missing or damaged.
        """
        read = {name: self._read_trials(scene, name) for name in self.plan.conditions}
        for condition, by_method in read.items():
            for method in self.plan.methods(condition):
                if not self.plan.n_trials(scene, condition, method):
                    by_method[method] = read["range_1.0"][method]
        return {
            name: {m: read[name][m] for m in self.plan.methods(name)}
            for name in self.plan.conditions
        }

    def _run_trials(self, factory: Factory, condition: str) -> None:
        calls = list(self._calls(factory, condition))
        trials: dict[str, list[dict[str, Any]]] = {}
        n_done, total = 0, sum(len(starts) for _, starts, *_ in calls)
        with self.progress(f"{factory.scene}, {condition}", total) as advance:
            blocks = in_processes(_run_block, calls, self.n_jobs, max_nbytes=None)
            for (method, *_), block in zip(calls, blocks, strict=True):
                trials.setdefault(method, []).extend(trial.to_dict() for trial in block)
                n_done += len(block)
                advance(n_done)
        path = self.folder.path / _trials_file(factory.scene, condition)
        path.parent.mkdir(exist_ok=True)
        write_json(path, trials)

    def _calls(self, factory: Factory, condition: str) -> Iterator[tuple[Any, ...]]:
        """The arguments of `_run_block`, those that take longest first."""
        changes = CONDITIONS[condition]
        where = factory.scene, condition, self.plan.image_size, self.plan.seed
        for method in reversed(self.plan.methods(condition)):
            n_trials = self.plan.n_trials(factory.scene, condition, method)
            if not n_trials:
                continue
            estimator = factory.estimator(method, changes.depth_factor)
            settings = loop_settings(method, changes.repeatability)
            step = 1 if method == "photometric" else TRIALS_PER_CALL
            for first in range(0, n_trials, step):
                starts = range(first, min(first + step, n_trials))
                yield method, starts, where, estimator, settings

    def _read_trials(self, scene: str, condition: str) -> dict[str, list[Trial]]:
        path = self.folder.path / _trials_file(scene, condition)
        try:
            values = read_json(path, RunFolderError)
            return {method: [Trial(**v) for v in values[method]] for method in values}
        except TypeError as error:
            raise RunFolderError(f"{path} is damaged ({error}); repeat with --force.") from error

    def _summary(self) -> dict[str, Any]:
        trials = {scene: self.trials(scene) for scene in SCENES}
        targets = [t for scene in SCENES for t in check_targets(scene, trials[scene])]
        return {
            "servoscope": __version__,
            "seed": self.plan.seed,
            "starts": self.plan.n_starts,
            "quick": self.plan.quick,
            "image_size": self.plan.image_size,
            "schedules": dict(self.plan.schedules),
            "machine": {"cores": os.cpu_count(), "python": platform.python_version()},
            "timings_s": self.folder.timings(),
            "targets": [target.to_dict() for target in targets],
            "results": {
                scene: {
                    condition: {method: summarise(t) for method, t in by_method.items()}
                    for condition, by_method in trials[scene].items()
                }
                for scene in SCENES
            },
        }


def _trials_file(scene: str, condition: str) -> Path:
    return Path("trials") / f"{scene}_{condition}.json"


def _run_block(
    method: str,
    starts: range,
    where: tuple[str, str, int, int],
    estimator: Estimator,
    settings: Any,
) -> list[Trial]:
    """The trials of some starts."""
    return [run_start(*where, start, estimator, settings) for start in starts]
