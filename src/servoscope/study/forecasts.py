"""Errors forecast before training beside those that the study's nets reached."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.independence import independent_groups
from servoscope.poses import DOFS
from servoscope.processes import in_processes
from servoscope.selection import forecast_errors
from servoscope.study.paper import FAMILIES, RECIPES
from servoscope.study.run import Study, Unit
from servoscope.study.run_folder import read_json

FORECAST = tuple(family for family in FAMILIES if not family.startswith("lfa"))
"""Families whose features are forecast as they are; LFA's are fitted to each dof, which flatters
them so much that they would have to be fitted anew for each fold."""


def compare_forecasts(study: Study, unit: Unit) -> list[dict[str, Any]]:
    """Forecast and reached errors of three families and of the selected subsets.

    Parameters
    ----------
    study : Study
        Finished.
    unit : tuple
        Protocol and displacement form.

    Returns
    -------
    list of dict
        ``features``, a family or ``"selected"``; ``dof``, of those that move; ``forecast``, from
        the images that train, and ``reached``, by the nets on the images that test: RMS errors in
        units of the range.
    """
    protocol, displacement = unit
    table, train = study.tables[unit], study.split(protocol).train
    results = read_json(study.folder.path / "models" / f"{protocol}_{displacement}.json")
    columns = {name: i for i, name in enumerate(table.names)}
    taken: dict[tuple[str, str], tuple[NDArray[np.intp], float]] = {}
    for dof in (dof for dof in DOFS if results["ranges"][dof]["value"] is not None):
        for family in FORECAST:
            reached = results["table1"][family][dof]["rms"]
            taken[family, dof] = table.columns(RECIPES[family].for_dof(dof)), reached
        subset = results["table3"][dof]
        taken["selected", dof] = (
            np.array([columns[name] for name in subset["features"]]),
            subset["rms"],
        )
    targets, groups = study.targets(displacement)[train], _groups(study, train)
    calls = [
        (table.values[np.ix_(train, inputs)], targets[:, DOFS.index(dof)], groups)
        for (_, dof), (inputs, _) in taken.items()
    ]
    with study.progress("forecasts of the families", len(calls)) as advance:
        found = []
        for key, rms in zip(taken, in_processes(_forecast, calls, study.n_jobs), strict=True):
            features, dof = key
            reached = taken[key][1]
            found.append({"features": features, "dof": dof, "forecast": rms, "reached": reached})
            advance(len(found))
    return found


def _groups(study: Study, images: NDArray[np.intp]) -> NDArray[np.intp] | None:
    """Images that are left out together; None where each is by itself."""
    labels = independent_groups(study.data).labels[images]
    return None if len(np.unique(labels)) == len(labels) else labels


def _forecast(
    X: NDArray[np.float64], y: NDArray[np.float64], groups: NDArray[np.intp] | None
) -> float:
    return float(forecast_errors(X, y, groups=groups).rms[0])
