"""Budgets, grades, conclusions and advice."""

from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.assessment.advice import Findings, advise
from servoscope.assessment.budget import ErrorBudget, share_out
from servoscope.assessment.repetition import Repetition
from servoscope.assessment.verdict import REPEATING, UNTOLD, conclude, grade, name_limit
from servoscope.poses import DOFS

errors = st.floats(0, 10)
UNIQUE, TILED = Repetition(0.2, (9.0, 0.0)), Repetition(0.9, (30.0, 40.0))


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
    ("rms", "told"),
    [(0.25, "well"), (0.26, "roughly"), (0.6, "roughly"), (0.7, "hardly"), (0.95, "not")],
)
def test_grades_are_shares_of_the_error_of_the_mean(rms, told):
    assert grade(rms) == told


def test_a_repeating_pattern_is_blamed_where_a_dof_is_not_told_well():
    budget = ErrorBudget(0.1, 0.1, 0.5, 0.1, 0.2)
    assert name_limit("well", budget, TILED) == "too few images"
    assert name_limit("hardly", budget, TILED) == REPEATING
    assert name_limit("not", budget, UNIQUE) == UNTOLD


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (
            "hhhwww",
            "Rotations are told, translations are not (10 % and 80 % of the error of the mean are "
            "left): tx, ty and tz hardly.",
        ),
        (
            "rhnwrh",
            "Rotations are told, translations are not (34 % and 74 % of the error of the mean are "
            "left): ty and rz hardly, tz not at all.",
        ),
        (
            "wwwnnn",
            "Translations are told, rotations are not (10 % and 100 % of the error of the mean are "
            "left): rx, ry and rz not at all.",
        ),
        ("wwwwww", "Every degree of freedom is told well."),
        ("wwrwww", "Every degree of freedom is told, tz only roughly."),
        ("whwwnw", "tx, tz, rx and rz are told; ty hardly, ry not at all."),
        (
            "hhhhhn",
            "Little can be learned from these images: tx, ty, tz, rx and ry hardly, rz not at all.",
        ),
        ("nnnnnn", "Nothing can be learned from these images."),
        ("sssrrr", "Every degree of freedom that moves is told, rx, ry and rz only roughly."),
        ("ssssss", "Nothing can be learned from these images: nothing moves."),
    ],
)
def test_the_conclusion_is_one_sentence(told, said):
    shares = {"w": 0.1, "r": 0.5, "h": 0.8, "n": 1.0}
    assert conclude({d: shares[t] for d, t in zip(DOFS, told, strict=True) if t != "s"}) == said


FOUND = Findings(
    unit="mm",
    rms=1.0,
    reached=1.0,
    baseline=10.0,
    wished=None,
    n_images=750,
    told="well",
    share_left=0.1,
    family="cosine coefficients",
    others={},
    at_twice=1.0,
    at_five_times=1.0,
    images_for_wish=None,
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
        ({"wished": 0.5, "images_for_wish": 2000}, "about 1200 more images bring 0.5 mm"),
        (
            {"wished": 0.5, "at_five_times": 0.8},
            "images alone do not bring 0.5 mm: five times as many bring 0.8 mm",
        ),
        (
            {"at_twice": 0.7, "at_five_times": 0.4},
            "twice the images bring 0.7 mm, five times 0.4 mm",
        ),
        (
            {"without_border": 2.0},
            "a wider view helps: without the outer fifth of this one it",
        ),
        ({"without_border": 0.5}, "the middle four fifths alone reach 0.5 mm"),
        ({"inner": 0.4}, "within half the range it is 0.4 mm"),
        ({"told": "hardly", "share_left": 0.75}, "told well once it moves 4.4 times as far"),
        ({"others": {"geometric moments": 1.5}}, "geometric moments would reach 1.5 mm"),
        ({"period_px": 50.0, "told": "hardly"}, "repeats every 50 px"),
        ({"wished": 1.0, "reached": 1.5}, "the 1.5 mm of the test images do not"),
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


def test_of_what_is_not_told_nothing_but_another_view_or_range_is_advised():
    found = replace(FOUND, told="not", rms=9.2, share_left=0.92, inner=0.1, at_five_times=0.1)
    starts = [line.split(":")[0] for line in advise(found)]
    assert starts == ["nothing here tells it", "a longer range"]
    assert "10 mm is what answering the mean reaches" in advise(found)[0]
    assert len(advise(replace(found, share_left=0.99))) == 1
    assert len(advise(replace(found, share_left=1.01))) == 1


@pytest.mark.parametrize("noise", [0.3, 1.0, 2.5])
def test_over_the_advised_range_a_noisy_linear_feature_tells_a_dof_well(noise):
    # A target of unit spread from a feature with that noise: the error of the best guess.
    share = noise / (1 + noise**2) ** 0.5
    found = replace(FOUND, told=grade(share), share_left=share)
    (line,) = [line for line in advise(found) if "a longer range" in line]
    farther = float(line.split("moves ")[1].split(" times")[0])
    assert noise / (farther**2 + noise**2) ** 0.5 == pytest.approx(0.25, rel=0.05)


def test_two_stages_are_advised_only_where_the_first_brings_it_near():
    hardly = replace(FOUND, told="hardly", share_left=0.75, inner=0.4)
    assert not any("two stages" in line for line in advise(hardly))


def test_other_features_are_named_only_where_they_are_worse():
    assert advise(replace(FOUND, others={"geometric moments": 0.95})) == []


def test_a_repeating_pattern_comes_before_all_other_advice():
    found = replace(FOUND, told="not", rms=9.5, period_px=50.0)
    assert advise(found)[0].startswith("the view repeats every 50 px")
