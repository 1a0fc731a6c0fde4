"""Options behind the name of a device: ``opencv:0?width=1280&gain=4``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import parse_qsl

from servoscope.errors import InvalidInputError
from servoscope.wording import listing


def split_options(
    text: str, types: Mapping[str, Callable[[str], Any]]
) -> tuple[str, dict[str, Any]]:
    """What stands before a question mark, and the options behind it.

    Parameters
    ----------
    text : str
        Such as ``0?width=1280&gain=4``. In an address with ``://`` a query with other names is
        part of the address.
    types : mapping of str to callable
        The options that there are, and what makes a value of a text, by ValueError if it cannot.

    Raises
    ------
    InvalidInputError
        If there is no such option, or it has no such value.

    Examples
    --------
    >>> split_options("0?width=1280", {"width": int})
    ('0', {'width': 1280})
    >>> split_options("rtsp://192.0.2.7/live?channel=1", {"width": int})
    ('rtsp://192.0.2.7/live?channel=1', {})
    """
    before, mark, query = text.rpartition("?")
    if not mark:
        return text, {}
    pairs = parse_qsl(query.replace(",", "&"), keep_blank_values=True)
    if "://" in before and not all(name in types for name, _ in pairs):
        return text, {}
    options: dict[str, Any] = {}
    for name, value in pairs:
        if name not in types:
            raise InvalidInputError(
                f"The options of {before!r} must be {listing(list(types))}, got {name!r}."
            )
        try:
            options[name] = types[name](value)
        except ValueError:
            raise InvalidInputError(
                f"The option {name} of {before!r} has no value {value!r}; see docs/robots.md."
            ) from None
    return before, options


def check_range(name: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """See that a number that was given is within its range.

    Raises
    ------
    InvalidInputError
        If it is not.

    Examples
    --------
    >>> check_range("delay", 0.5, 0, 60, "s")
    """
    if value is not None and not low <= value <= high:
        raise InvalidInputError(
            f"{name} must be from {low:g} to {high:g}{f' {unit}' if unit else ''}, got {value}."
        )
