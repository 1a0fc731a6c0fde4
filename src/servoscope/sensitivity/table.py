"""The strengths at which errors double, and at which first order fails, as rows of words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from servoscope.poses import DOFS

Sensitivity = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""By disturbance and dof, what `ErrorGrowth.to_dict` gives."""

COLUMNS = ("disturbance", "unit", *DOFS)

TITLES = {
    "doubles_at": "Strength at which the error has doubled",
    "parts_at": "Strength at which first order is 20 % off the simulation",
}
"""What a table can show."""


def table_rows(sensitivity: Sensitivity, key: str) -> list[tuple[str, ...]]:
    """A row of `COLUMNS` for each disturbance.

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
        rows.append((name, unit, *(_cell(by_dof[dof], key) for dof in DOFS)))
    return rows


def clean_row(sensitivity: Sensitivity) -> tuple[str, ...]:
    """The undisturbed errors, as a row of `COLUMNS`, in mm and deg."""
    by_dof = next(iter(sensitivity.values()))
    return ("none (RMS error)", "mm, deg", *(f"{by_dof[dof]['clean_rms']:.3g}" for dof in DOFS))


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
            lines += [_line(COLUMNS), _line(["---"] * len(COLUMNS))]
            lines += [_line(row) for row in [*first, *table_rows(sensitivity, key)]]
            lines.append("")
    return "\n".join(lines)


def _cell(growth: Mapping[str, Any], key: str) -> str:
    if growth[key] is None:
        return f"> {max(map(abs, growth['strengths'])):g}"
    return f"{float(f'{growth[key]:.2g}'):g}"


def _line(cells: Any) -> str:
    return f"| {' | '.join(cells)} |"
