"""The strengths at which errors double, and at which first order fails, as rows of words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Sensitivity = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""By disturbance and dof, what `ErrorGrowth.to_dict` gives."""

TITLES = {
    "doubles_at": "Strength at which the error has doubled",
    "parts_at": "Strength at which first order is 20 % off the simulation",
}
"""What a table can show."""


def columns(sensitivity: Sensitivity) -> tuple[str, ...]:
    """The heads of the tables: one for each dof after what is disturbed and its unit."""
    return ("disturbance", "unit", *next(iter(sensitivity.values())))


def table_rows(sensitivity: Sensitivity, key: str) -> list[tuple[str, ...]]:
    """A row of `columns` for each disturbance.

    Parameters
    ----------
    sensitivity : dict
    key : {"doubles_at", "parts_at"}

    Returns
    -------
    list of tuple of str
        ``> s`` where it is beyond the largest strength that was tried.
    """
    rows = []
    for name, by_dof in sensitivity.items():
        unit = next(iter(by_dof.values()))["unit"]
        rows.append((name, unit, *(_cell(growth, key) for growth in by_dof.values())))
    return rows


def clean_row(sensitivity: Sensitivity) -> tuple[str, ...]:
    """The undisturbed errors, as a row of `columns`, in mm and deg."""
    by_dof = next(iter(sensitivity.values()))
    return ("none (RMS error)", "mm, deg", *(f"{g['clean_rms']:.3g}" for g in by_dof.values()))


def as_markdown(features: Mapping[str, Mapping[str, Any]]) -> str:
    """Both tables of all features.

    Parameters
    ----------
    features : dict
        ``features[name]["sensitivity"]``.
    """
    lines = []
    for name, of_features in features.items():
        sensitivity = of_features["sensitivity"]
        for key, title in TITLES.items():
            first = [clean_row(sensitivity)] if key == "doubles_at" else []
            lines += [f"**{name}: {title[0].lower()}{title[1:]}**", ""]
            heads = columns(sensitivity)
            lines += [_line(heads), _line(["---"] * len(heads))]
            lines += [_line(row) for row in [*first, *table_rows(sensitivity, key)]]
            lines.append("")
    return "\n".join(lines)


def _cell(growth: Mapping[str, Any], key: str) -> str:
    if growth[key] is None:
        return f"> {max(map(abs, growth['strengths'])):g}"
    return f"{float(f'{growth[key]:.2g}'):g}"


def _line(cells: Any) -> str:
    return f"| {' | '.join(cells)} |"
