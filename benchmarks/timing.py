"""Timing several tools in turns, so that what disturbs one disturbs all."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

SECONDS_EACH = 10.0
"""A tool that has run this long does not start another repeat."""


@dataclass(frozen=True)
class Contender:
    """One tool and the work that it does.

    Parameters
    ----------
    name : str
    run : callable
        Does the work, or a part of it.
    scale : float
        The whole work over the part that `run` does; its time is scaled up by this and called an
        estimate if it is not 1.
    remark : str
        What a reader must know to compare it.
    """

    name: str
    run: Callable[[], object]
    scale: float = 1.0
    remark: str = ""


@dataclass(frozen=True)
class Timing:
    """Median times of one tool, [s]; processor time is None where several processes share it."""

    name: str
    wall: float
    cpu: float | None
    estimated: bool
    remark: str


@dataclass(frozen=True)
class Table:
    """Timings of one job; the first one is ours."""

    title: str
    job: str
    timings: Sequence[Timing]

    def ratio(self, timing: Timing) -> float | None:
        """How many times our processor time the tool takes."""
        ours = self.timings[0].cpu
        return None if timing.cpu is None or ours is None else timing.cpu / ours


def race(contenders: Sequence[Contender], repeats: int) -> list[Timing]:
    """Time every contender once a round, after a warm-up that counts for nothing."""
    clocks: list[list[tuple[float, float]]] = [[] for _ in contenders]
    for contender in contenders:
        contender.run()
    for _ in range(repeats):
        for contender, times in zip(contenders, clocks, strict=True):
            if sum(wall for wall, _ in times) < SECONDS_EACH:
                times.append(_time_once(contender.run))
    return [
        Timing(
            contender.name,
            wall=contender.scale * median(wall for wall, _ in times),
            cpu=contender.scale * median(cpu for _, cpu in times),
            estimated=contender.scale != 1.0,
            remark=contender.remark,
        )
        for contender, times in zip(contenders, clocks, strict=True)
    ]


def _time_once(run: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - wall, time.process_time() - cpu
