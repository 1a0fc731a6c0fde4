"""One question before a robot moves."""

from __future__ import annotations

import sys

from servoscope.errors import InvalidInputError, ServoscopeError
from servoscope.wording import printable


def check_can_ask(yes: bool) -> None:
    """See that a question could be answered, before anything is opened.

    Raises
    ------
    InvalidInputError
        If nobody sits at a terminal, and ``--yes`` is not given.
    """
    if not (yes or sys.stdin.isatty()):
        raise InvalidInputError(
            "A move must be confirmed at a terminal, and there is none; give --yes if the robot "
            "may move unasked, or --dry-run."
        )


def confirm(facts: str, yes: bool) -> None:
    """Say what is going to happen, and go on only if the user agrees.

    Raises
    ------
    ServoscopeError
        If the user does not.
    """
    print(printable(facts), file=sys.stderr)
    if yes:
        return
    print("Move the robot? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise ServoscopeError("Not confirmed; nothing was moved.")
