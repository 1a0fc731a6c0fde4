"""What a finished run folder holds, read and checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import RunFolderError
from servoscope.poses import DOFS
from servoscope.storage.run_folder import VERSION, read_arrays, read_json, read_settings
from servoscope.study.paper import FAMILIES
from servoscope.wording import one_line

Arrays = dict[str, NDArray[Any]]

RESULTS = (
    *("table1", "table2", "table3", "best_family", "baseline"),
    *("mi", "mi_null_level", "ranking", "sweep", "stability", "ranges", "n_images"),
)
"""What a summary holds for each protocol and displacement form."""

OF_CHANCE = (
    *("mi_correction", "mi_corrected", "mi_null", "mi_significant"),
    *("redundancy_bias", "table2_corrected"),
)
"""What it holds besides, all or none of it: older runs do not."""

PICTURES = ("eigenvectors", "pci", "covariance", "filtered", "lfa", "locations")
"""The arrays of ``vectors/{protocol}_{displacement}.npz``."""

PROTOCOL_NAMES = {"honest": "Honest protocol", "paper": "Paper's protocol"}

FORM_NAMES = {"pivot": "about the pivot", "camera": "about the camera"}


@dataclass(frozen=True)
class Unit:
    """One protocol and displacement form of a run, and what `networks.summarise` found for it."""

    protocol: str
    displacement: str
    results: dict[str, Any]

    @property
    def key(self) -> str:
        """The name of its arrays and files."""
        return f"{self.protocol}_{self.displacement}"

    @property
    def name(self) -> str:
        """Of its place on a page."""
        return self.key.replace("_", "-")

    @property
    def title(self) -> str:
        """What it is, in words."""
        return f"{PROTOCOL_NAMES[self.protocol]}, displacement {FORM_NAMES[self.displacement]}"


@dataclass(frozen=True, eq=False)
class RunData:
    """What a finished run folder holds:

    ``config.json``, ``summary.json``, the arrays of ``features.npz``, of ``selection.npz`` and, by
    the key of the unit, of ``vectors/``.
    """

    path: Path
    settings: dict[str, Any]
    summary: dict[str, Any]
    features: Arrays
    selection: Arrays
    pictures: dict[str, Arrays]

    @property
    def assessed(self) -> dict[str, Any] | None:
        """What an assessment found, where there was one."""
        return self.summary.get("assessed")

    @property
    def units(self) -> list[Unit]:
        """The protocols and forms that were run, the honest protocol and the pivot form first."""
        return list_units(self.summary)


def list_units(summary: dict[str, Any]) -> list[Unit]:
    """The protocols and forms of a summary, the honest protocol and the pivot form first."""
    return [
        Unit(protocol, displacement, summary["protocols"][protocol][displacement])
        for protocol in sorted(summary["protocols"])
        for displacement in sorted(summary["protocols"][protocol], reverse=True)
    ]


def moving_dofs(results: dict[str, Any]) -> list[str]:
    """The degrees of freedom that moved, in `DOFS` order.

    Parameters
    ----------
    results : dict
        Of one protocol and displacement form.
    """
    return [dof for dof in DOFS if results["ranges"][dof]["value"] is not None]


def mean_rms(results: dict[str, Any], row: dict[str, dict[str, Any]]) -> float:
    """Mean of the RMS errors in a row of a table of `results`, of range; 0 if nothing moved."""
    errors = [row[dof]["rms"] for dof in moving_dofs(results)]
    return float(np.mean(errors)) if errors else 0.0


def read_run(path: Path) -> RunData:
    """Read a finished run folder.

    Raises
    ------
    RunFolderError
        If it is not a run folder, not finished, damaged, or was written by another version.
    """
    settings = read_settings(path)
    if not (path / "summary.json").exists():
        raise RunFolderError(
            f"{path} is not finished: it has no summary.json; go on with --resume."
        )
    summary = read_json(path / "summary.json")
    _check_summary(path / "summary.json", summary)
    if not summary["protocols"]:
        return RunData(path, settings, summary, features={}, selection={}, pictures={})
    keys = [unit.key for unit in list_units(summary)]
    forms = sorted({unit.displacement for unit in list_units(summary)})
    expected = ["names", "reference_image", *keys, *(f"delta_p_{form}" for form in forms)]
    selection = [f"{key}_{dof}" for key in keys for dof in DOFS]
    return RunData(
        path=path,
        settings=settings,
        summary=summary,
        features=read_arrays(path / "features.npz", expected),
        selection=read_arrays(path / "selection.npz", selection),
        pictures={key: read_arrays(path / "vectors" / f"{key}.npz", PICTURES) for key in keys},
    )


def _check_summary(path: Path, summary: dict[str, Any]) -> None:
    if summary.get("version") != VERSION:
        raise RunFolderError(
            f"{path} is of version {summary.get('version')!r}, this servoscope reads version "
            f"{VERSION}; make the run again with --force."
        )
    try:
        for key in ("n_images", "image_shape", "pivot_mm", "split", "source"):
            summary["dataset"][key]
        float(summary["timings_s"]["total"])
        if compared := summary.get("criteria"):
            for key in ("sizes", "errors", "all_candidates", "forecasts"):
                compared[key]
        units = list_units(summary)
        for unit in units:
            of_chance = OF_CHANCE if set(OF_CHANCE) & set(unit.results) else ()
            for key in (*RESULTS, *of_chance):
                unit.results[key]
            for row in (*(unit.results["table1"][f] for f in FAMILIES), unit.results["table3"]):
                for dof in DOFS:
                    float(row[dof]["rms"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _damaged(path, f"{type(error).__name__}: {error}") from error
    if not units and "assessed" not in summary:
        raise _damaged(path, "it holds no protocol")


def _damaged(path: Path, reason: str) -> RunFolderError:
    reason = one_line(reason)
    return RunFolderError(f"{path} is damaged ({reason}); make the run again with --force.")
