"""The families side by side, on a set so small that the figures mean little."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from planar import planar_data_set

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("families")
    planar_data_set(40, size=24).save(folder / "planar")
    command = [sys.executable, "-m", "benchmarks.families", str(folder / "planar")]
    done = subprocess.run(
        [*command, "--figure", str(folder / "families.png")],
        cwd=ROOT,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (folder / "families.png").stat().st_size > 10_000
    return done.stdout


def table(page, title):
    """Cells of the rows of a table by family."""
    text = page.split(f"## {title}\n")[1].split("\n## ")[0]
    rows = [re.split(r" *\| *", line)[1:-1] for line in text.splitlines() if line.startswith("|")]
    return {row[0]: row[1:] for row in rows[2:]}


def test_the_mean_is_that_of_the_six_and_rows_are_in_its_order(page):
    rows = table(page, "Clean images")
    means = [float(cells[7]) for cells in rows.values()]
    assert means == sorted(means)
    for cells in rows.values():
        assert sum(map(float, cells[1:7])) / 6 == pytest.approx(float(cells[7]), abs=1e-4)


def test_gain_changes_normalised_families_little_and_sliced_moments_much(page):
    worst = {
        name: float(cells[0].split()[0])
        for name, cells in table(page, "What a disturbance does to the worst dof").items()
    }
    assert worst["projections"] < 1.5
    assert worst["intensity"] < 1.5
    assert worst["moments"] > 2


def test_what_disturbs_is_shown_beside_the_same_clean_error(page):
    clean = {name: float(cells[7]) for name, cells in table(page, "Clean images").items()}
    disturbed = table(page, "Disturbed images")
    assert {name: float(cells[0]) for name, cells in disturbed.items()} == pytest.approx(
        clean, abs=6e-4
    )
    for name in ("projections", "intensity"):
        assert float(disturbed[name][6]) > 1.4 * clean[name]
