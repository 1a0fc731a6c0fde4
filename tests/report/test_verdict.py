import copy

from servoscope.report.run_data import list_units
from servoscope.report.verdict import describe_accuracy


def first_sentence(summary, **errors_of_range):
    """The verdict on a run in which the moments reach the given share of the baseline."""
    changed = copy.deepcopy(summary)
    results = changed["protocols"]["honest"]["pivot"]
    for dof, share in errors_of_range.items():
        results["table1"]["gm"][dof]["rms"] = share * results["baseline"][dof]["rms"]
    return describe_accuracy(list_units(changed)[0])[0]


def test_the_verdict_grades_what_the_best_family_reaches(summary):
    text = first_sentence(summary, tx=0.1, ty=0.1, tz=0.1, rx=0.1, ry=0.4, rz=0.9)
    well, roughly, hardly = text.split(";")
    assert "Tx (to 1.8 mm)" in well
    assert "Rx" in well
    assert "Ry" in roughly
    assert "is told roughly" in roughly
    assert "Rz" in hardly


def test_a_dof_that_never_moved_is_said_to_be_still(summary):
    changed = copy.deepcopy(summary)
    changed["protocols"]["honest"]["pivot"]["baseline"]["tz"]["rms"] = 0.0
    assert "Tz never moved" in describe_accuracy(list_units(changed)[0])[0]
