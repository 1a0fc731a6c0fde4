"""Criteria of selection side by side, and errors forecast before training beside reached ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.independence import independent_groups
from servoscope.poses import DOFS
from servoscope.processes import in_processes
from servoscope.selection import CRITERIA, Candidates, forecast_errors
from servoscope.storage.folders import write_json
from servoscope.storage.run_folder import read_json
from servoscope.study.information import CANDIDATES
from servoscope.study.networks import subset_recipe, train_nets
from servoscope.study.paper import FAMILIES
from servoscope.study.run import Study, Unit

FORECAST = tuple(family for family in FAMILIES if not family.startswith("lfa"))
"""Families whose features are forecast as they are; LFA's are fitted to each dof, which flatters
them so much that they would have to be fitted anew for each fold."""


def compare_forecasts(study: Study, unit: Unit) -> list[dict[str, Any]]:
    """Forecast and reached errors of three families and of the selected subsets, of a finished
    study. The one is from the images that train, the other by the nets on the images that test: RMS
    errors in units of the range, of the dofs that move.
    """
    protocol, displacement = unit
    table, train = study.tables[unit], study.split(protocol).train
    results = read_json(study.folder.path / "models" / f"{protocol}_{displacement}.json")
    columns = {name: i for i, name in enumerate(table.names)}
    taken: dict[tuple[str, str], tuple[NDArray[np.intp], float]] = {}
    for dof in (dof for dof in DOFS if results["ranges"][dof]["value"] is not None):
        for family in FORECAST:
            reached = results["table1"][family][dof]["rms"]
            taken[family, dof] = table.columns(FAMILIES[family].recipe.for_dof(dof)), reached
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


SIZES = (4, 8, 16, 24)
"""How many features each criterion selects."""

UNIT: Unit = ("honest", "pivot")
"""The protocol and the form under which the criteria are compared."""

Orders = dict[tuple[str, str], list[int]]
"""Candidates in the order of selection, by criterion and dof."""


def compare_criteria(study: Study) -> dict[str, Any] | None:
    """Compare the criteria, and forecasts with nets, in a stage of a finished study.

    Errors are the RMS test errors of nets that take the first so many features, and of those that
    take all, in units of the range. None if the study has no honest protocol or nothing moves.
    """
    if UNIT not in study.units or not moving(study):
        return None
    path = study.folder.path / "criteria.json"
    study.folder.run_stage(
        "criteria", study.inputs, lambda: write_json(path, _compare(study)), [path.name]
    )
    return read_json(path)


def moving(study: Study) -> list[str]:
    """The degrees of freedom that move, in `DOFS` order."""
    moved = study.data.moves(UNIT[1])
    return [dof for dof, moves in zip(DOFS, moved, strict=True) if moves]


def _compare(study: Study) -> dict[str, Any]:
    orders = _rank(study)
    errors = _train(study, orders)
    table, dofs = study.tables[UNIT], moving(study)
    names = [table.names[i] for i in table.columns(CANDIDATES)]
    everything = tuple(range(len(names)))
    return {
        "sizes": SIZES,
        "errors": {
            name: {dof: [errors[dof, _subset(orders[name, dof], n)] for n in SIZES] for dof in dofs}
            for name in CRITERIA
        },
        "all_candidates": {dof: errors[dof, everything] for dof in dofs},
        "selected": {
            name: {dof: [names[i] for i in orders[name, dof]] for dof in dofs} for name in CRITERIA
        },
        "forecasts": compare_forecasts(study, UNIT),
    }


def _rank(study: Study) -> Orders:
    """The orders of all criteria; those that take longest are begun first."""
    table, train = study.tables[UNIT], study.split(UNIT[0]).train
    X, Y = table.values[np.ix_(train, table.columns(CANDIDATES))], study.targets(UNIT[1])[train]
    keys = [(name, dof) for name in reversed(CRITERIA) for dof in moving(study)]
    n_bins, most = study.config.n_bins, max(SIZES)
    calls = [(name, X, Y[:, DOFS.index(dof)], n_bins, most) for name, dof in keys]
    orders: Orders = {}
    with study.progress("criteria", len(keys)) as advance:
        ranked = in_processes(rank_candidates, calls, study.n_jobs)
        for key, order in zip(keys, ranked, strict=True):
            orders[key] = order
            advance(len(orders))
    return orders


def rank_candidates(
    criterion: str, X: NDArray[np.float64], y: NDArray[np.float64], n_bins: int, n_features: int
) -> list[int]:
    """The order in which a criterion selects so many features."""
    order: list[int] = CRITERIA[criterion](Candidates(X, y, n_bins), n_features).order.tolist()
    return order


def _train(study: Study, orders: Orders) -> dict[tuple[str, tuple[int, ...]], float]:
    """Test errors by dof and subset; a subset that several criteria share is trained once."""
    table = study.tables[UNIT]
    everything = tuple(range(len(table.columns(CANDIDATES))))
    subsets = [(dof, _subset(order, n)) for (_, dof), order in orders.items() for n in SIZES]
    distinct = list(dict.fromkeys([*subsets, *((dof, everything) for dof in moving(study))]))
    with study.progress("nets of the criteria", len(distinct)) as advance:
        nets = train_nets(
            table,
            study.targets(UNIT[1]),
            study.split(UNIT[0]),
            [(subset_recipe(table, features), dof) for dof, features in distinct],
            study.config,
            n_jobs=study.n_jobs,
            on_progress=advance,
        )
    return {subset: net.test_rms for subset, net in zip(distinct, nets, strict=True)}


def _subset(order: list[int], n_features: int) -> tuple[int, ...]:
    return tuple(sorted(order[:n_features]))
