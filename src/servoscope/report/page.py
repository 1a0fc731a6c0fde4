"""A page: one HTML file that needs neither a network nor the rest of its folder."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from servoscope.report.table import Table
from servoscope.storage.folders import write_text


class Shown(Protocol):
    """A part of a page: a table, a figure, or `Markup`."""

    def __html__(self) -> Markup:
        """HTML, in which every value is escaped."""


Part = str | Shown
"""A string is a paragraph."""


@dataclass(frozen=True)
class Section:
    """A section of a page: its title, its parts, and the name of its place on the page.

    It is folded to its title until it is opened or printed; an appendix is printed only if it is
    open.
    """

    title: str
    parts: Sequence[Part]
    name: str = ""
    is_appendix: bool = False


@dataclass(frozen=True)
class Verdict:
    """What a page answers, in a line; what to do next; and whether the answer is yes, no or open.

    Whoever reads it sees no colour: the line itself says which it is.
    """

    answer: str
    next_step: str
    state: Literal["yes", "no", "open"] = "open"


def write_page(
    path: Path,
    title: str,
    verdict: Verdict,
    first: Sequence[Part],
    sections: Sequence[Section],
    *,
    kind: str,
    lead: str,
) -> Path:
    """Write a page, whole or not at all; every value is escaped.

    `kind` is what wrote it, `lead` what it is about, in a sentence. The verdict and `first`, a
    table and a picture, are the first screen and the first sheet; `sections` fold away below.
    """
    environment = Environment(
        loader=PackageLoader("servoscope.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("page.html").render(
        title=title,
        kind=kind,
        lead=lead,
        verdict=verdict,
        first=map(as_html, first),
        sections=[(section, [*map(as_html, section.parts)]) for section in sections],
    )
    write_text(path, page)
    return path


def as_html(part: Part) -> Markup:
    """A part of a page; a string as a paragraph."""
    return part.__html__() if hasattr(part, "__html__") else paragraph(part)


def paragraph(text: str, style: str = "") -> Markup:
    """A paragraph, with classes of the style sheet."""
    return (
        Markup('<p class="{}">{}</p>').format(style, text)
        if style
        else Markup("<p>{}</p>").format(text)
    )


def heading(text: str) -> Markup:
    """A heading within a section."""
    return Markup("<h3>{}</h3>").format(text)


def bullets(items: Iterable[str]) -> Markup:
    """A list."""
    return Markup("<ul>\n{}\n</ul>").format(
        Markup("\n").join(map(Markup("<li>{}</li>").format, items))
    )


def pairs(tables: Mapping[str, Iterable[tuple[str, Any]]]) -> Markup:
    """Tables of names and values side by side, by what they are of."""
    shown = [
        Table(["", ""], [(name, _shown(value)) for name, value in rows], title, style="pairs")
        for title, rows in tables.items()
    ]
    return Markup('<div class="columns">\n{}\n</div>').format(Markup("\n").join(shown))


def _shown(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value)
