"""A small run folder with the shapes of a real one, and summaries that repeat the paper."""

import numpy as np
import pytest

from servoscope.poses import DISPLAY_UNITS, DOFS
from servoscope.selection import CRITERIA
from servoscope.storage.folders import write_arrays, write_json
from servoscope.storage.run_folder import VERSION, open_run_folder
from servoscope.study.paper import TABLE1, TABLE3, table2

MOMENTS = [
    f"{descriptor}_{upper}"
    for upper in (50, 100, 150)
    for descriptor in ("x", "y", "theta", "r1", "r2", "m00", "sx", "sy")
]
CANDIDATES = [*MOMENTS, *(f"e_{i:02d}" for i in range(35)), *(f"pci_{dof}" for dof in DOFS)]
RANGES = dict(zip(DOFS, (25.0, 25.0, 25.0, 15.0, 15.0, 15.0), strict=True))
UNITS = dict(zip(DOFS, DISPLAY_UNITS, strict=True))
FORMS = ("pivot", "camera")


def error(dof, rms):
    return {"rms": rms, "physical": rms * RANGES[dof], "unit": UNITS[dof]}


def published_results():
    """Results of one protocol and form that say what the paper says."""
    table3 = {
        dof: {
            **error(dof, TABLE3[dof]["rms"]),
            "n_features": TABLE3[dof]["n_features"],
            "features": table2(dof)[: TABLE3[dof]["n_features"]],
            "threshold": 0.2,
        }
        for dof in DOFS
    }
    information = {dof: 1.2 - 4 * TABLE3[dof]["rms"] for dof in DOFS}
    return {
        "table1": {
            family: {dof: error(dof, row[dof]) for dof in DOFS} for family, row in TABLE1.items()
        },
        "best_family": "gm",
        "n_images": {"train": 600, "validation": 150, "test": 250},
        "baseline": {dof: error(dof, 0.577) for dof in DOFS},
        "table2": {dof: table2(dof) for dof in DOFS},
        "table3": table3,
        "mi": {
            name: {
                dof: information[dof] if name == table2(dof)[0] else 0.08 + i / 1000 for dof in DOFS
            }
            for i, name in enumerate(CANDIDATES)
        },
        "mi_null_level": 0.06,
        "ranking": {
            dof: [{"feature": n, "relevance": 0.5, "redundancy": 0.1} for n in table2(dof)]
            for dof in DOFS
        },
        "sweep": {dof: sweep_of(dof) for dof in DOFS},
        "stability": {
            dof: [
                {"n_bins": n, "same_steps": 65, "overlap": 1.0, "kendall_tau": 1.0}
                for n in range(5, 21)
            ]
            for dof in DOFS
        },
        "ranges": {dof: {"value": RANGES[dof], "unit": UNITS[dof]} for dof in DOFS},
        **chance(information),
    }


def chance(information):
    """What is chance in these results: all but the first feature of each dof."""
    return {
        "mi_correction": "miller_madow",
        "mi_null": "chi_square",
        "mi_corrected": {
            name: {
                dof: information[dof] - 0.05 if name == table2(dof)[0] else -0.002 for dof in DOFS
            }
            for name in CANDIDATES
        },
        "mi_significant": {
            name: {dof: name == table2(dof)[0] for dof in DOFS} for name in CANDIDATES
        },
        "redundancy_bias": {
            dof: [
                {"redundancy": 0.1 * i, "bias": 0.06 * i, "unrelated": 0.08 * i} for i in range(24)
            ]
            for dof in DOFS
        },
        "table2_corrected": {dof: [*table2(dof)[:3], *CANDIDATES[-21:]] for dof in DOFS},
    }


def comparison():
    """Criteria side by side, of which the forecast errs least."""
    return {
        "sizes": [4, 8, 16, 24],
        "errors": {
            name: {dof: [0.4 / (i + 1) / n for n in (1, 2, 3, 4)] for dof in DOFS}
            for i, name in enumerate(CRITERIA)
        },
        "all_candidates": dict.fromkeys(DOFS, 0.012),
        "selected": {name: {dof: table2(dof) for dof in DOFS} for name in CRITERIA},
        "forecasts": [
            {"features": family, "dof": dof, "forecast": rms, "reached": rms / 0.9}
            for family in ("gm", "pca", "pci", "selected")
            for dof, rms in zip(DOFS, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), strict=True)
        ],
    }


def sweep_of(dof):
    rms = TABLE3[dof]["rms"]
    points = (([0.0, 0.05], 24, rms + 0.02), ([0.1], 12, rms), ([0.3], 3, rms + 0.05))
    return [
        {"thresholds": thresholds, "n_features": n, "rms": value, "validation_rms": value - 0.01}
        for thresholds, n, value in points
    ]


def published_summary(protocols=("paper", "honest"), kind="simulated cylinder head"):
    return {
        "version": VERSION,
        "servoscope": "0.1.0",
        "dataset": {
            "n_images": 40,
            "image_shape": [48, 64],
            "pivot_mm": 550.0,
            "split": "random",
            "source": {"kind": kind, "seed": 0},
        },
        "settings": {},
        "protocols": {p: {form: published_results() for form in FORMS} for p in protocols},
        "timings_s": {"features": 1.5, "networks_honest_pivot": 2.25, "total": 3.75},
    }


def write_run(path, summary):
    """A run folder with the given summary and arrays of noise."""
    rng = np.random.default_rng(0)
    protocols = list(summary["protocols"])
    n_images, shape = summary["dataset"]["n_images"], tuple(summary["dataset"]["image_shape"])
    settings = {
        "command": "study",
        "seed": 7,
        "protocols": protocols,
        "n_bins": 10,
        "acquisition": {"n_images": n_images, "image_size": 64},
    }
    open_run_folder(path, settings)
    write_json(path / "summary.json", summary)
    features = {
        "names": np.array(CANDIDATES),
        "reference_image": rng.integers(0, 256, shape).astype(np.uint8),
    }
    for form in FORMS:
        features[f"delta_p_{form}"] = rng.uniform(-0.02, 0.02, (n_images, 6))
    selection = {}
    (path / "vectors").mkdir()
    for key in (f"{protocol}_{form}" for protocol in protocols for form in FORMS):
        features[key] = rng.normal(size=(n_images, len(CANDIDATES)))
        for dof in DOFS:
            selection[f"{key}_{dof}"] = _redundancies(rng, summary, dof)
        write_arrays(path / "vectors" / f"{key}.npz", _pictures(rng, shape))
    write_arrays(path / "features.npz", features)
    write_arrays(path / "selection.npz", selection)
    return path


def _redundancies(rng, summary, dof):
    redundancy = rng.uniform(0.1, 2.0, (24, len(CANDIDATES)))
    redundancy[0] = 0.0
    for step, name in enumerate(table2(dof)[:-1]):
        if name in CANDIDATES:
            redundancy[step + 1 :, CANDIDATES.index(name)] = np.nan
    return redundancy


def _pictures(rng, shape):
    six = {
        name: rng.normal(size=(6, *shape)).astype(np.float32)
        for name in ("pci", "covariance", "lfa")
    }
    return {
        **six,
        "eigenvectors": rng.normal(size=(12, *shape)).astype(np.float32),
        "filtered": rng.uniform(size=(6, *shape)).astype(np.float32),
        "locations": rng.integers(0, min(shape), (6, 12, 2)),
    }


@pytest.fixture
def summary():
    """A summary in which everything is as published."""
    return published_summary()


@pytest.fixture
def run_folder(tmp_path, summary):
    """A finished run folder of both protocols."""
    return write_run(tmp_path / "run", summary)


@pytest.fixture(scope="session")
def shared_run(tmp_path_factory):
    """The same, for tests that do not change it."""
    return write_run(tmp_path_factory.mktemp("report") / "run", published_summary())


@pytest.fixture(scope="session")
def honest_run(tmp_path_factory):
    """A finished run folder of the honest protocol, in which a report may be written."""
    summary = published_summary(protocols=("honest",))
    return write_run(tmp_path_factory.mktemp("report") / "run", summary)


@pytest.fixture
def make_run(tmp_path):
    """Write a run folder with other protocols or of another data set."""

    def make(name="other", **kwargs):
        return write_run(tmp_path / name, published_summary(**kwargs))

    return make


@pytest.fixture
def compared():
    """Criteria side by side, of which the forecast errs least."""
    return comparison()
