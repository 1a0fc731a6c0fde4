"""How accurate a model is, as ``train`` and ``info`` print it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from servoscope.commands.output import console
from servoscope.poses import DISPLAY_UNITS, DOFS

_NEEDED = {
    "depth": "depth is not known, so translations are not read, only rotations; move along all "
    "axes",
    "mount_translation": "where the camera sits is not known; turn about all axes",
    "mount_rotation": "how the camera is turned is not known; move along and about all axes",
    "focal_length": "focal length and depth are not separable; move along the optical axis too",
}


def has_table(accuracy: Any) -> bool:
    """Whether the accuracy of a model's header, which may be anybody's, can be shown as a table."""
    try:
        if "rings" in accuracy:
            rings = [(r["mm"], r["deg"], r["clean"], r["disturbed"]) for r in accuracy["rings"]]
            numbers = [x for mm, deg, *kinds in rings for x in (mm, deg, *_of_dofs(*kinds))]
        else:
            dofs = list(accuracy["median"])
            if not dofs or not set(dofs) <= set(DOFS) or dofs != list(accuracy["quantile_90"]):
                return False
            numbers = [accuracy[name][dof] for name in ("median", "quantile_90") for dof in dofs]
            numbers += [accuracy[name] for name in ("n_images", "residual", "noise")]
        return all(type(x) in (int, float) for x in numbers)
    except (KeyError, TypeError):
        return False


def _of_dofs(*values: Mapping[str, Any]) -> list[Any]:
    return [errors[dof] for errors in values for dof in DOFS]


def print_accuracy(
    accuracy: Mapping[str, Any],
    *,
    ranges: Mapping[str, float] | None = None,
    limit: Mapping[str, float] | None = None,
) -> None:
    """Print errors of one look by dof, in mm and degrees, within 80 columns.

    Parameters
    ----------
    accuracy : mapping
        Of a trained model.
    ranges : mapping of str to float, optional
        Largest displacement by dof.
    limit : mapping of str to float, optional
        Smallest standard deviation of one look at the reference by dof.
    """
    is_keyframe = "rings" not in accuracy
    table = Table(
        title="Error of one look at images held out", title_justify="left", padding=(0, 1)
    )
    units = dict(zip(DOFS, DISPLAY_UNITS, strict=True))
    names = list(accuracy["median"]) if is_keyframe else list(DOFS)
    dofs = [f"{dof}\n[{units[dof]}]" for dof in names]
    if is_keyframe:
        rows = (
            ("range", ranges),
            ("limit of view (sd)", limit),
            ("median", accuracy["median"]),
            ("90 % are below", accuracy["quantile_90"]),
        )
        for column in ("", *dofs):
            table.add_column(column, justify="right", no_wrap=True)
        for label, values in rows:
            if values is not None and set(names) <= set(values):
                table.add_row(label, *(_rounded(values[dof]) for dof in names))
    else:
        for column in ("displaced by up to", "images", *dofs):
            table.add_column(column, justify="right")
        for ring in accuracy["rings"]:
            for kind in ("clean", "disturbed"):
                errors = [f"{ring[kind][dof]:.3f}" for dof in DOFS]
                table.add_row(f"{ring['mm']:.3g} mm, {ring['deg']:.3g} deg", kind, *errors)
    console().print(table)
    if isinstance(accuracy.get("observable"), Mapping):
        console().print(observability(accuracy["observable"]), soft_wrap=True)


def observability(observable: Mapping[str, bool]) -> str:
    """What the images inform of lens, mount and depth, in one line.

    Examples
    --------
    >>> observability({"depth": True, "focal_length": True})
    'observable: depth, focal length'
    """
    missing = [name for name, seen in observable.items() if not seen]
    if missing:
        unknown = [_NEEDED.get(name, name.replace("_", " ")) for name in missing]
        return f"not observable: {'; '.join(unknown)}"
    return f"observable: {', '.join(name.replace('_', ' ') for name in observable)}"


def _rounded(value: float) -> str:
    return f"{value:.2g}" if value < 1 else f"{value:.3g}"
