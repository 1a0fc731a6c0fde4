"""Wrong usage, said in one line with the nearest name that there is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

from servoscope.wording import one_line

_RULE = re.compile(r"\s*[─-]{9,}\s*")
_BORDER = re.compile(r"^│(.*)│$|^ ?[╭╰].*$", re.MULTILINE)
_UNKNOWN = "Unrecognized options: "
_FLAG = re.compile(r"--[\w-]+")
_PARSER = re.compile(r"^Error parsing __[\w.-]+: ")
_NEITHER = re.compile(
    r"^Error parsing (--[\w-]+): no type matching \{None\}\|(\w+) could .*? from \['(.*?)'\]\. .*$"
)
_CHOICES = re.compile(r"(?<=Expected one of )\('[^()]*'\)")


def nearest(name: str, names: Iterable[str]) -> str:
    """A question for what is meant most likely; nothing where no name is near.

    Examples
    --------
    >>> nearest("--schedul", ["--seed", "--schedule"]), nearest("fly", ["train"])
    (' Did you mean --schedule?', '')
    """
    close = get_close_matches(name, names, n=1)
    return f" Did you mean {close[0]}?" if close else ""


def usage_line(box: str, command: str) -> str:
    r"""What the parser of arguments says in a box of several lines, in one.

    Examples
    --------
    >>> box = "│ Unrecognized options: --sed, 3 │\n│ ──────────── │\n│ --seed INT     │"
    >>> usage_line(box, "servoscope study")
    'study has no option --sed. Did you mean --seed? See servoscope study --help.'
    >>> usage_line("invalid choice 'ft'. Expected one of ('None', 'mm', 'm').", "servoscope aim")
    "invalid choice 'ft'. Expected one of 'm', 'mm'. See servoscope aim --help."
    """
    said, hints = _sections(box)
    said = _PARSER.sub("", _NEITHER.sub(r"\1 must be \2, got '\3'", said))
    see = f"See {command} --help."
    if not said.startswith(_UNKNOWN):
        return one_line(f"{_CHOICES.sub(_in_order, said).rstrip('.! ')}. {see}")
    unknown = said.removeprefix(_UNKNOWN).split(", ")
    options = [text for text in unknown if text.startswith("-")]
    name = command.removeprefix("servoscope ")
    if not options:
        return one_line(f"{name} has no place for {unknown[0]!r}. {see}")
    near = nearest(options[0], _FLAG.findall(hints))
    return one_line(f"{name} has no option {options[0]}.{near} {see}")


def _in_order(choices: re.Match[str]) -> str:
    """The choices of an option, of which leaving it out is none."""
    return ", ".join(sorted(set(re.findall(r"'[^']*'", choices[0])) - {"'None'"}))


def _sections(box: str) -> tuple[str, str]:
    """The words before the first rule of a box, and what follows.

    Where no lines can be drawn, a box is a title, a rule, and the same without borders.
    """
    inside = [line for line in _BORDER.sub(r"\1", box).splitlines() if line.strip()]
    if "│" not in box:
        inside = inside[2:]
    rule = next((i for i, line in enumerate(inside) if _RULE.fullmatch(line)), len(inside))
    first, *rest = inside[:rule] or [box]
    indent = min(map(_indent, rest), default=0)
    said = [first, *(line for line in rest if _indent(line) == indent)]
    return " ".join(map(str.strip, said)), "\n".join(inside[rule:])


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())
