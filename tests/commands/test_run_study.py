"""What ``study`` and ``assess`` print at their end."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.commands.run_study import print_run
from servoscope.poses import DOFS
from servoscope.study import Study, StudyConfig, open_run_folder


def test_a_dof_that_never_moves_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = planar_data_set(144, 24)
    poses = data.T_world_cam.copy()
    poses[:, 2, 3] = data.T_world_ref[2, 3]
    config = StudyConfig(hidden=4, restarts=1, n_thresholds=5, protocols=("honest",))
    run = open_run_folder(tmp_path / "run", {})
    Study(run, replace(data, T_world_cam=poses), config, n_jobs=1).run()
    summary = json.loads((run.path / "summary.json").read_text())
    print_run(summary, run.path, json=False)
    told = capsys.readouterr().out
    table = told[told.index("camera form") :].splitlines()
    (still,) = (line for line in table if "none: the mean" in line)
    cells = [cell.strip() for cell in still.strip("\u2502").split("\u2502")]
    assert cells[3] == "-"
    baseline = summary["protocols"]["honest"]["camera"]["baseline"]
    assert float(cells[7]) == pytest.approx(
        np.mean([baseline[dof]["rms"] for dof in DOFS if dof != "tz"]), abs=6e-4
    )
    assert "-" not in (*cells[1:3], *cells[4:])
