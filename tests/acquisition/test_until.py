"""Images are taken until the forecast meets what is asked, whoever takes them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from layered_world import MOUNT, photographs
from servoscope import AcquisitionConfig, acquire
from servoscope.acquisition import until as acquisition_until
from servoscope.acquisition.until import (
    FIRST,
    NEXT,
    acquire_until,
    spread_displacements,
    take_until,
)
from servoscope.cli import main
from servoscope.data.folder import KEPT_IMAGES, Progress, keep_image, write_progress
from servoscope.data.images import PoseImageSet
from servoscope.dofs import RequestedAccuracy, parse_accuracy
from servoscope.errors import FolderExistsError, InvalidInputError
from servoscope.keyframe import Keyframe, next_displacements
from servoscope.poses import (
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
)
from small_keyframe import quick_fits

PIVOT = 0.1
RANGES = np.array([0.02] * 3 + [np.radians(8)] * 3)
REFERENCE = photographs(np.eye(4)[None], 99)[0]
EASY = RequestedAccuracy(5e-3, np.radians(2))
HARD = RequestedAccuracy(2e-5, np.radians(5e-3))
HOPELESS = RequestedAccuracy(1e-7, np.radians(1))


class Robot:
    """Takes images of the printed plates, and counts its moves."""

    def __init__(self) -> None:
        self.asked: list[np.ndarray] = []

    def take(self, start: int, delta_p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        assert start == len(self.asked)
        self.asked += list(delta_p)
        flange = poses_from_displacements(np.eye(4), delta_p, PIVOT)
        images = photographs(inverse_transform(MOUNT) @ flange @ MOUNT, start)
        return images, flange


@pytest.fixture(scope="module", autouse=True)
def fitted_once():
    """A keyframe is fitted to the same images once: that takes most of the time."""
    fit, found = acquisition_until._standing, {}

    def standing(images, poses, reference_image, T_world_ref, request, *settings):
        key = images.tobytes(), poses.tobytes()
        if key not in found:
            found[key] = fit(images, poses, reference_image, T_world_ref, request, *settings)
        return replace(found[key], request=request)

    with quick_fits(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(acquisition_until, "_standing", standing)
        yield


def take(request, most=FIRST + NEXT, taken=None, robot=None, standings=None):
    robot = Robot() if robot is None else robot
    options = {} if standings is None else {"on_standing": standings.append}
    return take_until(
        robot.take, REFERENCE, np.eye(4), request, pivot=PIVOT, ranges=RANGES, most=most,
        pose_noise=(2e-5, 2e-5), taken=taken, n_jobs=1, **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def whole():
    """All that is allowed is taken, since the request is not met."""
    robot, standings = Robot(), []
    return robot, standings, take(HARD, robot=robot, standings=standings)


@pytest.mark.slow
def test_what_is_asked_in_vain_takes_the_most_images_and_says_which_dof_lacks(whole):
    robot, standings, (images, poses, standing) = whole
    assert [s.n_images for s in standings] == [FIRST, FIRST + NEXT]
    assert len(images) == len(poses) == len(robot.asked) == FIRST + NEXT
    assert standing.lacking
    dof, ratio = max(standing.lacking.items(), key=lambda item: item[1])
    assert ratio > 1
    assert f"{dof} {ratio:.2f} times" in str(standing)
    assert standing.facts()["met"] is False


@pytest.mark.slow
def test_forecasts_are_near_the_errors_of_other_images(whole):
    _, _, (_, _, standing) = whole
    rng = np.random.default_rng(4)
    truth = rng.uniform(-1, 1, (24, 6)) * RANGES
    flange = poses_from_displacements(np.eye(4), truth, PIVOT)
    images = photographs(inverse_transform(MOUNT) @ flange @ MOUNT, 77)
    errors = [standing.keyframe.align(image).delta_p for image in images] - truth
    ratio = standing.forecast.look / np.median(np.abs(errors), axis=0)
    assert (ratio > 0.5).all()
    assert (ratio < 4).all()
    assert (standing.forecast.end < standing.forecast.look).all()
    assert (standing.forecast.limit < standing.forecast.end).all()


@pytest.mark.slow
def test_an_interrupted_acquisition_asks_for_the_same_displacements(whole):
    robot, _, (images, poses, _) = whole
    again = Robot()
    again.asked = robot.asked[: FIRST + 4]

    def stop(start, delta_p):
        assert start == FIRST + 4
        np.testing.assert_array_equal(delta_p, robot.asked[start:])
        raise KeyboardInterrupt

    again.take = stop
    with pytest.raises(KeyboardInterrupt):
        take(HARD, taken=(images[: FIRST + 4], poses[: FIRST + 4]), robot=again)


@pytest.mark.slow
def test_it_stops_at_once_when_the_request_is_met_or_the_view_does_not_allow_it(whole):
    _, _, (images, poses, _) = whole
    first = (images[:FIRST], poses[:FIRST])
    _, _, met = take(EASY, taken=first)
    assert met.n_images == FIRST
    assert "the request is met" in str(met)
    _, _, vain = take(HOPELESS, taken=first)
    assert vain.n_images == FIRST
    assert set(vain.unreachable) == {"tx", "ty", "tz"}
    factor = vain.forecast.limit[2] / HOPELESS.translation
    assert vain.unreachable["tz"] == pytest.approx(factor)
    assert f"tz {factor:.2f} times what is asked" in str(vain)
    assert len(str(vain).splitlines()) == 1


@pytest.mark.slow
def test_next_images_lie_within_the_range_and_apart_from_those_there_are(whole):
    _, standings, (_, poses, _) = whole
    keyframe = standings[0].keyframe
    chosen = next_displacements(keyframe, NEXT, RANGES, random_state=3)
    np.testing.assert_array_equal(
        chosen, next_displacements(keyframe, NEXT, RANGES, random_state=3)
    )
    assert (np.abs(chosen) <= RANGES).all()
    there = displacements_from_poses(np.eye(4), poses[:FIRST], PIVOT) / RANGES
    drawn = np.random.default_rng(8).uniform(-1, 1, (200, 6))

    def apart(points):
        return np.linalg.norm(points[:, None] - there, axis=2).min(axis=1)

    assert apart(chosen / RANGES).mean() > np.quantile(apart(drawn), 0.7)


def test_what_cannot_be_chosen_is_refused():
    keyframe = Keyframe.__new__(Keyframe)
    with pytest.raises(InvalidInputError, match="n must be a whole number from 1"):
        next_displacements(keyframe, 0, RANGES)
    with pytest.raises(InvalidInputError, match="ranges must be six positive numbers"):
        next_displacements(keyframe, 3, -RANGES)


def test_first_displacements_are_spread_over_the_range():
    spread = spread_displacements(FIRST, RANGES, 1) / RANGES
    assert spread.shape == (FIRST, 6)
    assert np.abs(spread).max() <= 1
    assert (np.abs(np.mean(spread > 0, axis=0) - 0.5) < 0.1).all()
    assert (spread != spread_displacements(FIRST, RANGES, 2) / RANGES).any()


@pytest.mark.parametrize(
    ("text", "mm", "deg"),
    [("t=0.1mm,r=0.02deg", 0.1, 0.02), ("r=1e-2rad, t=0.0005m", 0.5, np.degrees(0.01))],
)
def test_accuracies_are_read_in_their_units(text, mm, deg):
    expected = [1e-3 * mm] * 3 + [np.radians(deg)] * 3
    np.testing.assert_allclose(parse_accuracy(text).by_dof, expected)
    again = parse_accuracy(str(parse_accuracy(text)))
    np.testing.assert_allclose(again.by_dof, expected, rtol=1e-5)


@pytest.mark.parametrize(
    "text", ["", "0.1", "t=0.1mm", "t=0mm,r=1deg", "t=-1mm,r=1deg", "t=1deg,r=1mm", "t=1mm,t=1mm",
             "t=nanmm,r=1deg", "t=1e999mm,r=1deg", "t=1mm,r=1deg,x=3", "t=..mm,r=1deg"],
)  # fmt: skip
def test_what_is_no_accuracy_is_refused_in_one_line(text, tmp_path, capsys):
    with pytest.raises(InvalidInputError, match=r"accuracy|tolerance|named twice"):
        parse_accuracy(text)
    assert main(["acquire", str(tmp_path / "out"), "--until", text]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


SMALL = AcquisitionConfig(n_images=FIRST, image_size=48, seed=1, part="textured_plane")


@pytest.mark.slow
def test_a_kill_at_any_image_loses_none_and_ends_with_the_same(tmp_path: Path, capsys) -> None:
    whole = acquire_until(tmp_path / "whole", SMALL, EASY, n_jobs=1)

    def stop(n_done: int) -> None:
        if n_done == 9:
            raise KeyboardInterrupt

    counts: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        acquire_until(tmp_path / "out", SMALL, EASY, n_jobs=1, on_progress=stop)
    with pytest.raises(FolderExistsError, match="other settings"):
        acquire_until(tmp_path / "out", SMALL, HARD, n_jobs=1)
    again = acquire_until(tmp_path / "out", SMALL, EASY, n_jobs=1, on_progress=counts.append)
    assert counts == list(range(10, FIRST + 1))
    np.testing.assert_array_equal(again.images, whole.images)
    np.testing.assert_array_equal(again.T_world_cam, whole.T_world_cam)
    assert again.source == whole.source
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"meta.json", "poses.csv"}
    assert not (tmp_path / "out" / KEPT_IMAGES).exists()
    assert not (tmp_path / "out" / "acquisition.json").exists()
    with pytest.raises(FolderExistsError):
        acquire_until(tmp_path / "out", SMALL, HARD, n_jobs=1)
    asked = ["--until", str(EASY), "--n-images", str(FIRST), "--image-size", "48", "--seed", "1"]
    asked += ["--part", "textured_plane", "--jobs", "1", "--json"]
    assert main(["acquire", str(tmp_path / "out"), *asked]) == 0  # there is nothing left to take
    facts = json.loads(capsys.readouterr().out)
    assert facts["images"] == FIRST
    assert facts["forecast"]["met"] is True
    assert isinstance(PoseImageSet.load(tmp_path / "out"), PoseImageSet)


def test_what_is_replaced_leaves_no_images_that_an_unfinished_acquisition_kept(tmp_path):
    write_progress(tmp_path, Progress({"until": "other"}, 1))
    keep_image(tmp_path, 0, np.zeros((48, 48), np.uint8), np.eye(4), 0)
    config = AcquisitionConfig(n_images=2, image_size=48, part="textured_plane")
    assert len(acquire(tmp_path, config, n_jobs=1, force=True)) == 2
    assert not (tmp_path / KEPT_IMAGES).exists()


def test_images_that_no_acquisition_kept_are_not_adopted(tmp_path):
    keep_image(tmp_path, 0, np.zeros((48, 48), np.uint8), np.eye(4), 0)
    with pytest.raises(FolderExistsError, match=f"{KEPT_IMAGES} that is no part of a data set"):
        acquire_until(tmp_path, SMALL, EASY, n_jobs=1)
    assert [path.name for path in (tmp_path / KEPT_IMAGES).iterdir()] == ["000000.npz"]


def test_until_takes_no_schedule_and_no_fewer_images_than_a_first_look(tmp_path, capsys):
    out = str(tmp_path / "out")
    for more, said in (
        (["--schedule", "40@1.0"], "leave --schedule out"),
        (["--n-images", "3"], "at least 15 images"),
    ):
        assert main(["acquire", out, "--until", "t=1mm,r=1deg", *more]) == 1
        assert said in capsys.readouterr().err
