"""``servoscope info``."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from servoscope import __version__
from servoscope.commands.options import AnyFolder, Json
from servoscope.errors import InvalidInputError, ModelError

if TYPE_CHECKING:
    from servoscope.keyframe import Keyframe

_LONGEST_LINE = 60
_LONGEST_SOURCE = 200
_ELSEWHERE = (
    "rings", "part", "variant", "robot", "n_images", "n_kept", "n_replaced", "image_size",
    "pivot_mm", "forecast",
)  # fmt: skip
"""What of the source of a data set is shown beside it."""

ENDS = ("report.html", "scoreboard.html", "sensitivity.md", "rehearsal.html")
"""The last file that each kind of run writes."""


def info(
    path: AnyFolder = None,
    figure: Path | None = None,
    dataset: str | None = None,
    json: Json = False,
) -> None:
    """Show what a data set, a run or a model folder holds; without one, what is installed.

    Of a model: by dof what its assessment forecast, what it reaches on images held out, where the
    loop ends, and what the view allows. All that the folder says is shown with --json.

    Example: servoscope info servoscope-study

    Example: servoscope info model --figure view.png --dataset cell

    Args:
        figure: PNG or SVG file to write, of a keyframe model: where each dof is read, and how well
            each pixel is explained.
        dataset: Data set whose pose-image covariance the figure is to show as well.
    """
    from servoscope.commands.output import print_facts
    from servoscope.storage.addresses import place_of
    from servoscope.storage.model_folder import is_model
    from servoscope.storage.run_folder import is_run

    if figure is None and dataset is not None:
        raise InvalidInputError("--dataset is for the figure; name its file with --figure.")
    place = None if path is None else place_of(path)
    if figure is not None:
        _write_figure(place, figure, dataset)
    if place is None:
        print_facts(describe_installation(), as_json=json)
    elif isinstance(place, str):
        print_data_set(place, as_json=json)
    elif is_run(place):
        print_facts(describe_run(place), as_json=json)
    elif not is_model(place):
        print_data_set(place, as_json=json)
    elif json:
        print_facts(describe_model(place), as_json=json)
    else:
        _print_model(place)


def describe_installation() -> dict[str, Any]:
    """Versions of servoscope and of what its results depend on."""
    packages = ("numpy", "scipy", "scikit-learn", "numba", "opencv-python-headless", "embreex")
    return {
        "servoscope": __version__,
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        **{package: _version(package) for package in packages},
    }


def describe_data_set(folder: Path | str) -> dict[str, Any]:
    """What a data set folder holds.

    Raises
    ------
    DataSetError
        If it cannot be read.
    """
    from servoscope.data.checks import check_data, image_faults
    from servoscope.data.images import PoseImageSet
    from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
    from servoscope.storage.sizes import DEFAULT_MEMORY

    data = PoseImageSet.load(folder, memory=DEFAULT_MEMORY)
    faults = image_faults(data.images, data.T_world_cam)
    height, width = data.image_shape
    ranges = (data.ranges() * DISPLAY_FACTORS).round(3).tolist()
    return {
        "data_set": str(folder),
        "images": len(data),
        "size_px": [width, height],
        "pivot_mm": round(1e3 * data.pivot, 3),
        "split": data.split,
        "dofs": list(data.dofs),
        "ranges": {
            dof: f"{value:g} {unit}" if moves else "never moves"
            for dof, value, unit, moves in zip(
                DOFS, ranges, DISPLAY_UNITS, data.moves(), strict=True
            )
        },
        **_how_acquired(data.source),
        **{key: data.source[key] for key in ("forecast",) if key in data.source},
        "unusable_images": {reason: int(bad.sum()) for reason, bad in faults.items()},
        "warnings": [finding.text for finding in check_data(data, faults)],
        "source": data.source,
    }


def print_data_set(folder: Path | str, *, as_json: bool) -> None:
    """Print what a data set folder holds; where its images come from in a line or two.

    Raises
    ------
    DataSetError
        If it cannot be read.
    """
    from servoscope.commands.output import print_facts
    from servoscope.wording import one_line

    facts = describe_data_set(folder)
    if not as_json:
        facts["source"] = one_line(_in_words(facts["source"]) or "not known", _LONGEST_SOURCE)
    print_facts(facts, as_json=as_json)


def _in_words(source: Mapping[str, Any]) -> str:
    """What is known of the source of images, without what says nothing or stands elsewhere.

    Examples
    --------
    >>> _in_words({"format": "tum", "options": {"max_mm": 150.0, "columns": None}, "n_kept": 9})
    'tum, options (max mm 150)'
    """
    parts = []
    for name, value in source.items():
        words = name.replace("_", " ")
        if name in _ELSEWHERE or value is None or value is False or value in ("", [], {}):
            continue
        if isinstance(value, Mapping):
            inner = _in_words(value)
            parts += [f"{words} ({inner})"] if inner else []
        elif isinstance(value, list):
            is_long = len(value) > 3 or any(isinstance(item, Mapping | list) for item in value)
            shown = len(value) if is_long else " ".join(map(str, value))
            parts.append(f"{words} {shown}")
        elif name in ("kind", "format"):
            parts.append(str(value))
        else:
            shown = f"{value:.4g}" if isinstance(value, float) else value
            parts.append(words if value is True else f"{words} {shown}")
    return ", ".join(parts)


def describe_run(folder: Path) -> dict[str, Any]:
    """What a run folder holds, and which stages are finished.

    Raises
    ------
    RunFolderError
        If it was written by another version or is damaged.
    """
    from servoscope.storage.run_folder import RunFolder, read_settings

    run = RunFolder(folder, read_settings(folder))
    return {
        "run": str(folder),
        "finished": any((folder / page).exists() for page in ENDS),
        "settings": run.settings,
        "timings_s": run.timings(),
    }


def describe_model(folder: Path) -> dict[str, Any]:
    """What a model folder holds; all of its header that is valid.

    Raises
    ------
    ModelError
        If it is damaged, or was written by a newer version.
    """
    from servoscope.storage.model_folder import read_model, read_version

    header, arrays = read_model(folder)
    version, servoscope = read_version(folder)
    keyframe, dofs = _keyframe(header, arrays), _dofs(header)
    facts = {
        "model": str(folder),
        "kind": header.get("kind"),
        "trained_on": header.get("trained_on"),
        "size_px": _width_and_height(header.get("image_size")),
        "dofs": dofs if "dofs" in header else None,
        "ranges": _ranges(header.get("reach"), dofs),
        "pivot_mm": _millimetres(header.get("pivot")),
        "accuracy": header.get("accuracy"),
        "limit": None if keyframe is None else _by_dof(keyframe.limit().std, dofs),
        "arrays": len(arrays),
        "size_mb": round(1e-6 * sum(array.nbytes for array in arrays.values()), 3),
        "version": version,
        "written_by": f"servoscope {servoscope}",
    }
    return {name: value for name, value in facts.items() if value is not None}


def _print_model(folder: Path) -> None:
    """Print what a model is and the table of its errors; all of its facts if it has no table."""
    from servoscope.commands.accuracy import has_table, print_accuracy
    from servoscope.commands.output import print_facts

    facts = describe_model(folder)
    accuracy: Any = facts.get("accuracy")
    if not has_table(accuracy):
        print_facts(facts)
        return
    limit = facts.get("limit")
    shown = {"kind": facts.get("kind", "unknown"), "images": _trained_on(facts)}
    if "ranges" in facts:
        shown["dofs, range"] = _short_ranges(facts["ranges"])
    if "pivot_mm" in facts:
        shown["pivot"] = f"{facts['pivot_mm']:.4g} mm away"
    if all(_is_number(accuracy.get(name)) for name in ("residual", "noise")):
        residual = f"{accuracy['residual']:.2g} grey, noise {accuracy['noise']:.2g} grey"
        if _is_number(accuracy.get("residual_over_noise")):
            residual += f"; held out {accuracy['residual_over_noise']:.2g} times the noise"
        shown["residual"] = residual
    print_facts(shown)
    print_accuracy(accuracy, limit=limit)


def _trained_on(facts: dict[str, Any]) -> str:
    """How many images of what size a model was trained on, and where they come from."""
    from servoscope.wording import one_line

    source, n_images = facts.get("trained_on"), facts["accuracy"].get("n_images")
    source = source if isinstance(source, dict) else {}
    n_images = source.get("n_images") if n_images is None else n_images
    size = facts.get("size_px")
    parts = [
        *([f"{n_images}"] if _is_number(n_images) else []),
        *(["{} x {} px".format(*size)] if size else []),
        *(str(source[key]) for key in ("kind", "rings", "robot") if key in source),
    ]
    return one_line(", ".join(parts), _LONGEST_LINE)


def _short_ranges(ranges: dict[str, str]) -> str:
    """Ranges by dof, each unit once.

    Examples
    --------
    >>> _short_ranges({"tx": "25 mm", "ty": "20.013 mm", "rz": "15 deg"})
    'tx 25, ty 20 mm; rz 15 deg'
    """
    by_unit: dict[str, list[str]] = {}
    for dof, text in ranges.items():
        value, unit = text.split()
        by_unit.setdefault(unit, []).append(f"{dof} {float(value):.3g}")
    return "; ".join(f"{', '.join(parts)} {unit}" for unit, parts in by_unit.items())


def _keyframe(header: dict[str, Any], arrays: dict[str, Any]) -> Keyframe | None:
    """The keyframe of a model, if it is one."""
    from servoscope.keyframe import Keyframe
    from servoscope.positioning.keyframe_model import KeyframeModel, parts_of

    is_keyframe = header.get("kind") == KeyframeModel.kind
    return Keyframe.from_arrays(parts_of(arrays)["keyframe"]) if is_keyframe else None


def _write_figure(folder: Path | str | None, file: Path, dataset: str | None) -> None:
    """Write the figure of a keyframe model."""
    from servoscope.data.images import PoseImageSet
    from servoscope.keyframe.figure import write_keyframe
    from servoscope.positioning.keyframe_model import RESIDUAL
    from servoscope.storage.model_folder import is_model, read_model

    keyframe = None
    if isinstance(folder, Path) and is_model(folder):
        header, arrays = read_model(folder)
        keyframe = _keyframe(header, arrays)
    if keyframe is None:
        raise InvalidInputError(
            f"--figure shows a keyframe model, got {folder or 'nothing'}; name the folder of a "
            "model that was trained with --method keyframe."
        )
    residual = arrays.get(RESIDUAL)
    if residual is not None and (residual.ndim != 2 or not residual.size):
        raise ModelError(
            f"{folder} must hold {RESIDUAL} of shape (rows, columns), got {residual.shape}; "
            "train it again."
        )
    data = None if dataset is None else PoseImageSet.load(dataset)
    write_keyframe(file, keyframe, residual=residual, data=data)


def _dofs(header: dict[str, Any]) -> list[str]:
    """The degrees of freedom of a model; all six if its header names none."""
    from servoscope.poses import DOFS

    named = header.get("dofs")
    found = [dof for dof in DOFS if isinstance(named, list) and dof in named]
    return found or list(DOFS)


def _by_dof(values: Any, dofs: list[str]) -> dict[str, float]:
    """Values of the six dofs, [m] and [rad], in mm and degrees, of some of them."""
    from servoscope.poses import DISPLAY_FACTORS, DOFS

    by_dof = dict(zip(DOFS, (values * DISPLAY_FACTORS).tolist(), strict=True))
    return {dof: by_dof[dof] for dof in dofs}


def _width_and_height(image_size: Any) -> list[int] | None:
    """Of the side of a square image, or of its height and width."""
    if _is_number(image_size):
        return [image_size, image_size]
    if isinstance(image_size, list) and len(image_size) == 2 and all(map(_is_number, image_size)):
        return image_size[::-1]
    return None


def _ranges(reach: Any, dofs: list[str]) -> dict[str, str] | None:
    """Largest displacements of some dofs in mm and degrees, of six in metres and radians."""
    from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS

    if not isinstance(reach, list) or len(reach) != len(DOFS) or not all(map(_is_number, reach)):
        return None
    shown = zip(DOFS, DISPLAY_FACTORS * reach, DISPLAY_UNITS, strict=True)
    return {dof: f"{value:.4g} {unit}" for dof, value, unit in shown if dof in dofs}


def _millimetres(metres: Any) -> float | None:
    return round(1e3 * metres, 3) if _is_number(metres) else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < 1e9


def _how_acquired(source: dict[str, Any]) -> dict[str, Any]:
    """Rings, part and robot of images that were acquired; nothing of others."""
    if not source.keys() >= {"rings", "n_replaced", "part", "variant", "robot"}:
        return {}
    replaced = source["n_replaced"]
    drawn = f", {replaced} poses out of reach drawn anew"
    return {
        "rings": source["rings"],
        "part": f"{source['part']}, variant {source['variant']}",
        "robot": f"{source['robot']}{drawn if replaced else ''}",
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
