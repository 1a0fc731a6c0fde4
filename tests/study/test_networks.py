"""The nets of a study, and their results as tables."""

from dataclasses import replace

import numpy as np
import pytest

from servoscope.data.splits import split_images
from servoscope.pipeline import Fitted, Recipe
from servoscope.poses import DOFS
from servoscope.regression import LMRegressor
from servoscope.selection import ThresholdSubset
from servoscope.study import StudyConfig
from servoscope.study.information import assess_features, study_table
from servoscope.study.networks import (
    StudyNets,
    SweepPoint,
    choose_best,
    summarise,
    train_study_nets,
)
from servoscope.study.paper import FAMILIES

CONFIG = StudyConfig(hidden=1, restarts=1)
NAMES = (
    *("m00_50", "x_50"),
    *("e_00", "e_01"),
    *("pci_tx", "pci_ty"),
    *(f"lfa{n}_{dof}_{i:02d}" for n in (35, 85) for dof in DOFS for i in range(2)),
)
SPLIT = split_images(60)
PAIR, SINGLE = ThresholdSubset((3, 0), (0.0,)), ThresholdSubset((2,), (0.5,))
MOMENTS = ThresholdSubset((0, 1), (0.2,))


@pytest.fixture(scope="module")
def samples():
    """Features and targets that have a little to do with each other."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(60, len(NAMES)))
    return study_table(X, NAMES), np.tanh(X[:, :6]) + 0.3 * rng.normal(size=(60, 6))


def train(samples, subsets, config=CONFIG) -> StudyNets:
    sweeps = {dof: list(subsets) for dof in DOFS}
    return train_study_nets(*samples, SPLIT, sweeps, config, n_jobs=1)


@pytest.fixture(scope="module")
def nets(samples) -> StudyNets:
    return train(samples, [PAIR, SINGLE])


def by_dof(nets) -> list[tuple[str, Fitted]]:
    """Every net with its dof, those of the families first."""
    families = [(dof, nets.families[family][dof]) for family in FAMILIES for dof in DOFS]
    return families + [(dof, point.trained) for dof in DOFS for point in nets.sweeps[dof]]


def seeds(nets) -> list[int]:
    return [trained.regressor.random_state for _, trained in by_dof(nets)]


def assert_same_net(a: Fitted, b: Fitted) -> None:
    assert a.regressor.random_state == b.regressor.random_state
    np.testing.assert_array_equal(a.columns, b.columns)
    assert (a.validation_rms, a.test_rms) == (b.validation_rms, b.test_rms)


@pytest.mark.parametrize("part", ["validation", "test"])
def test_errors_are_those_of_the_images_that_decide_and_of_those_that_test(samples, nets, part):
    table, targets = samples
    rows = getattr(SPLIT, part)
    for dof, trained in by_dof(nets):
        error = trained.regressor.predict(table.values[rows][:, trained.columns])
        error -= targets[rows, DOFS.index(dof)]
        expected = np.linalg.norm(error) / np.sqrt(len(rows))
        assert getattr(trained, f"{part}_rms") == pytest.approx(expected, rel=1e-12)


def test_every_net_takes_the_features_of_its_family_or_subset(nets):
    for dof in DOFS:
        taken = {f: [NAMES[i] for i in nets.families[f][dof].columns] for f in FAMILIES}
        assert taken == {
            "gm": ["m00_50", "x_50"],
            "pca": ["e_00", "e_01"],
            "pci": ["pci_tx", "pci_ty"],
            "lfa35": [f"lfa35_{dof}_00", f"lfa35_{dof}_01"],
            "lfa85": [f"lfa85_{dof}_00", f"lfa85_{dof}_01"],
        }
        assert [point.trained.columns.tolist() for point in nets.sweeps[dof]] == [[3, 0], [2]]


def test_nets_of_other_dofs_or_columns_have_other_seeds(nets):
    assert len(set(seeds(nets))) == len(seeds(nets))


def test_another_seed_of_the_study_gives_every_net_another(samples, nets):
    others = seeds(train(samples, [PAIR, SINGLE], replace(CONFIG, seed=1)))
    assert not set(others) & set(seeds(nets))


def test_a_net_does_not_depend_on_its_place_in_the_list(samples, nets):
    for dof, points in train(samples, [MOMENTS, SINGLE, PAIR]).sweeps.items():
        assert_same_net(points[1].trained, nets.sweeps[dof][1].trained)
        assert_same_net(points[2].trained, nets.sweeps[dof][0].trained)
        assert_same_net(points[0].trained, nets.families["gm"][dof])


RANGES = np.array([0.025] * 3 + [np.radians(15)] * 3)
CANDIDATE_NAMES = ("m00_50", "x_50", "y_50", "e_00")


def trained(validation_rms: float, test_rms: float) -> Fitted:
    return Fitted(Recipe(), "tx", np.array([0]), LMRegressor(), validation_rms, test_rms)


def sweep(*errors: tuple[float, float]) -> list[SweepPoint]:
    """A point for every validation and test error; the first takes all features, the next less."""
    return [
        SweepPoint(
            ThresholdSubset(tuple(range(len(CANDIDATE_NAMES) - i)), (0.1 * i,)), trained(*rms)
        )
        for i, rms in enumerate(errors)
    ]


# Errors of validation and test that every choice would tell apart: the point that decides best
# is neither the first nor the last, nor the one that tests best.
SWEEP = sweep((0.30, 0.10), (0.20, 0.40), (0.25, 0.50))


def summary_of(validation: np.ndarray, test: np.ndarray) -> dict:
    """The summary of nets with the given errors, an array of family by dof each."""
    rng = np.random.default_rng(0)
    table = study_table(rng.normal(size=(40, len(CANDIDATE_NAMES))), CANDIDATE_NAMES)
    targets = rng.uniform(-1, 1, (40, 6))
    split = split_images(40)
    families = {
        family: {dof: trained(validation[i, j], test[i, j]) for j, dof in enumerate(DOFS)}
        for i, family in enumerate(FAMILIES)
    }
    nets = StudyNets(families, dict.fromkeys(DOFS, SWEEP))
    assessment = assess_features(table, targets, split.train, n_ranked=len(CANDIDATE_NAMES))
    return summarise(assessment, nets, targets, split, RANGES)


@pytest.fixture(scope="module")
def errors():
    """Validation and test errors of 5 families by 6 dofs, all different."""
    return np.random.default_rng(1).permutation(np.linspace(0.1, 0.7, 60)).reshape(2, 5, 6)


def test_the_best_subset_is_the_best_on_the_images_that_decide():
    assert choose_best(SWEEP) is SWEEP[1]


def test_table_1_holds_the_test_errors(errors):
    table1 = summary_of(*errors)["table1"]
    reported = [[table1[family][dof]["rms"] for dof in DOFS] for family in FAMILIES]
    np.testing.assert_array_equal(reported, errors[1])
    assert table1["pca"]["tx"]["physical"] == pytest.approx(25 * errors[1, 1, 0])
    assert table1["pca"]["rz"]["physical"] == pytest.approx(15 * errors[1, 1, 5])


def test_table_3_holds_the_test_error_of_the_subset_that_decides_best(errors):
    for dof, best in summary_of(*errors)["table3"].items():
        assert best["rms"] == 0.40
        assert best["n_features"] == 3
        assert best["threshold"] == 0.1
        assert best["physical"] == pytest.approx(0.40 * (25 if dof.startswith("t") else 15))


def test_the_sweep_tells_the_deciding_error_from_that_of_the_test(errors):
    for points in summary_of(*errors)["sweep"].values():
        assert [point["validation_rms"] for point in points] == [0.30, 0.20, 0.25]
        assert [point["rms"] for point in points] == [0.10, 0.40, 0.50]


@pytest.mark.parametrize("best", FAMILIES)
def test_the_best_family_is_the_best_on_the_images_that_decide(best):
    validation, test = np.full((5, 6), 0.3), np.full((5, 6), 0.2)
    validation[list(FAMILIES).index(best)] = 0.2
    test[list(FAMILIES).index(best)] = 0.3
    assert summary_of(validation, test)["best_family"] == best


def test_the_best_family_is_the_best_on_the_average_of_the_dofs():
    validation = np.full((5, 6), 0.3)
    validation[1] = [0.1, 0.1, 0.1, 0.1, 0.1, 2.0]
    validation[3] = 0.25
    assert summary_of(validation, np.full((5, 6), 0.2))["best_family"] == "lfa35"
