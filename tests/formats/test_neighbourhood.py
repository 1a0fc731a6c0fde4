from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.errors import DataSetError
from servoscope.formats import neighbourhood
from servoscope.formats.frames import Frames
from servoscope.formats.neighbourhood import choose_reference, most_neighbours, near_reference
from servoscope.formats.options import ImportOptions
from servoscope.poses import rigid_transform


def frames_on_x(*mm, degrees=None):
    degrees = np.zeros(len(mm)) if degrees is None else np.asarray(degrees, dtype=float)
    rotations = Rotation.from_rotvec(np.outer(np.radians(degrees), [0, 0, 1])).as_matrix()
    T = rigid_transform(rotations, np.outer(mm, [1e-3, 0, 0]))
    names = [f"left/{i}.png" for i in range(len(mm))]
    return Frames(Path("src"), names, 10 + np.arange(len(mm)), T)


def test_only_frames_within_both_limits_are_near():
    frames = frames_on_x(0, 50, 50, 150, degrees=[0, 5, 25, 0])
    np.testing.assert_array_equal(near_reference(frames, 0, 100, 20), [True, True, False, False])
    np.testing.assert_array_equal(near_reference(frames, 0, None, 20), [True, True, False, True])
    np.testing.assert_array_equal(near_reference(frames, 0, 100, None), [True, True, True, False])
    assert near_reference(frames, 0, None, None).all()


def test_no_neighbour_within_the_limits_is_an_error_that_tells_the_nearest():
    with pytest.raises(DataSetError, match=r"within 10 mm and 20 deg .*left/0.png .*is 50.0 mm"):
        near_reference(frames_on_x(0, 50, 80), 0, 10, 20)


def test_the_frame_with_most_neighbours_is_the_reference():
    frames = frames_on_x(0, 100, 190, 200, 210, 400)
    assert choose_reference(frames, ImportOptions(max_mm=50)) == 2
    assert most_neighbours(frames.T_world_cam, 120, 1.0) == 1


def test_neighbours_must_be_near_in_angle_too():
    frames = frames_on_x(0, 1, 2, 3, 4, degrees=[0, 90, 180, 44, 45])
    assert choose_reference(frames, ImportOptions(max_mm=50, max_deg=10)) == 3


def test_without_limits_the_reference_lies_in_the_thick_of_the_frames(rng):
    mm = rng.normal(0, 30, 1200)
    reference = most_neighbours(frames_on_x(*mm).T_world_cam, None, None)
    assert abs(mm[reference] - np.median(mm)) < 10


def test_counts_agree_with_the_limits_that_are_applied(rng):
    mm = rng.uniform(0, 1000, 700)
    frames = frames_on_x(*mm, degrees=rng.uniform(-90, 90, 700))
    best = most_neighbours(frames.T_world_cam, 150, 20)
    counts = [near_reference(frames, i, 150, 20).sum() for i in range(700)]
    assert counts[best] == max(counts)
    assert best == int(np.argmax(counts))


@pytest.mark.parametrize("kind", ["cloud", "clusters", "one pose"])
def test_of_many_frames_the_reference_is_that_of_all_pairs(monkeypatch, kind):
    rng, n = np.random.default_rng(3), 2500
    spread = {"cloud": 1.0, "clusters": 0.02, "one pose": 0.0}[kind]
    centres = rng.normal(0, 30, (5 if spread else 1, 6))[rng.integers(0, 5 if spread else 1, n)]
    numbers = (centres if spread < 1 else 0) + spread * rng.normal(0, 30, (n, 6))
    R = Rotation.from_rotvec(np.radians(numbers[:, 3:])).as_matrix()
    T = rigid_transform(R, 1e-3 * numbers[:, :3])
    for limits in ((None, None), (30, 15)):
        monkeypatch.setattr(neighbourhood, "_SAMPLES", (200, 800))
        sampled = most_neighbours(T, *limits)
        monkeypatch.setattr(neighbourhood, "_SAMPLES", ())
        assert sampled == most_neighbours(T, *limits)


def test_the_time_of_the_choice_does_not_grow_with_the_pairs(monkeypatch, rng):
    pairs = []
    count = neighbourhood._count_near

    def counted(a, b, *limits):
        pairs.append(len(a) * len(b))
        return count(a, b, *limits)

    monkeypatch.setattr(neighbourhood, "_count_near", counted)
    monkeypatch.setattr(neighbourhood, "_SAMPLES", (100, 400))
    monkeypatch.setattr(neighbourhood, "_MOST_PAIRS", 10**6)
    for n in (4000, 8000):
        most_neighbours(rigid_transform(np.eye(3), rng.normal(0, 0.03, (n, 3))), None, None)
        assert sum(pairs) <= 100 * n + 2 * 10**6
        pairs.clear()


@pytest.mark.parametrize("name", ["left/1.png", "1.png"])
def test_a_reference_is_found_by_name_or_bare_file_name(name):
    assert choose_reference(frames_on_x(0, 1, 2), ImportOptions(reference=name)) == 1


def test_a_reference_is_found_by_its_number_in_the_list():
    assert choose_reference(frames_on_x(0, 1, 2), ImportOptions(reference_index=12)) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (ImportOptions(reference="x.png"), r"none of the 3 frames .*'x.png'.* 'left/0.png'"),
        (ImportOptions(reference_index=3), r"frame 3 is not among the 3 .* numbered 10 to 12"),
    ],
)
def test_an_unknown_reference_is_an_error(options, message):
    with pytest.raises(DataSetError, match=message):
        choose_reference(frames_on_x(0, 1, 2), options)


def test_an_ambiguous_file_name_is_an_error():
    frames = frames_on_x(0, 1)
    frames.names[:] = ["left/1.png", "right/1.png"]
    with pytest.raises(DataSetError, match="several of the 2 frames"):
        choose_reference(frames, ImportOptions(reference="1.png"))
