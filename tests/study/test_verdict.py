import copy

import numpy as np
import pytest

from servoscope.assessment.page import describe_agreement
from servoscope.poses import DOFS
from servoscope.selection import CRITERIA
from servoscope.study.page import (
    describe_accuracy,
    describe_chance,
    describe_criteria,
    describe_forecasts,
)
from servoscope.study.paper import table2
from servoscope.study.results import list_units
from servoscope.study.tables import (
    CRITERIA as CRITERION_NAMES,
)
from servoscope.study.tables import (
    criteria_table,
    information_table,
    redundancy_table,
)


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


def test_a_dof_that_the_mean_predicts_as_well_is_not_observable(summary):
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


@pytest.fixture
def unit(summary):
    return list_units(summary)[0]


def cell_of(unit, name, dof):
    (row,) = [row for row in information_table(unit).rows if row[0].text.endswith(f" {name}")]
    return row[1 + DOFS.index(dof)]


def test_values_that_are_no_more_than_chance_are_marked_and_counted(unit):
    first = table2("rz")[0]
    assert cell_of(unit, first, "rz").mark == "best"
    assert cell_of(unit, "e_34", "rz").mark == "chance"
    assert "the 384 of 390 values that do not differ from chance" in information_table(unit).caption


def test_every_value_has_its_corrected_one(unit):
    assert cell_of(unit, "e_34", "tx").beside == "-0.002"


def test_sentence_has_the_mean_of_the_dofs_at_steps_8_and_24(unit):
    for step in (7, 23):
        chance = {"redundancy": 3.1, "bias": 0.3, "unrelated": 2.0}
        unit.results["redundancy_bias"]["tx"][step] = chance
    sentence = describe_chance(unit.results)
    assert "step 8 the selected feature shares 1.10 bits" in sentence
    assert "of which 0.40 are bias (36 %); unrelated features would show 0.80." in sentence
    assert "step 24 the selected feature shares 2.43 bits" in sentence
    assert "7 × 0.058 = 0.41" in sentence


def test_the_corrected_rule_is_compared_with_the_published_one(unit):
    *_, same_steps, shared, features = redundancy_table(unit).rows[DOFS.index("tz")]
    published, corrected = unit.results["table2"]["tz"], unit.results["table2_corrected"]["tz"]
    assert published[3] != corrected[3]
    assert same_steps == "3"
    assert shared == f"{len(set(published) & set(corrected))} of {len(published)}"
    assert features.text.split()[1::2] == corrected[:8]


def test_dofs_that_never_move_and_steps_that_were_not_made_are_left_out(unit):
    unit.results["ranges"]["tx"]["value"] = None
    unit.results["redundancy_bias"]["ry"] = unit.results["redundancy_bias"]["ry"][:10]
    table = redundancy_table(unit)
    assert list(table.columns[:2]) == ["Dof", "Step 8"]
    assert "Step 24" not in table.columns
    assert [row[0] for row in table.rows] == ["Ty", "Tz", "Rx", "Ry", "Rz"]


def test_nothing_is_said_where_nothing_moves(unit):
    for dof in DOFS:
        unit.results["ranges"][dof]["value"] = None
    assert describe_chance(unit.results) == ""


def test_every_criterion_has_a_name_and_a_row(compared):
    rows = criteria_table(compared).rows
    assert [row[0] for row in rows] == [CRITERION_NAMES[name] for name in CRITERIA]


def test_the_least_of_each_column_is_marked(compared):
    compared["errors"]["jmi"]["ty"][1] = 0.001
    rows = criteria_table(compared).rows
    best = np.array([[cell.mark == "best" for cell in row[1:]] for row in rows])
    assert (best.sum(axis=0) == 1).all()
    assert best[-1].tolist() == [True] * 5 + [False] + [True] * 4
    assert rows[2][6].value == 0.001
    assert rows[0][5].value == pytest.approx(0.2)  # of eight features


def test_sentence_names_the_criterion_that_errs_least(compared):
    sentence = describe_criteria(compared)
    assert "selected by forecast error: 0.050 of the range" in sentence
    assert "against 0.200 by the published ideal-point rule" in sentence
    assert "All candidates together reach 0.012" in sentence


def test_the_published_rule_is_not_compared_with_itself(compared):
    for errors in compared["errors"]["ideal_point"].values():
        errors[1] = 0.001
    assert "against" not in describe_criteria(compared)


def test_agreement_is_in_rank_ratio_and_share():
    reached = np.arange(1.0, 21.0)
    forecast = reached * np.repeat([0.7, 1.1], [5, 15])
    said = describe_agreement(np.column_stack([forecast, reached]))
    assert "Of 20 forecasts, 75 % lie within 0.75 and 1.33" in said
    assert "median ratio is 1.10, the rank correlation 1.00" in said


def test_few_forecasts_say_nothing(compared):
    assert describe_forecasts(compared["forecasts"][:11]) == ""
    assert "the median ratio is 0.90" in describe_forecasts(compared["forecasts"])
