import pytest

from servoscope.poses import DOFS
from servoscope.report.averages import mean_rms, moving_dofs
from servoscope.report.tables import rms_table


@pytest.fixture
def results(summary):
    """Results in which tz and rx never moved."""
    results = summary["protocols"]["honest"]["pivot"]
    for dof in ("tz", "rx"):
        results["ranges"][dof]["value"] = None
        for row in (*results["table1"].values(), results["table3"], results["baseline"]):
            row[dof] |= {"rms": 0.0, "physical": 0.0}
    return results


def test_the_mean_is_of_the_dofs_that_moved(results):
    assert moving_dofs(results) == ["tx", "ty", "ry", "rz"]
    assert mean_rms(results, results["baseline"]) == pytest.approx(0.577)


def test_nothing_that_moved_has_no_error(results):
    for dof in DOFS:
        results["ranges"][dof]["value"] = None
    assert mean_rms(results, results["baseline"]) == 0.0
    assert rms_table(results)[0]["mean"]["published"] is None


def test_table1_marks_nothing_where_nothing_moved_and_averages_alike(results):
    rows = rms_table(results)
    assert [cell["moves"] for cell in rows[0]["cells"]] == [True, True, False, False, True, True]
    assert [cell["best"] for cell in rows[0]["cells"]] == [True, True, False, False, True, True]
    assert rows[0]["mean"]["rms"] == pytest.approx(rows[0]["mean"]["published"])
