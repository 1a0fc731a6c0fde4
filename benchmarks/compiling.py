"""What the first run of a command compiles, kernel by kernel.

``python -m benchmarks compiling``. The command runs in a process of its own with an empty cache;
the times are those of its processor.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.tables import Findings

N_SHOWN = 6

_CODE = """
import json, sys, time
from numba.core import event

class Listener(event.Listener):
    begun, spent = [], []
    def on_start(self, begin):
        self.begun.append(time.process_time())
    def on_end(self, end):
        seconds = time.process_time() - self.begun.pop()
        if not self.begun:  # what a kernel calls counts in it
            name = end.data["dispatcher"].py_func
            self.spent.append((seconds, f"{name.__module__}.{name.__qualname__}"))

event.register("numba:compile", Listener())
from servoscope.cli import main
code = main(sys.argv[2:])
open(sys.argv[1], "w").write(json.dumps(Listener.spent))
sys.exit(code)
"""


def compiled_by(place: Path, *arguments: object) -> list[tuple[float, str]]:
    """Processor seconds and name of each kernel that a command compiles, the longest first."""
    found = place / "kernels.json"
    subprocess.run(
        [sys.executable, "-c", _CODE, str(found), *map(str, arguments), "--jobs", "1"],
        env={**os.environ, "NUMBA_CACHE_DIR": str(place / "cache")},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
    )
    return sorted(((s, name) for s, name in json.loads(found.read_text())), reverse=True)


def tables(quick: bool) -> Iterator[Findings]:
    """One table a command."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        part = ("--part", "textured_plane") if quick else ()
        commands = [("acquire", place / "data", "--n-images", 16, "--image-size", 64, *part)]
        if not quick:
            commands.append(("train", place / "data", "--out", place / "model"))
        for command in commands:
            kernels = compiled_by(place, *command)
            yield Findings(
                f"Compiled by {command[0]}",
                f"{len(kernels)} kernels in {sum(s for s, _ in kernels):.1f} s of processor time, "
                "those that are not yet compiled by the commands above it",
                ("kernel", "seconds"),
                [(name, f"{seconds:.2f}") for seconds, name in kernels[:N_SHOWN]],
            )
