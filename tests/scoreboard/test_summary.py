"""The numbers of the scoreboard, from trials that were made up."""

import json

import numpy as np
import pytest

from servoscope.scoreboard.summary import check_targets, summarise
from servoscope.scoreboard.trial import Trial

REQUIRED = {
    "success",
    "trials",
    "moves_median",
    "final_mm_median",
    "final_deg_median",
    "final_mm_p95",
    "start_mm_median",
    "decision_ms_median",
    "status_counts",
}


def made_up(
    *path_mm: float, deg: float = 0.01, status: str = "converged", ms: float = 2.0, **belief
) -> Trial:
    n = len(path_mm)
    values = {"believed": [None] * 6, "std": [None] * 6, "truth": [0.0] * 6, **belief}
    return Trial(status, "", n - 1, list(path_mm), [deg] * n, [ms] * n, **values)


def test_numbers_are_counts_and_medians() -> None:
    trials = [
        made_up(100.0, 0.9, 0.2),
        made_up(50.0, 5.0, 0.5, 0.4),
        made_up(80.0, 0.9, 3.0, status="max_moves", ms=8.0),
        made_up(60.0, 0.3, deg=0.2),
    ]
    numbers = summarise(trials)
    assert numbers.keys() >= REQUIRED
    assert (numbers["success"], numbers["trials"]) == (2, 4)
    assert numbers["moves_median"] == 2.5
    assert numbers["moves_to_success_median"] == 1
    assert numbers["final_mm_median"] == pytest.approx(0.35)
    assert numbers["final_mm_p95"] == pytest.approx(np.percentile([0.2, 0.4, 3.0, 0.3], 95))
    assert numbers["start_mm_median"] == 70
    assert numbers["decision_ms_median"] == 2
    assert numbers["status_counts"] == {"converged": 3, "max_moves": 1}
    assert numbers["predicted"] is None
    json.dumps(numbers, allow_nan=False)


def test_without_a_success_no_moves_are_told() -> None:
    numbers = summarise([made_up(9.0, 8.0)])
    assert numbers["success"] == 0
    assert numbers["moves_median"] is None


def test_without_a_decision_none_are_timed() -> None:
    blind = Trial("camera_fault", "black", 0, [50.0], [5.0], [], [None] * 6, [None] * 6, [0.0] * 6)
    assert summarise([blind])["decision_ms_median"] is None
    targets = check_targets("x", {"range_1.0": {"ours": [blind], "photometric": [blind]}})
    assert by_words(targets)["range_1.0 median decision"] is False


def test_a_prediction_is_held_against_the_truth() -> None:
    rng = np.random.default_rng(0)
    std = np.full(6, 0.5)
    trials = [
        made_up(9.0, 0.1, believed=[0.0] * 6, std=std.tolist(), truth=error.tolist())
        for error in rng.normal(0, 0.5, (400, 6))
    ]
    predicted = summarise(trials)["predicted"]
    assert predicted["trials"] == 400
    assert predicted["within_2_std"] == pytest.approx(0.954, abs=0.02)
    assert predicted["error_over_std_median"] == pytest.approx(0.674, abs=0.05)


def board(n_success: int, *, n: int = 100, end: float = 0.05, moves: int = 4, ms: float = 5.0):
    good = made_up(*[90.0] * moves, end, ms=ms)
    ours = [good] * n_success + [made_up(90.0, 2.0, ms=ms)] * (n - n_success)
    return {"ours": ours, "photometric": [made_up(90.0, 0.1)] * 40}


def by_words(targets) -> dict[str, bool]:
    return {f"{t.condition} {t.what.split()[0]} {t.what.split()[1]}": t.reached for t in targets}


def test_targets_are_reached_at_their_bounds_and_missed_below() -> None:
    reached = by_words(check_targets("cylinder_head", {"range_1.0": board(99)}))
    assert all(reached.values())
    assert len(reached) == 5
    missed = by_words(
        check_targets("cylinder_head", {"range_1.0": board(98, end=0.2, moves=7, ms=16.0)})
    )
    assert [name for name, ok in missed.items() if ok] == ["all starts that"]
    for condition, least in (("gain_0.8", 95), ("range_1.5", 90), ("repeatability", 95)):
        for n_success, expected in ((least, True), (least - 1, False)):
            reached = by_words(check_targets("x", {condition: board(n_success)}))
            assert reached[f"{condition} share that"] is expected


def test_ends_are_compared_from_the_starts_that_both_have() -> None:
    trials = board(100)
    trials["ours"] = [made_up(90.0, 0.05)] * 40 + [made_up(90.0, 0.9)] * 60
    (end,) = (t for t in check_targets("x", {"range_1.0": trials}) if t.what.startswith("median e"))
    assert end.got == 0.05
    assert end.reached


def test_who_ends_farther_away_must_have_been_stopped() -> None:
    for status, expected in (("converged", False), ("max_moves", False), ("diverged", True)):
        away = made_up(9.0, 20.0, status=status)
        targets = check_targets("x", {"defocus": {"ours": [away], "photometric": []}})
        assert by_words(targets) == {"all starts that": expected}
