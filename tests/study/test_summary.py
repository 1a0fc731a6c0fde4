import numpy as np
import pytest

from servoscope.data.splits import split_images
from servoscope.pipeline import Fitted, Recipe
from servoscope.poses import DOFS
from servoscope.regression import LMRegressor
from servoscope.selection import ThresholdSubset
from servoscope.study.feature_tables import study_table
from servoscope.study.information import assess_features
from servoscope.study.networks import StudyNets, SweepPoint, choose_best, summarise
from servoscope.study.paper import FAMILIES

RANGES = np.array([0.025] * 3 + [np.radians(15)] * 3)
NAMES = ("m00_50", "x_50", "y_50", "e_00")


def trained(validation_rms: float, test_rms: float) -> Fitted:
    return Fitted(Recipe(), "tx", np.array([0]), LMRegressor(), validation_rms, test_rms)


def sweep(*errors: tuple[float, float]) -> list[SweepPoint]:
    """A point for every validation and test error; the first takes all features, the next less."""
    return [
        SweepPoint(ThresholdSubset(tuple(range(len(NAMES) - i)), (0.1 * i,)), trained(*rms))
        for i, rms in enumerate(errors)
    ]


# Errors of validation and test that every choice would tell apart: the point that decides best
# is neither the first nor the last, nor the one that tests best.
SWEEP = sweep((0.30, 0.10), (0.20, 0.40), (0.25, 0.50))


def summary_of(validation: np.ndarray, test: np.ndarray) -> dict:
    """The summary of nets with the given errors, an array of family by dof each."""
    rng = np.random.default_rng(0)
    table = study_table(rng.normal(size=(40, len(NAMES))), NAMES)
    targets = rng.uniform(-1, 1, (40, 6))
    split = split_images(40)
    families = {
        family: {dof: trained(validation[i, j], test[i, j]) for j, dof in enumerate(DOFS)}
        for i, family in enumerate(FAMILIES)
    }
    nets = StudyNets(families, dict.fromkeys(DOFS, SWEEP))
    assessment = assess_features(table, targets, split.train, n_ranked=len(NAMES))
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
