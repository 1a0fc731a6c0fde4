"""What the page of an assessment answers first."""

import pytest

from page_samples import LOOP, assessed
from servoscope.assessment.page import assessment_verdict, decision_table
from servoscope.poses import DOFS


def test_met_tolerances_are_a_yes_and_the_next_step_is_named():
    verdict = assessment_verdict(assessed())
    assert verdict.state == "yes"
    assert verdict.answer == "Yes, accurate enough: 6 of 6 tolerances met in the loop."
    assert verdict.next_step == "train a model."


@pytest.mark.parametrize(
    "found",
    [
        assessed("5 of 6 tolerances met in the loop", "come nearer", end=0.6),
        assessed("0 of 6 tolerances met in one look", "take more", loop=None, tolerance=0.2),
        assessed("Nothing can be learned", "", loop=None)
        | {"dofs": {dof: assessed()["dofs"][dof] | {"forecast_rms": None} for dof in DOFS}},
    ],
)
def test_one_missed_tolerance_and_images_of_no_use_are_a_no(found):
    verdict = assessment_verdict(found)
    assert verdict.state == "no"
    assert verdict.answer.startswith("No, not accurate enough yet: ")
    assert verdict.next_step.endswith(".")
    assert len(verdict.next_step) > 5


def test_of_one_look_alone_its_tolerances_decide():
    assert assessment_verdict(assessed(loop=None)).state == "yes"


def test_without_tolerances_the_answer_is_open_and_they_are_asked_for():
    verdict = assessment_verdict(assessed("The loop ends 0.01 mm away", "", tolerance=None))
    assert verdict.state == "open"
    assert verdict.answer.startswith("No tolerance was given. The loop ends")
    assert "--tolerance" in verdict.next_step


def test_a_loop_in_which_starts_are_lost_meets_nothing():
    table = decision_table(assessed(loop=LOOP | {"success": 0.75}))
    for row in table.rows:
        assert row[2].mark == "missed"
        assert row[2].below == "only 6 of 8 arrive"


def test_missed_and_met_are_said_in_words():
    met, missed = (decision_table(assessed(tolerance=t)).rows[0][3] for t in (0.3, 0.2))
    assert (met.text, met.below, met.mark) == ("0.3 mm", "0.2 to 0.4, met", "")
    assert (missed.below, missed.mark) == ("0.2 to 0.4, missed", "missed")
