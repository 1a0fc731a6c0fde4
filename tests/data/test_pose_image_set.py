import dataclasses
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from servoscope.data import folder as dataset_folder
from servoscope.data.checks import IMAGE_FAULTS, image_faults
from servoscope.data.folder import KEPT_IMAGES, Progress, write_progress
from servoscope.data.images import PoseImageSet
from servoscope.errors import (
    DataSetError,
    FolderExistsError,
    ServoscopeError,
    ServoscopeWarning,
)
from servoscope.poses import displacement_ranges, pose_error, poses_from_displacements

RANGES = np.array([0.025] * 3 + [np.radians(15.0)] * 3)


def make(n_images=60, **changes):
    rng = np.random.default_rng(0)
    T_world_ref = poses_from_displacements(np.eye(4), [0.3, -0.2, 0.9, 3.0, 0.1, 0.4], 0.0)
    fields = {
        "images": rng.integers(0, 256, (n_images, 12, 16), dtype=np.uint8),
        "T_world_cam": poses_from_displacements(
            T_world_ref, rng.uniform(-1, 1, (n_images, 6)) * RANGES, 0.55
        ),
        "T_world_ref": T_world_ref,
        "reference_image": rng.integers(0, 256, (12, 16), dtype=np.uint8),
        "pivot": 0.55,
        "pivot_ranges": RANGES,
    }
    return PoseImageSet(**fields | changes)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("saved") / "set"
    make().save(folder)
    return folder


@pytest.fixture
def folder(saved, tmp_path):
    return shutil.copytree(saved, tmp_path / "set")


def refused(folder, match):
    with pytest.raises(DataSetError, match=match) as caught:
        PoseImageSet.load(folder)
    assert "\n" not in str(caught.value)


# A set in memory


def test_displacements_are_those_that_the_poses_were_made_from():
    data = make(n_images=5)
    delta_p = np.random.default_rng(1).uniform(-1, 1, (5, 6)) * RANGES
    poses = poses_from_displacements(data.T_world_ref, delta_p, 0.55)
    np.testing.assert_allclose(make(5, T_world_cam=poses).delta_p(), delta_p, atol=1e-12)
    poses = poses_from_displacements(data.T_world_ref, delta_p, 0.0)
    moved = make(5, T_world_cam=poses)
    np.testing.assert_allclose(moved.delta_p("camera"), delta_p, atol=1e-12)


def test_ranges_are_the_sampled_ones_in_both_forms():
    np.testing.assert_array_equal(make().ranges("pivot"), RANGES)
    expected = displacement_ranges(RANGES, 0.55, "camera")
    np.testing.assert_array_equal(make().ranges("camera"), expected)


def test_ranges_are_the_largest_displacements_where_none_were_sampled():
    data = make(pivot_ranges=None)
    np.testing.assert_array_equal(data.ranges(), np.abs(data.delta_p()).max(axis=0))


def test_a_dof_that_never_moves_has_the_range_1():
    delta_p = np.zeros((4, 6))
    delta_p[:, 0] = [0.01, -0.02, 0.0, 0.005]
    poses = poses_from_displacements(np.eye(4), delta_p, 0.55)
    data = make(4, T_world_cam=poses, T_world_ref=np.eye(4), pivot_ranges=None)
    np.testing.assert_allclose(data.ranges(), [0.02, 1, 1, 1, 1, 1])


def test_names_are_numbers_where_none_are_given():
    assert make(n_images=3).names == ["000000", "000001", "000002"]


def with_entry(array, value):
    array = array.copy()
    array.flat[5] = value
    return array


def far_away(T):
    T = T.copy()
    T[3, 0, 3] = 1e200
    return T


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"images": np.zeros((60, 12, 16))}, "images must be a uint8 array .* got float64"),
        ({"images": np.zeros((60, 12), np.uint8)}, r"images must be .* shape \(60, 12\)"),
        ({"images": np.zeros((0, 12, 16), np.uint8)}, "at least one image"),
        ({"T_world_cam": make().T_world_cam[:-1]}, r"T_world_cam must .* \(60, 4, 4\), got \(59"),
        ({"T_world_ref": np.eye(3)}, r"T_world_ref must have the shape \(4, 4\), got \(3, 3\)"),
        ({"reference_image": np.zeros((4, 4), np.uint8)}, r"reference_image .* \(12, 16\)"),
        ({"reference_image": np.zeros((12, 16))}, "reference_image must be uint8, got float64"),
        ({"times": np.arange(3.0)}, r"times must have the shape \(60,\)"),
        ({"pivot_ranges": np.ones(3)}, r"pivot_ranges must have the shape \(6,\)"),
        ({"T_world_cam": with_entry(make().T_world_cam, np.nan)}, "T_world_cam must be finite"),
        ({"T_world_ref": with_entry(np.eye(4), np.inf)}, "T_world_ref must be finite"),
        ({"T_world_cam": far_away(make().T_world_cam)}, r"T_world_cam must lie within 1e\+08 m"),
        ({"pivot": 1e200}, "pivot must be a finite distance"),
        ({"pivot_ranges": -RANGES}, "pivot_ranges must not be below 0"),
        ({"T_world_cam": 2 * make().T_world_cam}, "T_world_cam must hold rigid transforms"),
        ({"T_world_ref": np.diag([1.0, 1.0, -1.0, 1.0])}, "T_world_ref must hold rigid"),
        ({"source": "here"}, "source must be a dict, got a str"),
        ({"times": np.full(60, np.nan)}, "times must be finite"),
        ({"names": ["a"] * 60}, "60 different names, one an image, got 60 with 1 different"),
        ({"names": ["a", "b"]}, "60 different names, one an image, got 2"),
        ({"pivot": np.nan}, "pivot must be a finite distance in metres, got nan"),
        ({"split": "sorted"}, "split must be one of random, blocks, got 'sorted'"),
    ],
)
def test_a_set_that_does_not_hold_together_is_refused(changes, message):
    with pytest.raises(DataSetError, match=message):
        make(**changes)


# Saved and loaded


def test_a_set_comes_back_as_it_was_saved(tmp_path):
    data = make(
        names=[f'shot, {i} "é".png' for i in range(60)],
        times=1.3e9 + np.arange(60) / 7,
        split="blocks",
        source={"format": "tum", "nested": {"ä": [1, 2.5, None]}},
    )
    data.save(tmp_path / "set")
    loaded = PoseImageSet.load(tmp_path / "set")
    np.testing.assert_array_equal(loaded.images, data.images)
    np.testing.assert_array_equal(loaded.reference_image, data.reference_image)
    np.testing.assert_array_equal(loaded.times, data.times)
    np.testing.assert_array_equal(loaded.pivot_ranges, data.pivot_ranges)
    for poses, expected in [
        (loaded.T_world_cam, data.T_world_cam),
        (loaded.T_world_ref, data.T_world_ref),
    ]:
        distance, angle = pose_error(poses, expected)
        assert np.max(distance) == 0
        assert np.max(angle) < 1e-7
    assert list(loaded.names) == list(data.names)
    assert (loaded.pivot, loaded.split, loaded.source) == (0.55, "blocks", data.source)


def test_what_was_not_given_is_not_there_after_loading(tmp_path):
    make(pivot_ranges=None).save(tmp_path)
    loaded = PoseImageSet.load(tmp_path)
    assert loaded.pivot_ranges is None
    assert loaded.times is None
    assert loaded.source == {}


@pytest.mark.parametrize("n_images", [1, 24, 25, 26])
def test_sets_of_any_length_are_saved(tmp_path, n_images):
    make(n_images).save(tmp_path)
    np.testing.assert_array_equal(PoseImageSet.load(tmp_path).images, make(n_images).images)


def test_black_images_are_images(tmp_path):
    black = np.zeros((60, 12, 16), np.uint8)
    make(images=black).save(tmp_path)
    np.testing.assert_array_equal(PoseImageSet.load(tmp_path).images, black)


def test_a_set_is_never_written_over_another(folder):
    with pytest.raises(FolderExistsError, match="holds a data set already"):
        make(3).save(folder)
    assert len(PoseImageSet.load(folder)) == 60


@pytest.mark.parametrize("name", ["taken", "kept", "images"])
def test_saving_a_set_leaves_the_folders_of_others(tmp_path, name):
    (tmp_path / name).mkdir()
    (tmp_path / name / "holiday.jpg").write_text("mine")
    make(3).save(tmp_path)
    assert (tmp_path / name / "holiday.jpg").read_text() == "mine"


@pytest.mark.parametrize("part", ["poses.zarr", KEPT_IMAGES])
def test_a_folder_of_somebody_else_that_bears_the_name_of_a_part_is_left_alone(tmp_path, part):
    (tmp_path / "new" / part).mkdir(parents=True)
    with pytest.raises(FolderExistsError, match=f"{part} that is no part of a data set"):
        make(3).save(tmp_path / "new")
    make(3).save(tmp_path / "set")
    (tmp_path / "set" / part).mkdir()
    dataset_folder.remove(tmp_path / "set")
    for folder in ("new", "set"):
        assert [path.name for path in (tmp_path / folder).iterdir()] == [part]


def test_removing_a_set_leaves_other_files(folder):
    (folder / "notes.txt").write_text("mine")
    dataset_folder.remove(folder)
    assert [p.name for p in folder.iterdir()] == ["notes.txt"]


def test_a_replacement_that_was_interrupted_is_completed_by_who_reads(folder, monkeypatch):
    rename, renamed = Path.rename, []

    def rename_twice(path, target):
        if len(renamed) == 2:
            raise KeyboardInterrupt
        renamed.append(path)
        return rename(path, target)

    def replace():
        with dataset_folder.writing(folder, replace=True) as place:
            make(3).save(place)
            monkeypatch.setattr(Path, "rename", rename_twice)

    with pytest.raises(KeyboardInterrupt):
        replace()
    monkeypatch.undo()
    assert not (folder / "meta.json").exists()
    assert len(PoseImageSet.load(folder)) == 3


# Damaged folders


def test_a_missing_folder_is_refused(tmp_path):
    refused(tmp_path / "nothing", "nothing is not a folder")


def test_an_empty_folder_is_refused(tmp_path):
    refused(tmp_path, r"not a data set folder: it has no meta\.json")


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    refused(tmp_path / "file", "is not a folder")


def test_an_unfinished_set_is_refused_with_how_far_it_came(tmp_path):
    dataset_folder.create(tmp_path, 100, (12, 16), plan={"seed": 0})
    write_progress(tmp_path, Progress({"seed": 0}, 75))
    refused(tmp_path, r"is unfinished \(75 images\); repeat the command")


def edit_meta(folder, **changes):
    path = folder / "meta.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize("version", [0, 2, "1", None, [1]])
def test_another_version_is_refused(folder, version):
    edit_meta(folder, version=version)
    refused(folder, "has version .*, this servoscope reads version 1")


@pytest.mark.parametrize("key", ["reference", "pivot", "pivot_ranges", "split", "source"])
def test_missing_meta_data_is_named(folder, key):
    meta = json.loads((folder / "meta.json").read_text())
    del meta[key]
    (folder / "meta.json").write_text(json.dumps(meta))
    refused(folder, rf"meta\.json lacks {key}")


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff\xfe", b"[1]", b"null", b'"text"', b"[" * 100_000, b"1" * 10_000],
)
def test_meta_data_that_is_no_json_object_is_refused(folder, content):
    (folder / "meta.json").write_bytes(content)
    refused(folder, r"meta\.json (cannot be read as JSON|must hold a JSON object)")


@pytest.mark.parametrize(
    "changes",
    [
        {"pivot": "far"},
        {"pivot": None},
        {"pivot": []},
        {"pivot": float("nan")},
        {"pivot_ranges": "wide"},
        {"pivot_ranges": [1, 2]},
        {"pivot_ranges": [[1], [2, 3]]},
        {"pivot_ranges": {"tx": 1}},
        {"split": 3},
        {"split": ["random"]},
        {"source": "here"},
        {"reference": []},
        {"reference": None},
        {"reference": {"tx": 0}},
        {"reference": dict.fromkeys(("tx", "ty", "tz", "qx", "qy", "qz", "qw"), 0)},
        {"reference": dict.fromkeys(("tx", "ty", "tz", "qx", "qy", "qz", "qw"), "a")},
        {"reference": dict.fromkeys(("tx", "ty", "tz", "qx", "qy", "qz", "qw"), float("inf"))},
    ],
)
def test_meta_data_of_the_wrong_kind_is_refused(folder, changes):
    edit_meta(folder, **changes)
    refused(folder, f"^{folder}")


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1e400", "NaN", "1e200"])
def test_numbers_beyond_all_sense_in_meta_data_are_refused(folder, number):
    path = folder / "meta.json"
    path.write_text(path.read_text().replace("0.55", number))
    refused(folder, f"^{folder}")


def test_a_reference_image_of_another_size_is_never_decoded(folder):
    Image.new("1", (9000, 9000)).save(folder / "reference.png")
    refused(folder, "more than 67108864 pixels")
    Image.new("L", (16, 13)).save(folder / "reference.png")
    refused(folder, "grey 8-bit image of 16 x 12 px, got 16 x 13 px")


def test_missing_images_are_refused(folder):
    shutil.rmtree(folder / "images.zarr")
    refused(folder, r"images\.zarr.zarr\.json is missing")


def chunks(folder):
    return sorted(p for p in (folder / "images.zarr" / "c").rglob("*") if p.is_file())


@pytest.mark.parametrize("keep", [0, 7, 0.5])
def test_a_truncated_chunk_is_refused(folder, keep):
    chunk = chunks(folder)[1]
    content = chunk.read_bytes()
    chunk.write_bytes(content[: keep if isinstance(keep, int) else len(content) // 2])
    refused(folder, r"images\.zarr cannot be read")


def test_a_missing_chunk_is_refused(folder):
    chunks(folder)[1].unlink()
    refused(folder, r"images\.zarr .*missing")


def test_images_of_another_shape_or_type_are_refused(folder):
    import zarr

    shutil.rmtree(folder / "images.zarr")
    stack = zarr.create_array(folder / "images.zarr", shape=(60, 12, 16), dtype="float32")
    stack[:] = 1.0
    refused(folder, r"it holds 'float32' of shape \[60, 12, 16\]")


def edit_poses(folder, edit):
    path = folder / "poses.csv"
    path.write_text("\n".join(edit(path.read_text().splitlines())) + "\n")


def with_field(line, position, value):
    fields = line.split(",")
    fields[position] = value
    return ",".join(fields)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda rows: rows[:-1], r"poses\.csv has 59 poses for 60 images"),
        (lambda rows: [*rows, with_field(rows[-1], 0, "more")], "has 61 poses for 60 images"),
        (lambda rows: rows[:1], r"poses\.csv has 0 poses for 60 images"),
        (lambda rows: [], r"poses\.csv"),
        (lambda rows: ["name,x,y,z,a,b,c,d", *rows[1:]], "must have the columns name,tx"),
        (
            lambda rows: [*rows[:-1], with_field(rows[-1], 1, "nan")],
            "must be finite, but number 59",
        ),
        (
            lambda rows: [*rows[:-1], with_field(rows[-1], 3, "inf")],
            "must be finite, but number 59",
        ),
        (
            lambda rows: [*rows[:-1], with_field(rows[-1], 5, "nan")],
            "must be finite, but number 59",
        ),
        (lambda rows: [*rows[:-1], with_field(rows[-1], 2, "x")], "must have the columns"),
        (lambda rows: [*rows[:-1], with_field(rows[-1], 2, "1e200")], r"within 1e\+08 m, but"),
        (lambda rows: [*rows[:-1], with_field(rows[-1], 5, "1e200")], "a length above 1e6, but"),
        (lambda rows: [*rows[:-1], rows[-1] + ",7"], "line 61 has 9 cells"),
        (lambda rows: [*rows, *rows[1:]], "has 120 poses for 60 images"),
        (lambda rows: [*rows[:-1], "000059,1,2,3"], "must have the columns"),
        (lambda rows: [*rows[:-1], "000059,0,0,0,0,0,0,0"], "zero length, but number 59"),
        (lambda rows: [*rows[:-1], with_field(rows[-1], 0, "000000")], "60 different names"),
    ],
)
def test_damaged_poses_are_refused(folder, edit, message):
    edit_poses(folder, edit)
    refused(folder, message)


def test_missing_poses_are_refused(folder):
    (folder / "poses.csv").unlink()
    refused(folder, r"poses\.csv is missing")


def test_poses_that_are_no_text_are_refused(folder):
    (folder / "poses.csv").write_bytes(b"\xff\xfe\x00name")
    refused(folder, r"poses\.csv is not UTF-8")


def test_a_missing_or_damaged_reference_image_is_refused(folder):
    (folder / "reference.png").write_bytes(b"not a png")
    refused(folder, r"reference\.png is not a whole image")
    (folder / "reference.png").unlink()
    refused(folder, r"reference\.png is missing")


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes where it likes")
def test_a_folder_that_may_not_be_written_is_a_permission_error(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(PermissionError):
            make().save(tmp_path / "set")
        assert list(tmp_path.iterdir()) == []
    finally:
        tmp_path.chmod(0o700)


def test_a_folder_whose_parent_is_a_file_is_a_clear_error(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises((OSError, ServoscopeError)):
        make().save(tmp_path / "file" / "set")
    assert (tmp_path / "file").read_text() == "mine"


def test_a_set_that_could_not_be_finished_is_not_taken_for_a_whole_one(tmp_path, monkeypatch):
    def full(path, write):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dataset_folder, "write_atomically", full)
    with pytest.raises(OSError, match="No space left"):
        make().save(tmp_path / "set")
    refused(tmp_path / "set", "is unfinished")


def test_a_dof_moves_if_its_displacements_differ_by_more_than_rounding(plane):
    assert plane.moves().all()
    still = dataclasses.replace(
        plane, T_world_cam=np.broadcast_to(plane.T_world_cam[0], (150, 4, 4))
    )
    assert not still.moves().any()
    assert not still.moves("camera").any()


@pytest.mark.parametrize("n", [15, 40, 200])
def test_one_outlier_is_not_the_range(n) -> None:
    rng = np.random.default_rng(n)
    delta_p = rng.uniform(-1, 1, (n, 6)) * RANGES
    delta_p[n // 2] = 4 * RANGES
    found = _at(delta_p).ranges()
    others = np.abs(np.delete(delta_p, n // 2, axis=0)).max(axis=0)
    np.testing.assert_allclose(found, others, rtol=1e-6)


def test_images_displaced_far_along_one_axis_each_are_no_outliers() -> None:
    """One in each dof of 20 is as many as 30 %."""
    delta_p = 0.4 * np.random.default_rng(0).uniform(-1, 1, (20, 6)) * RANGES
    delta_p[:6] = np.diag(RANGES)
    np.testing.assert_allclose(_at(delta_p).ranges(), RANGES, rtol=1e-6)
    delta_p[1:6] = 0
    others = np.abs(delta_p[6:]).max(axis=0)
    np.testing.assert_allclose(_at(delta_p).ranges(), others, rtol=1e-6)


def test_the_range_of_one_image_is_its_displacement() -> None:
    delta_p = np.array([[0.01, 0, -0.02, 0, 0, 0.1]])
    np.testing.assert_allclose(_at(delta_p).ranges(), [0.01, 1, 0.02, 1, 1, 0.1], atol=1e-12)


@pytest.mark.parametrize("spread", ["uniform", "normal", "few far ones"])
def test_without_outliers_the_range_is_the_largest_displacement(spread) -> None:
    rng = np.random.default_rng(0)
    shape = (300, 6)
    drawn = {
        "uniform": rng.uniform(-1, 1, shape),
        "normal": rng.normal(size=shape).clip(-3.2, 3.2) / 4,
        "few far ones": rng.uniform(-1, 1, shape) * np.where(np.arange(300) < 24, 1, 0.05)[:, None],
    }[spread]
    delta_p = drawn * RANGES
    np.testing.assert_allclose(_at(delta_p).ranges(), np.abs(delta_p).max(axis=0), rtol=1e-6)


def test_a_dof_that_seldom_moves_keeps_its_range() -> None:
    delta_p = np.zeros((100, 6))
    delta_p[:, 0] = np.linspace(-0.02, 0.02, 100)
    delta_p[3, 1] = 0.01
    np.testing.assert_allclose(_at(delta_p).ranges(), [0.02, 0.01, 1, 1, 1, 1], atol=1e-9)


def _at(delta_p: np.ndarray) -> PoseImageSet:
    return PoseImageSet(
        np.zeros((len(delta_p), 4, 4), np.uint8),
        poses_from_displacements(np.eye(4), delta_p, 0.55),
        np.eye(4),
        np.zeros((4, 4), np.uint8),
        pivot=0.55,
    )


def test_a_fingerprint_is_of_images_poses_and_reference(tmp_path):
    data = make(4)
    assert data.fingerprint() == make(4).fingerprint()
    data.save(tmp_path / "data")
    loaded = [PoseImageSet.load(tmp_path / "data") for _ in range(2)]
    assert loaded[0].fingerprint() == loaded[1].fingerprint()
    others = [
        data.subset(np.arange(3)),
        dataclasses.replace(data, images=255 - data.images),
        dataclasses.replace(data, reference_image=255 - data.reference_image),
        dataclasses.replace(data, pivot=0.1),
        dataclasses.replace(data, times=np.arange(4.0)),
    ]
    assert len({one.fingerprint() for one in [data, *others]}) == 6


def test_images_that_are_left_on_disk_are_those_in_memory(saved, tmp_path, monkeypatch):
    whole = PoseImageSet.load(saved)
    monkeypatch.setattr("servoscope.data.images.images_share", lambda memory: 0)
    data = PoseImageSet.load(saved, memory="1GB")
    assert not isinstance(data.images, np.ndarray)
    np.testing.assert_array_equal(np.asarray(data.images), whole.images)
    assert data.fingerprint() == whole.fingerprint()
    assert image_faults(data.images, data.T_world_cam).keys() == set(IMAGE_FAULTS)
    some = data[10:2:-3]
    assert not isinstance(some.images, np.ndarray)
    np.testing.assert_array_equal(some.images[1], whole.images[7])
    some.save(tmp_path / "some")
    np.testing.assert_array_equal(
        PoseImageSet.load(tmp_path / "some").images, whole.images[10:2:-3]
    )
    in_memory = data.thinned(len(data)).images
    np.testing.assert_array_equal(in_memory, whole.images)
    assert isinstance(in_memory, np.ndarray)


def test_no_more_are_kept_of_large_images_than_a_memory_holds():
    images, poses = np.zeros((300, 64, 64), np.uint8), np.tile(np.eye(4), (300, 1, 1))
    data = PoseImageSet(images, poses, np.eye(4), images[0])
    assert data.thinned(300, "3.7MB") is data
    with pytest.warns(ServoscopeWarning, match="^Of 300 images 244 are used, as many as 3MB of"):
        kept = data.thinned(300, "3MB")
    assert kept.images.nbytes <= 1e6 < kept.images.nbytes + 64 * 64
    assert kept.source["thinned_from"] == 300
    assert len(data.thinned(220, "3MB")) == 220
    larger = PoseImageSet(
        np.zeros((210, 90, 90), np.uint8), poses[:210], np.eye(4), np.zeros((90, 90), np.uint8)
    )
    with pytest.warns(ServoscopeWarning, match="^Of 210 images 200 are used"):
        assert len(larger.thinned(1500, "1MB")) == 200


def test_a_thinned_set_is_even_in_time():
    data = make(7, times=np.array([6.0, 5, 4, 3, 2, 1, 0]))
    assert data.thinned(3).times.tolist() == [6, 3, 0]
    assert data.thinned(3).thinned(2).source["thinned_from"] == 7
    assert data.thinned(7) is data
    assert data.subset(np.arange(7)) is data
    assert data.subset(np.arange(7)[::-1]).names == data.names[::-1]
