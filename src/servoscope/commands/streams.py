"""Standard streams take every text: closed ones, and those of an encoding that lacks much."""

from __future__ import annotations

import codecs
import os
import sys
from errno import ENOSPC

from servoscope.errors import ServoscopeError
from servoscope.wording import one_line

_LONGEST_MESSAGE, _LONGEST_REASON = 10_000, 2000

_PLAIN = {
    **dict.fromkeys("─━═╌╴╶╸╺–—", "-"),
    **dict.fromkeys("│┃║╎", "|"),
    **dict.fromkeys("╭╮╰╯┌┐└┘├┤┬┴┼┏┓┗┛┡┩╇┣┫┳┻╋┠┨┯┷", "+"),
    **dict.fromkeys("•●▲□", "*"),
    "±": "+-",
    "°": " deg",
    "×": "x",
    "µ": "u",
    "μ": "u",
    "…": "...",
    "→": "->",
    "←": "<-",
    "≤": "<=",
    "≥": ">=",
    "≈": "~",
    "−": "-",
    "’": "'",
    "‘": "'",
    "“": '"',
    "”": '"',
}
"""What is written where an encoding lacks a character; of any other, its number."""


def prepare_streams() -> None:
    """Open those of the standard streams that are closed, and let none fail on a character."""
    codecs.register_error("servoscope.plain", _plainly)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:
            # The lowest number that is free, so that no other file is taken for it.
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif mode == "w" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="servoscope.plain")


def discard_unwritten() -> None:
    """Forget what a standard stream cannot write, so that the end of the process does not fail."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _plainly(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    plain = "".join(
        _PLAIN.get(c) or c.encode("ascii", "backslashreplace").decode() for c in lacking
    )
    return plain, error.end


def print_message(message: str) -> None:
    """Print a line on standard error."""
    print(one_line(message, _LONGEST_MESSAGE), file=sys.stderr)


def reason_of(error: Exception) -> str:
    """Why a command failed, on one line."""
    message = one_line(error, _LONGEST_REASON)
    if isinstance(error, ServoscopeError):
        return message
    if isinstance(error, MemoryError):
        return "out of memory; ask for fewer or smaller images"
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        full = "; free some and repeat the command, a run with --resume"
        return f"{where}{error.strerror or message}{full if error.errno == ENOSPC else ''}"
    return f"unexpected {type(error).__name__}: {message}; --debug shows where it came from"
