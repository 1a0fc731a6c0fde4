"""What several tests need."""

import os
import signal
from pathlib import Path

# Tests run side by side: with more threads of BLAS than that each waits for the others.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import numpy as np
import pytest

from planar import planar_data_set
from servoscope.data.images import PoseImageSet

SHARED = Path(__file__).parents[2] / "shared"

# The first call of a numba kernel compiles it, and other machines are slower: no deadline. A few
# examples of each property show a fault as well as a hundred do, and the suite has hundreds.
hypothesis.settings.register_profile("servoscope", deadline=None, max_examples=25)
hypothesis.settings.load_profile("servoscope")

# What runs in the background is often started deaf to Ctrl-C, and so is all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first, so that none is left to one worker when the others are done."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator seeded alike for every test."""
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def plane() -> PoseImageSet:
    """150 images of 24 x 24 pixels of a textured plane."""
    return planar_data_set()


@pytest.fixture
def tum() -> Path:
    """The real sequence, where it is at hand."""
    return _at_hand(SHARED / "data" / "tum_fr1_rpy")


@pytest.fixture
def paper_text() -> str:
    """The paper, where it is at hand."""
    return _at_hand(SHARED / "paper" / "wells_torras_2001.txt").read_text(encoding="utf-8")


def _at_hand(path: Path) -> Path:
    if not path.exists():
        pytest.skip(f"needs {path.relative_to(SHARED.parent)} beside the project")
    return path
