"""What the page of a rehearsal answers first."""

import pytest

from page_samples import condition, rehearsal
from servoscope.rehearsal.page import rehearsal_verdict


def test_where_all_arrive_the_robot_may_be_positioned():
    verdict = rehearsal_verdict(rehearsal())
    assert verdict.state == "yes"
    assert verdict.answer == "Yes. Where it arrives."
    assert "servoscope position" in verdict.next_step


@pytest.mark.parametrize("weak", [condition(3), condition(4, n_wrong=1)])
def test_few_that_arrive_or_one_that_is_wrong_are_a_no(weak):
    named = rehearsal_verdict(rehearsal(**{"range_1.0": condition(4), "noise_10": weak}))
    assert named.state == "no"
    assert named.next_step.startswith("keep noise_10 away from the robot, or rehearse from nearer")
    plain = rehearsal_verdict(rehearsal(**{"range_1.0": weak}))
    assert plain.next_step.startswith("rehearse from nearer")
