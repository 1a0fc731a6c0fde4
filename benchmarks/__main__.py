"""``python -m benchmarks [NAMES] [--quick] [--markdown FILE]``."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

from benchmarks.machine import describe_machine
from benchmarks.tables import as_page, as_text

KERNELS = (
    "floors",
    "mutual_information",
    "moments",
    "pca",
    "levenberg_marquardt",
    "sweep",
    "forecast",
    "regressors",
    "images",
    "compiling",
    "study",
    "photometric",
    "faults",
    "keyframe",
    "decision",
    "few_images",
    "rehearsal",
    "next_images",
    "rendered_ranking",
    "recorded",
    "intervals",
    "many_images",
    "many_sets",
)


def main() -> None:
    """Run the named benchmarks, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(KERNELS)}")
    parser.add_argument("--quick", action="store_true", help="smaller data and fewer repeats")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write a page as well")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(KERNELS))
    if unknown:
        parser.error(f"no benchmark is named {', '.join(unknown)}; there are {', '.join(KERNELS)}")
    kernels = [import_module(f"benchmarks.{name}") for name in options.names or KERNELS]
    machine = describe_machine()
    print("\n".join(f"{topic}: {text}" for topic, text in machine.items()))
    tables = []
    for kernel in kernels:
        print(f"running {kernel.__name__} ...", file=sys.stderr)
        for table in kernel.tables(options.quick):
            print(f"\n{as_text(table)}", flush=True)
            tables.append(table)
    if options.markdown:
        command = " ".join([".venv/bin/python -m benchmarks", *sys.argv[1:]])
        options.markdown.write_text(as_page(machine, tables, command), encoding="utf-8")


if __name__ == "__main__":
    main()
