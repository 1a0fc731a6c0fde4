import subprocess
import sys
from pathlib import Path

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


def test_an_unknown_benchmark_is_wrong_usage():
    done = run("mutual_informatoin")
    assert done.returncode == 2
    assert "no benchmark is named mutual_informatoin" in done.stderr
