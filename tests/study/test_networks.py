from dataclasses import replace

import numpy as np
import pytest

from servoscope.data.splits import split_images
from servoscope.pipeline import Fitted
from servoscope.poses import DOFS
from servoscope.selection import ThresholdSubset
from servoscope.study import StudyConfig
from servoscope.study.feature_tables import study_table
from servoscope.study.networks import StudyNets, train_study_nets
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
