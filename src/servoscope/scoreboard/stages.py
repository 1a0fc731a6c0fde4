"""What the scoreboard needs of a folder that remembers its stages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol


class Stages(Protocol):
    """A folder that remembers which stages are finished."""

    path: Path

    def run_stage(
        self, name: str, inputs: Any, make: Callable[[], object], outputs: Sequence[str] = ()
    ) -> None:
        """Call ``make()``, unless it was called for the same inputs and has left its outputs."""

    def timings(self) -> dict[str, float]:
        """How long each stage took, and ``total``, [s]."""
