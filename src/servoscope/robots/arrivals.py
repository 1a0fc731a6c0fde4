"""What arrives all the time, of which only what comes after a call is wanted."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition
from typing import Any


@dataclass(eq=False)
class _Wait:
    begin: float
    skip: int
    item: Any = None


class Arrivals:
    """Items that a thread puts, and others wait for.

    Examples
    --------
    >>> from threading import Timer
    >>> arrivals = Arrivals()
    >>> arrivals.put(lambda: "nobody waits for it, so that it is not made")
    >>> for n in range(3):
    ...     Timer(0.05 * (n + 1), arrivals.put, [lambda n=n: f"item {n}"]).start()
    >>> arrivals.after(time.monotonic(), skip=1, seconds=5.0)
    'item 1'
    """

    def __init__(self) -> None:
        self._changed = Condition()
        self._waits: list[_Wait] = []
        self._is_ended = False

    def put(self, make: Callable[[], Any]) -> None:
        """Note that one has arrived; it is made if somebody waits for it."""
        with self._changed:
            due = [wait for wait in self._waits if time.monotonic() >= wait.begin]
            ready = [wait for wait in due if wait.skip == 0 and wait.item is None]
            for wait in due:
                wait.skip = max(0, wait.skip - 1)
            if ready and (item := make()) is not None:
                for wait in ready:
                    wait.item = item
                self._changed.notify_all()

    def after(self, begin: float, skip: int, seconds: float) -> Any:
        """The first that arrives after a time, but for those that are skipped.

        Parameters
        ----------
        begin : float
            Of the monotonic clock, [s].
        skip : int
            How many are passed over.
        seconds : float
            How long they are waited for, from `begin`.

        Returns
        -------
        object
            None if none came, or none will come any more.
        """
        wait = _Wait(begin, skip)
        with self._changed:
            self._waits.append(wait)
            try:
                self._changed.wait_for(
                    lambda: wait.item is not None or self._is_ended,
                    max(0.0, begin + seconds - time.monotonic()),
                )
            finally:
                self._waits.remove(wait)
        return wait.item

    def end(self) -> None:
        """Nothing arrives any more."""
        with self._changed:
            self._is_ended = True
            self._changed.notify_all()
