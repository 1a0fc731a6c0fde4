"""How long work says how far it is, whoever shows it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

Advance = Callable[[int], object]
"""Called with the number of items that are finished."""

ProgressBar = Callable[[str, int | None], AbstractContextManager[Advance]]
"""Opens a progress bar, given what is done and how many items that has; yields an `Advance`."""


def no_progress(description: str, total: int | None) -> AbstractContextManager[Advance]:
    """A progress bar that nobody sees."""
    return nullcontext(lambda n_done: None)
