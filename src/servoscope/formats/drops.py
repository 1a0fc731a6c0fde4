"""What an import left out, and why."""

from __future__ import annotations

from collections.abc import Iterable

NO_POSE = "without a pose near in time"
BAD_POSE = "with an unusable pose"
EQUAL_STAMPS = "stamps of several poses"
BAD_IMAGE = "with an unusable image"
FAR = "far from the reference"
HELD_POSE = "with a pose that stays while the image changes"

_NAMES_SHOWN = 3


class Drops:
    """Names of what was left out, by reason.

    Examples
    --------
    >>> drops = Drops()
    >>> drops.add(BAD_IMAGE, ["left/0007.png"])
    >>> drops.counts()
    {'with an unusable image': 1}
    >>> print(drops)
    1 with an unusable image (left/0007.png)
    """

    def __init__(self) -> None:
        self._names: dict[str, dict[str, None]] = {}

    def add(self, reason: str, names: Iterable[str]) -> None:
        """Note that these were left out for this reason; each name counts once."""
        if names := dict.fromkeys(names):
            self._names.setdefault(reason, {}).update(names)

    def counts(self) -> dict[str, int]:
        """How many were left out, by reason."""
        return {reason: len(names) for reason, names in self._names.items()}

    def __str__(self) -> str:
        return ", ".join(
            f"{len(names)} {reason}{_examples(list(names)) if reason != FAR else ''}"
            for reason, names in self._names.items()
        )


def _examples(names: list[str]) -> str:
    shown = names if len(names) <= _NAMES_SHOWN else [*names[: _NAMES_SHOWN - 1], "..."]
    return f" ({', '.join(shown)})"
