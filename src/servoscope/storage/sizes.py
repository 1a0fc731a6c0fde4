"""Sizes of memory, as people write them."""

import re

from servoscope.errors import InvalidInputError

DEFAULT_MEMORY = "1GB"
"""What a command keeps in memory at once, by default."""

_UNITS = {"": 1.0, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12}


def parse_bytes(text: str) -> float:
    """Bytes that a text such as 500MB names.

    Raises
    ------
    InvalidInputError
        If it names none, or less than 1 MB.

    Examples
    --------
    >>> parse_bytes("1.5 GB")
    1500000000.0
    """
    found = re.fullmatch(r"(\d+(?:\.\d*)?)\s*([KMGT]?)I?B?", text.strip().upper())
    n_bytes = float(found[1]) * _UNITS[f"{found[2]}B" if found[2] else ""] if found else 0.0
    if n_bytes < 1e6:
        raise InvalidInputError(f"memory must be 1MB or more, such as 500MB or 4GB, got {text!r}.")
    return n_bytes
