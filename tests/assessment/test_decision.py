"""Budgets, grades, conclusions and advice."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.assessment.advice import Findings, advise
from servoscope.assessment.result import _warnings
from servoscope.assessment.verdict import (
    REPEATING,
    UNPREDICTED,
    VIEW,
    ErrorBudget,
    conclude,
    grade,
    name_limit,
    share_out,
)
from servoscope.poses import DOFS

errors = st.floats(0, 10)


@given(st.floats(0.01, 10), errors, errors, errors, errors)
def test_shares_are_positive_and_come_to_one(rms, noise, labels, more, best):
    budget = share_out(rms, noise=noise, labels=labels, at_ten_times=more, best_regressor=best)
    shares = list(asdict(budget).values())
    assert sum(shares) == pytest.approx(1.0)
    assert min(shares) >= -1e-12


def test_independent_parts_add_in_squares():
    budget = share_out(5.0, noise=3.0, labels=0.0, at_ten_times=5.0, best_regressor=5.0)
    assert budget.noise == pytest.approx(9 / 25)
    assert budget.weak_features == pytest.approx(16 / 25)


def test_no_error_is_shared_out_too():
    budget = share_out(0.0, noise=0.0, labels=0.0, at_ten_times=0.0, best_regressor=0.0)
    assert budget.weak_features == 1.0


@pytest.mark.parametrize(
    ("rms", "observable"),
    [(0.25, "well"), (0.26, "roughly"), (0.6, "roughly"), (0.7, "hardly"), (0.95, "not")],
)
def test_grades_are_shares_of_the_error_of_the_mean(rms, observable):
    assert grade(rms) == observable


BUDGET = ErrorBudget(0.1, 0.1, 0.5, 0.1, 0.2)


def test_a_repeating_pattern_is_blamed_only_where_errors_cluster_at_its_period():
    assert name_limit("hardly", BUDGET, is_at_period=True) == REPEATING
    assert name_limit("hardly", BUDGET) == "too few images"
    assert name_limit("not", BUDGET) == UNPREDICTED


def test_features_are_weak_only_where_the_view_allows_much_more():
    assert name_limit("hardly", BUDGET, rms=1.0, view_limit=0.6) == VIEW
    assert name_limit("well", BUDGET, rms=1.0, view_limit=0.1) == "too few images"


def _rows(letters, tolerances=None, loop=None):
    """Rows of `as_json` by the first letters of their grades."""
    words = {"w": "well", "r": "roughly", "h": "hardly", "n": "not", "s": "still"}
    rows = {}
    for dof, letter in zip(DOFS, letters, strict=True):
        tolerance = None if tolerances is None else tolerances.get(dof)
        rows[dof] = {
            "observable": words[letter],
            "forecast_rms": None if letter == "s" else 1.0,
            "tolerance": tolerance,
            "advice": [f"help {dof}"],
            "met_in_one_look": None if tolerance is None else tolerance >= 1.0,
            "met_in_loop": None if tolerance is None else bool(loop) and tolerance >= 0.1,
        }
    return rows


LOOP = {"success": 1.0, "starts": 8, "moves": 3, "end_mm": 0.031, "end_deg": 0.0042}


def test_the_verdict_counts_the_tolerances_that_are_met():
    tolerances = dict.fromkeys(("tx", "ty", "tz"), 0.5) | {"rx": 0.01, "ry": 0.01, "rz": 2.0}
    assert conclude(_rows("wwwwww", tolerances, LOOP), LOOP) == (
        "4 of 6 tolerances met in the loop, 1 of 6 in one look; next: help rx."
    )
    assert conclude(_rows("wwwwww", tolerances), None) == (
        "1 of 6 tolerances met in one look; the loop is not forecast, as no keyframe explains the "
        "view; next: help tx."
    )
    assert conclude(_rows("wwwwww", {"tx": 0.5}, LOOP), LOOP).endswith(
        "next: train a model, servoscope train."
    )


def test_a_loop_that_not_all_starts_survive_is_not_recommended():
    few = {**LOOP, "success": 0.5}
    said = conclude(_rows("wwwwww", {"tx": 0.5}), few)
    assert "0 of 1 tolerances met in the loop" in said
    assert said.endswith(
        "4 of 8 rehearsed starts arrive; next: train a model, servoscope train, and rehearse it "
        "from nearer."
    )


def test_without_tolerances_the_verdict_says_where_the_loop_ends():
    assert conclude(_rows("wwrhns"), LOOP) == (
        "The loop is forecast to end 0.031 mm and 0.0042 deg from the reference; 8 of 8 rehearsed "
        "starts arrive. From features, one image each: tx and ty well observable; tz roughly "
        "observable; rx hardly observable; ry not observable."
    )
    assert "not safe: 4 of 8" in conclude(_rows("wwwwww"), {**LOOP, "success": 0.5})
    assert conclude(_rows("ssssss"), None) == (
        "Nothing can be learned from these images: nothing moves."
    )


FOUND = Findings(
    unit="mm",
    rms=1.0,
    reached=1.0,
    baseline=10.0,
    tolerance=None,
    n_images=750,
    observable="well",
    at_twice=1.0,
    at_five_times=1.0,
    images_for_tolerance=None,
    without_border=1.0,
    inner=1.0,
    period_px=None,
    at_random=None,
    disturbed={},
)


def test_nothing_is_said_where_nothing_would_help():
    assert advise(FOUND) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tolerance": 0.5, "images_for_tolerance": 2000}, "about 1200 more images bring 0.5 mm"),
        (
            {"tolerance": 0.5, "at_five_times": 0.8},
            "images alone do not bring 0.5 mm: five times as many bring 0.8 mm",
        ),
        (
            {"at_twice": 0.7, "at_five_times": 0.4},
            "twice the images bring 0.7 mm, five times 0.4 mm",
        ),
        (
            {"without_border": 2.0},
            "a wider view: without the outer fifth of this one it",
        ),
        ({"without_border": 0.5}, "the middle four fifths alone reach 0.5 mm"),
        ({"inner": 0.4}, "within half the range it is 0.4 mm"),
        ({"rms": 113.4, "loop": 0.0123}, "the loop ends at 0.012 mm"),
        ({"reached": 113.4, "keyframe": 50.0}, "50 mm from one image"),
        ({"period_px": 50.0}, "the view repeats every 50 px"),
        ({"tolerance": 1.0, "reached": 1.5}, "the 1.5 mm of the test images do not"),
        ({"disturbed": {"gain 0.8": 1.9, "another light": 30.0}}, "another light makes it 30 mm"),
        ({"at_random": 0.1}, "taken for independent they promise 0.1 mm"),
    ],
)
def test_advice_has_its_number(change, said):
    assert any(said in line for line in advise(replace(FOUND, **change)))


def test_what_helps_most_comes_first():
    found = replace(FOUND, inner=0.5, without_border=4.0, at_twice=0.8, at_five_times=0.7)
    starts = [line.split()[0] for line in advise(found)]
    assert starts == ["a", "approach", "twice"]


def test_beside_a_keyframe_it_is_said_which_advice_is_for_features():
    found = replace(FOUND, keyframe=0.01, loop=0.02, at_twice=0.7, at_five_times=0.4)
    assert advise(found) == [
        "position by a keyframe: the loop ends at 0.02 mm",
        "from features, twice the images bring 0.7 mm, five times 0.4 mm",
    ]


@pytest.mark.parametrize(
    ("kind", "loop", "is_said"),
    [("sequence", {}, True), ("sequence", None, False), ("independent", {}, False)],
)
def test_of_a_sequence_it_is_said_what_the_end_of_the_loop_leaves_out(kind, loop, is_said):
    found = SimpleNamespace(
        sample=SimpleNamespace(n_rendered=0),
        independence=SimpleNamespace(kind=kind),
        view=SimpleNamespace(loop=loop),
        images=SimpleNamespace(repetition=SimpleNamespace(repeats=False), n_copies=0),
    )
    assert is_said == any("noise of the pixels alone" in line for line in _warnings(found))


def test_of_what_no_feature_predicts_another_view_is_advised():
    found = replace(FOUND, observable="not", rms=9.2, inner=0.1, at_five_times=0.1)
    (line,) = advise(found)
    assert line.startswith("no feature predicts it better than its mean, 10 mm")


def test_where_the_view_is_the_limit_no_other_features_are_asked_for():
    found = replace(FOUND, tolerance=0.01, view_limit=0.05, at_five_times=0.1, inner=0.1)
    (line,) = advise(found)
    assert "no image of this view tells it better than 0.05 mm" in line


def test_where_a_keyframe_meets_the_tolerance_no_more_images_are_asked_for():
    found = replace(FOUND, tolerance=0.1, loop=0.02, at_five_times=0.1, inner=0.1)
    assert advise(found) == ["position by a keyframe: the loop ends at 0.02 mm"]


def test_no_more_than_three_lines_are_advised_and_none_has_an_exponent():
    found = replace(
        FOUND, rms=500.0, reached=500.0, inner=123.4, without_border=2000.0, at_twice=400.0,
        at_five_times=300.0, at_random=110.0, keyframe=150.0, disturbed={"gain 0.8": 9e3},
    )  # fmt: skip
    lines = advise(found)
    assert len(lines) == 3
    assert not any("e+" in line for line in lines)


def test_two_stages_are_advised_only_where_the_first_brings_it_near():
    hardly = replace(FOUND, observable="hardly", inner=0.4)
    assert not any("two stages" in line for line in advise(hardly))


def test_a_repeating_pattern_comes_before_all_other_advice():
    found = replace(FOUND, observable="not", rms=9.5, period_px=50.0)
    assert advise(found)[0].startswith("the view repeats every 50 px")
