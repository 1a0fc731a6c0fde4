"""What the scoreboard needs of a folder that remembers its stages, and of progress bars."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Protocol

Advance = Callable[[int], object]

ProgressBar = Callable[[str, int | None], AbstractContextManager[Advance]]
"""Opens a progress bar, given what is done and how many items that has, if known; yields the
function that is told how many are finished."""


class Stages(Protocol):
    """A folder that remembers which stages are finished."""

    path: Path

    def run_stage(
        self, name: str, inputs: Any, make: Callable[[], object], outputs: Sequence[str] = ()
    ) -> None:
        """Call ``make()``, unless it was called for the same inputs and has left its outputs."""

    def timings(self) -> dict[str, float]:
        """How long each stage took, and ``total``, [s]."""


def no_progress(description: str, total: int | None) -> AbstractContextManager[Advance]:
    """A progress bar that nobody sees."""
    return nullcontext(lambda n_done: None)
