"""The machine and the versions that timings hold for."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from threadpoolctl import threadpool_info

PACKAGES = (
    "servoscope",
    "numpy",
    "scipy",
    "scikit-learn",
    "numba",
    "opencv-python-headless",
    "scikit-image",
    "torch",
    "torch-levenberg-marquardt",
)


def describe_machine() -> dict[str, str]:
    """What a reader must know of the machine, by topic."""
    return {
        "Processor": f"{_processor()}, {os.cpu_count()} cores",
        "System": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "Versions": ", ".join(f"{p} {_version(p)}" for p in PACKAGES),
        "BLAS threads": ", ".join(sorted(_blas_threads())) or "unknown",
    }


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown processor"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _blas_threads() -> set[str]:
    return {
        f"{pool['internal_api']} {pool['num_threads']}"
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    }
