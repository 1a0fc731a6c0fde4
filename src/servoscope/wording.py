"""Words of sentences that are put together."""

from __future__ import annotations

from collections.abc import Sequence


def listing(words: Sequence[str]) -> str:
    """Words as a list in a sentence.

    Examples
    --------
    >>> listing(["Tx", "Ty", "Tz"])
    'Tx, Ty and Tz'
    """
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"
