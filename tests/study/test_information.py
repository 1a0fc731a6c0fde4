import json
from dataclasses import replace

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.poses import DOFS
from servoscope.study.information import assess_features, measure_chance, study_table
from servoscope.study.run import in_order_of_time

N_FEATURES = 20
NAMES = tuple(f"e_{i:02d}" for i in range(N_FEATURES))


def chance_of(values, targets, **options):
    table, samples = study_table(values, NAMES), np.arange(len(values))
    assessment = assess_features(table, targets, samples)
    return assessment, measure_chance(assessment, table, targets, samples, **options)


def table_of(values):
    return np.array([[row[dof] for dof in DOFS] for row in values.values()])


@pytest.fixture(scope="module")
def independent():
    """Unrelated features, of which the first six alone inform one dof each."""
    rng = np.random.default_rng(0)
    values = rng.uniform(-1, 1, (1000, N_FEATURES))
    return values, values[:, :6] + 0.5 * rng.uniform(-1, 1, (1000, 6))


@pytest.fixture(scope="module")
def found(independent):
    return chance_of(*independent)


def test_what_is_found_is_what_there_is(found):
    _, chance = found
    np.testing.assert_array_equal(
        table_of(chance["mi_significant"]), np.arange(N_FEATURES)[:, None] == np.arange(6)
    )
    assert chance["mi_null"] == "chi_square"


def test_corrected_information_of_unrelated_variables_is_nothing_on_the_average(found):
    assessment, chance = found
    corrected = table_of(chance["mi_corrected"])
    assert abs(corrected[6:].mean()) < 0.005
    assert assessment.mutual_information[6:].mean() > 0.05


def test_bias_counts_the_occupied_cells(independent, found):
    values, targets = independent
    assessment, chance = found
    counts = np.histogram2d(values[:, 2], targets[:, 2], bins=10)[0] > 0
    excess = counts.sum() - counts.any(axis=0).sum() - counts.any(axis=1).sum() + 1
    bias = assessment.mutual_information[2, 2] - chance["mi_corrected"]["e_02"]["tz"]
    assert bias == pytest.approx(excess / (2000 * np.log(2)))


def test_nearly_all_redundancy_of_unrelated_features_is_bias(found):
    assessment, chance = found
    for dof, steps in chance["redundancy_bias"].items():
        redundancy = [step["redundancy"] for step in steps]
        np.testing.assert_array_equal(redundancy, assessment.rankings[dof].redundancy)
        expected = 81 / (2000 * np.log(2)) * np.arange(N_FEATURES)
        for part in ("bias", "unrelated"):
            np.testing.assert_allclose([step[part] for step in steps], expected, rtol=0.03)
        np.testing.assert_allclose(redundancy[4:], expected[4:], rtol=0.15)


def test_walks_that_have_nothing_to_do_with_each_other_are_not_found_in_a_sequence():
    rng = np.random.default_rng(1)
    walks = rng.normal(size=(400, N_FEATURES + 6)).cumsum(axis=0)
    values, targets = walks[:, :N_FEATURES], walks[:, N_FEATURES:]
    found = {
        in_sequence: table_of(
            chance_of(values, targets, in_sequence=in_sequence)[1]["mi_significant"]
        ).mean()
        for in_sequence in (False, True)
    }
    assert found[False] > 0.9
    assert found[True] < 0.1


def test_the_corrected_rule_is_not_misled_by_features_with_little_bias():
    # Heavy tails leave most bins empty: such features inform nothing, but show little redundancy.
    rng = np.random.default_rng(2)
    values = rng.exponential(size=(600, N_FEATURES)) ** 3
    values[:, :5] = rng.uniform(-1, 1, (600, 5))
    targets = np.repeat(values[:, :5].sum(axis=1)[:, None], 6, axis=1)
    assessment, chance = chance_of(values, targets)
    for dof in DOFS:
        published = [NAMES[i] for i in assessment.rankings[dof].order]
        assert set(published[:5]) != set(NAMES[:5])
        assert set(chance["table2_corrected"][dof][:5]) == set(NAMES[:5])


def test_all_of_it_can_be_written_as_json(found):
    _, chance = found
    assert json.loads(json.dumps(chance, allow_nan=False)) == chance


def test_nothing_informs_a_dof_that_never_moves(independent):
    values, targets = independent
    still = np.where(np.arange(6) == 2, 0.0, targets)
    _, chance = chance_of(values, still)
    assert not table_of(chance["mi_significant"])[:, 2].any()
    assert not table_of(chance["mi_corrected"])[:, 2].any()


def test_a_sequence_is_tested_in_the_order_of_its_times():
    data = planar_data_set(144)
    images = np.array([5, 2, 9])
    assert in_order_of_time(data, images).tolist() == [2, 5, 9]
    backwards = replace(data, times=np.arange(144.0)[::-1])
    assert in_order_of_time(backwards, images).tolist() == [9, 5, 2]
