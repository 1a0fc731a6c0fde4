"""The whole study, as its users run it."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.timing import Table, Timing


def tables(quick: bool) -> Iterator[Table]:
    """One table, a stage a row."""
    n_images, size = (200, 128) if quick else (1000, 256)
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "servoscope", "study", "--json"]
        command += ["--n-images", str(n_images), "--image-size", str(size)]
        command += ["--out", str(Path(folder) / "run")]
        # A first, small run fills the cache of compiled kernels.
        warm_up = ["--n-images", "144", "--image-size", "32", "--out", str(Path(folder) / "warm")]
        subprocess.run([*command[:5], *warm_up], check=True, capture_output=True)
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    stages = json.loads(done.stdout)["timings_s"]
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    yield Table(
        "The study",
        f"servoscope study, {n_images} images of {size} x {size}, both protocols, both forms "
        f"(targets: 60 s and 2 GB; images in 20 s); the largest process took {peak:.2f} GB",
        [Timing(stage, wall, None, False, "") for stage, wall in stages.items()],
    )
