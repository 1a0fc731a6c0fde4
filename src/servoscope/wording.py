"""Words of sentences that are put together, and of what others have written."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal


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


def one_line(value: object, longest: int = 300) -> str:
    r"""A value, or the message of an exception, on one line that any terminal can show.

    An exception without a message, or whose message cannot be had, is named by its kind.

    Examples
    --------
    >>> one_line("two\n lines\x1b[2J"), one_line(ValueError()), one_line("cut short", longest=8)
    ('two lines?[2J', 'ValueError', 'cut s...')
    """
    try:
        text = str(value)
    except BaseException:
        text = ""
    text = printable(" ".join(text.split())) or type(value).__name__
    return text if len(text) <= longest else text[: longest - 3] + "..."


def printable(text: str) -> str:
    r"""A text with a question mark for each character that a terminal would take for a command.

    That is whatever Python does not call printable: control characters, those that turn the
    direction of writing, and halves of surrogate pairs. Ends of lines stay, other white space
    becomes blanks.

    Examples
    --------
    >>> printable("a\x1b[2J\tb")
    'a?[2J b'
    """
    return "".join(c if c.isprintable() or c == "\n" else " " if c.isspace() else "?" for c in text)


def plain_number(value: float) -> str:
    """Two significant digits, without an exponent.

    Examples
    --------
    >>> plain_number(113.4), plain_number(0.00456), plain_number(0.5)
    ('110', '0.0046', '0.5')
    """
    return f"{Decimal(f'{value:.2g}'):f}"
