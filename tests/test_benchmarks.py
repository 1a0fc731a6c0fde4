import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


def run(*arguments):
    command = [sys.executable, "-m", "benchmarks", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_a_benchmark_prints_its_table_and_writes_it_as_markdown(tmp_path):
    page = tmp_path / "page.md"
    done = run("mutual_information", "--quick", "--markdown", page)
    assert done.returncode == 0, done.stderr
    assert "Processor:" in done.stdout
    for tool in ("servoscope", "numpy.histogram2d", "sklearn mutual_info_score"):
        assert tool in done.stdout
        assert f"| {tool} |" in page.read_text()


NAMES = {path.stem for path in (ROOT / "benchmarks").glob("*.py")} - {"__main__"}


@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_benchmark_imports_what_there_is(name, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    importlib.import_module(f"benchmarks.{name}")


def test_an_unknown_benchmark_is_wrong_usage():
    done = run("mutual_informatoin")
    assert done.returncode == 2
    assert "no benchmark is named mutual_informatoin" in done.stderr


def test_for_linear_gaussian_data_the_joint_entropy_power_is_the_noise(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    entropy_power = importlib.import_module("benchmarks.entropy_power").entropy_power
    rng = np.random.default_rng(0)
    X, noise = rng.normal(size=(4000, 9)), 0.5 * rng.normal(size=4000)
    limits = entropy_power(X, X.sum(axis=1) + noise)
    assert limits.joint[0] == pytest.approx(0.5, rel=0.05)
    assert limits.single[0] == pytest.approx(np.sqrt(8 + 0.25), rel=0.06)
    without = entropy_power(np.ones((2000, 2)), rng.normal(0, 4, 2000))
    assert (without.single[0], without.joint[0]) == pytest.approx((4.0, 4.0), rel=0.05)
