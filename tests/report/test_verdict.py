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
    assert "not observable" not in text
    assert "Tx (to 1.8 mm)" in well
    assert "Rx" in well
    assert "Ry" in roughly
    assert "is observable roughly" in roughly
    assert "Rz" in hardly


def test_a_dof_that_never_moved_is_said_to_be_still(summary):
    changed = copy.deepcopy(summary)
    changed["protocols"]["honest"]["pivot"]["baseline"]["tz"]["rms"] = 0.0
    assert "Tz never moved" in describe_accuracy(list_units(changed)[0])[0]


def test_a_dof_that_the_mean_tells_as_well_is_not_told(summary):
    text = first_sentence(summary, tx=1.0, ty=0.99, tz=1.7, rx=0.1, ry=0.1, rz=0.1)
    assert text.endswith("Tx and Tz are not observable: the mean does as well.")
    assert "Ty (to 1.2 mm) is hardly observable" in text


def test_the_verdict_says_which_images_chose_the_family(summary):
    honest, paper = (
        describe_accuracy(next(u for u in list_units(summary) if u.protocol == protocol))[1]
        for protocol in ("honest", "paper")
    )
    assert "errors of GM, the family chosen because it erred least on the 150 images that" in honest
    assert "on the 250 test images themselves" in paper


def test_a_dof_that_never_moved_has_no_part_in_the_means(summary):
    changed = copy.deepcopy(summary)
    results = changed["protocols"]["honest"]["pivot"]
    results["ranges"]["tz"]["value"] = None
    for row in (results["baseline"], results["table1"]["gm"], results["table3"]):
        row["tz"]["rms"] = 0.0
    assert "always predicting the mean 0.577" in describe_accuracy(list_units(changed)[0])[1]
