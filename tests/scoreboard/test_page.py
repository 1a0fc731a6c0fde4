"""What the page of a scoreboard answers first."""

from page_samples import scoreboard, target
from servoscope.scoreboard.page import overview_table, scoreboard_verdict


def test_reached_targets_are_a_yes():
    verdict = scoreboard_verdict(scoreboard(target(True), target(True)))
    assert (verdict.state, verdict.answer) == ("yes", "Yes, servoscope reaches all 2 targets.")


def test_missed_targets_are_named_with_what_was_wanted():
    verdict = scoreboard_verdict(scoreboard(target(True), *[target(False, 9.0)] * 3))
    assert verdict.state == "no"
    assert verdict.answer.startswith("No, servoscope misses 3 of 4 targets: textured plane, range")
    assert "median moves: 9, wanted <= 6" in verdict.answer
    assert verdict.answer.endswith("; and 1 more.")


def test_conditions_count_together_and_the_end_is_of_the_full_range():
    first, *others = overview_table(scoreboard()).rows
    assert first == ["Textured plane: ours", "6/8", "0.02", "4"]
    assert len(others) == 2
