"""Rehearsals of a small model, and what is said of them."""

import signal
from dataclasses import replace

import numpy as np
import pytest

from rehearsal_sample import RANGES, model
from servoscope.errors import InvalidInputError
from servoscope.poses import displacements_from_poses, inverse_transform, rigid_transform
from servoscope.rehearsal import OwnErrors, Rehearsal, TrueView
from servoscope.rehearsal.page import rehearsal_table
from servoscope.rehearsal.rendered_cell import cell_at_reference, cell_at_start
from servoscope.rehearsal.run import REHEARSED, as_keyframe_model, summarise_rehearsal, verdict
from servoscope.scoreboard.cell import CONDITIONS, start_direction
from servoscope.scoreboard.trial import Trial

EXACT = OwnErrors(np.zeros(6), 0.0)


def cell(condition, start=0):
    return cell_at_start(model(), EXACT, RANGES, condition, 0, start)


def trial(status: str, mm: float, moves: int = 3) -> Trial:
    return Trial(status, "", moves, [20.0, mm], [5.0, 0.01], [], [None] * 6, [None] * 6, [None] * 6)


def test_starts_are_those_of_the_scoreboard_in_shares_of_the_model_s_range():
    for condition, factor in (("range_1.0", 1.0), ("range_1.5", 1.5)):
        there = displacements_from_poses(np.eye(4), cell(condition, 4).pose[None], 0.5)[0]
        assert there == pytest.approx(factor * RANGES * start_direction(0, 4))


def test_the_camera_has_the_keyframe_s_noise_and_the_condition_s():
    for condition, deviation in (("range_1.0", 1.0), ("noise_10", np.hypot(1.0, 10.0))):
        robot = cell(condition)
        difference = robot.read().astype(float) - robot.read()
        assert difference.std() / np.sqrt(2) == pytest.approx(deviation, rel=0.1)


def test_without_noise_the_image_changes_with_the_pose_alone():
    robot = cell("covered_20")
    robot.noise, away = 0.0, rigid_transform(np.eye(3), [0.002, 0.0, 0.0])
    before, again = robot.read(), robot.read()
    robot.move(away)
    aside = robot.read()
    robot.move(inverse_transform(away))
    np.testing.assert_array_equal(before, again)
    assert (aside != before).mean() > 0.1
    assert np.abs(robot.read().astype(float) - before).max() <= 1


def test_what_covers_the_view_stays_where_it_is():
    robot, free = cell("covered_20"), cell("range_1.0")
    covered = np.abs(robot.read().astype(float) - free.read()) > 8
    assert covered.mean() == pytest.approx(0.2, abs=0.05)
    robot.move(inverse_transform(robot.pose))
    free.move(inverse_transform(free.pose))
    still = np.abs(robot.read().astype(float) - free.read()) > 8
    assert (covered & still).mean() > 0.15


def test_a_robot_that_scatters_does_not_know_where_it_is():
    robot = cell("repeatability")
    robot.move(rigid_transform(np.eye(3), [0.001, 0.0, 0.0]))
    assert 1e-6 < np.linalg.norm(robot.true_pose[:3, 3] - robot.pose[:3, 3]) < 3e-4


def test_the_robot_at_the_reference_sees_the_reference():
    robot, sample = cell_at_reference(model()), model()
    off = robot.read().astype(float) - sample.reference_image
    assert np.abs(off[1:-1, 1:-1]).mean() < 1.2


def test_a_model_arrives_on_its_own_view():
    found = Rehearsal(model(), starts=2).run("range_1.0", n_jobs=1)
    assert found["success"] == found["trials"] == 2
    assert found["final_mm_median"] < 0.5
    assert [start["succeeded"] for start in found["starts"]] == [True, True]
    assert found["starts"][1]["shares"] == pytest.approx(start_direction(0, 1), abs=1e-4)


def test_an_interruption_ends_the_rehearsal_and_not_only_a_start(monkeypatch):
    """The loop itself takes Ctrl-C for the end of a run."""
    reads = []

    def read_and_interrupt(self, displacement):
        reads.append(displacement)
        if len(reads) == 2:
            signal.raise_signal(signal.SIGINT)
        return self.keyframe.reference_image

    monkeypatch.setattr(TrueView, "image", read_and_interrupt)
    with pytest.raises(KeyboardInterrupt):
        Rehearsal(model(), starts=3).run("range_1.0", n_jobs=1)
    assert len(reads) <= 3


def test_a_view_without_depth_does_not_arrive():
    """Of a view that is far away a keyframe reads rotations alone."""
    far = model(relief=np.full((48, 64), 1e-6))
    found = Rehearsal(far, starts=1).run("range_1.0", n_jobs=1)
    assert found["success"] == 0
    assert found["final_mm_median"] > 1.0
    assert found["final_deg_median"] < 0.5


def test_late_images_do_not_keep_a_model_from_arriving():
    assert Rehearsal(model(), starts=1).run("stale_frames", n_jobs=1)["success"] == 1


def test_a_view_that_is_read_wrongly_at_every_distance_arrives_all_the_same():
    """Errors of the keyframe vanish at the reference, and so does what they do to the end."""
    wrong = model(model_error=np.array([3e-3, 3e-3, 6e-3, 0.01, 0.01, 0.01]))
    assert Rehearsal(wrong, starts=2).run("range_1.0", n_jobs=1)["success"] == 2


@pytest.mark.slow
def test_every_number_of_processes_gives_the_same():
    rehearsal = Rehearsal(model(), starts=3, seed=5)
    assert rehearsal.run("covered_10", n_jobs=1) == rehearsal.run("covered_10", n_jobs=2)


def test_the_range_is_the_one_that_images_were_asked_for_or_their_own_or_the_user_s():
    sample = model()
    asked = replace(sample, trained_on={"translation_mm": 12.0, "rotation_deg": 3.0})
    assert Rehearsal(sample).ranges == pytest.approx(RANGES)
    assert Rehearsal(asked).ranges == pytest.approx([0.012] * 3 + [np.radians(3)] * 3)
    user = Rehearsal(asked, range_mm=40.0)
    assert user.ranges == pytest.approx([0.04] * 3 + [np.radians(3)] * 3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"starts": 0},
        {"range_mm": -1.0},
        {"range_mm": 1e5},
        {"range_deg": np.nan},
        {"range_deg": 61.0},
    ],
)
def test_what_cannot_be_rehearsed_is_refused(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        Rehearsal(model(), **wrong)


def test_conditions_that_need_a_scene_are_refused():
    assert "other_casting" not in REHEARSED
    with pytest.raises(InvalidInputError, match="another part or robot"):
        Rehearsal(model()).run("other_casting")
    assert set(REHEARSED) < set(CONDITIONS)


def test_a_model_of_features_is_refused_with_what_to_do():
    with pytest.raises(InvalidInputError, match=r"m is a model of features.*--method keyframe"):
        as_keyframe_model(object(), "m")


def test_numbers_are_counted_with_wilson_s_interval():
    trials = [trial("converged", 0.1)] * 8 + [trial("converged", 5.0), trial("diverged", 90.0)]
    numbers = summarise_rehearsal(trials)
    assert (numbers["success"], numbers["wrongly_converged"]) == (8, 1)
    # Wilson (1927): (p + z^2 / 2n +- z sqrt(p q / n + z^2 / 4 n^2)) / (1 + z^2 / n)
    n, p, z = 10, 0.8, 1.959964
    half = z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    bounds = (p + z**2 / (2 * n) + np.array([-half, half])) / (1 + z**2 / n)
    assert numbers["success_interval"] == pytest.approx(bounds, abs=1e-4)
    table = rehearsal_table({"results": {"x": numbers}, "starts": 10, "ranges": {}})
    assert table.rows[0][:3] == ("x", "8/10", "49% to 94%")


def test_the_verdict_names_what_fails():
    good = summarise_rehearsal([trial("converged", 0.1)] * 20)
    bad = summarise_rehearsal([trial("converged", 0.1)] * 18 + [trial("converged", 4.0)] * 2)
    assert verdict({"range_1.0": good, "defocus": good}) == (
        "At least 95% of 20 starts arrive under every condition, which of all starts may be as few "
        "as 84%; no runs say 'converged' farther away."
    )
    said = verdict({"range_1.0": good, "covered_20": bad})
    assert "covered_20 (90%)" in said
    assert "2 runs say 'converged'" in said
