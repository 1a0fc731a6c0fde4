"""Choosing images of a data set, and joining sets in memory and on disk."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import servoscope as sv
from planar import planar_data_set
from servoscope.data import folder as dataset_folder
from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError
from servoscope.poses import poses_from_displacements

DATA = planar_data_set(40, 16)
MOVED = poses_from_displacements(np.eye(4), [0.3, -0.1, 0.2, 0.1, 0.7, -0.4], 0.0)


def moved(data):
    """The same images, taken with the part and the camera somewhere else."""
    return replace(data, T_world_ref=MOVED @ data.T_world_ref, T_world_cam=MOVED @ data.T_world_cam)


def one_line(error, match):
    assert "\n" not in str(error.value)
    assert re.search(match, str(error.value)), str(error.value)


@pytest.mark.parametrize(
    "index",
    [slice(10, 30), slice(None, None, -3), np.arange(40) % 3 == 1, np.array([5, 0, -1]), [7, 2]],
)
def test_what_is_chosen_is_what_numpy_would_choose(index):
    data = replace(DATA, times=np.arange(40.0))[index]
    np.testing.assert_array_equal(data.images, DATA.images[index])
    np.testing.assert_array_equal(data.T_world_cam, DATA.T_world_cam[index])
    np.testing.assert_array_equal(data.times, np.arange(40.0)[index])
    assert list(data.names) == np.array(DATA.names)[index].tolist()
    np.testing.assert_array_equal(data.ranges(), DATA.ranges())


def test_one_index_gives_one_image_and_a_loop_ends():
    assert DATA[-1].names == [DATA.names[-1]]
    assert [one.names[0] for one in DATA[:3]] == list(DATA.names[:3])


@pytest.mark.parametrize("index", [40, [0, 40], np.ones(39, bool), [0.5], "name"])
def test_an_index_that_is_none_is_refused(index):
    with pytest.raises(IndexError, match="Choose of 40 images") as error:
        DATA[index]
    one_line(error, "40 bools")


@pytest.mark.parametrize("index", [slice(0, 0), [], np.zeros(40, bool)])
def test_a_choice_of_no_image_is_refused(index):
    with pytest.raises(DataSetError, match="No image is left of 40"):
        DATA[index]


def test_images_are_left_out_by_name():
    left = DATA.without(["000003", "000017"])
    assert list(left.names) == [n for n in DATA.names if n not in ("000003", "000017")]
    assert list(DATA.without("000000").names) == list(DATA.names[1:])
    with pytest.raises(DataSetError, match="No image is named 'dark'"):
        DATA.without(["dark"])
    with pytest.raises(DataSetError, match="No image is left"):
        DATA.without(DATA.names)


@given(st.integers(1, 39))
def test_what_was_cut_in_two_joins_to_what_it_was(cut):
    joined = DATA[:cut] + DATA[cut:]
    np.testing.assert_array_equal(joined.images, DATA.images)
    np.testing.assert_array_equal(joined.T_world_cam, DATA.T_world_cam)
    assert list(joined.names) == list(DATA.names)
    np.testing.assert_array_equal(joined.pivot_ranges, DATA.pivot_ranges)
    assert joined.split == "random"
    assert joined.source["added"] == [{"n_images": 40 - cut, "source": {}}]


def test_sets_about_one_pose_join_under_another_lamp():
    darker = replace(DATA, images=DATA.images // 2, reference_image=DATA.reference_image // 2)
    joined = DATA + darker
    np.testing.assert_array_equal(joined.delta_p(), np.tile(DATA.delta_p(), (2, 1)))
    np.testing.assert_array_equal(joined.reference_image, DATA.reference_image)


def test_sets_about_one_image_join_by_displacement_wherever_the_part_was():
    joined = DATA[:10] + moved(DATA[10:])
    np.testing.assert_allclose(joined.delta_p(), DATA.delta_p(), atol=1e-12)
    np.testing.assert_array_equal(joined.T_world_ref, DATA.T_world_ref)


def test_names_that_both_have_are_told_apart():
    a = replace(DATA[:3], names=["a", "a_2", "b"])
    b = replace(DATA[3:6], names=["a", "c", "a_3"])
    joined = a + b
    assert list(joined.names) == ["a", "a_2", "b", "a_4", "c", "a_3"]
    assert len(set((joined + joined + joined).names)) == 18


def test_the_range_is_that_of_the_wider_set():
    wide = replace(DATA, pivot_ranges=DATA.pivot_ranges * 2)
    np.testing.assert_array_equal((DATA + wide).ranges(), wide.ranges())
    unknown = replace(DATA, pivot_ranges=None)
    np.testing.assert_array_equal((DATA + unknown).ranges(), DATA.ranges())
    assert (unknown + unknown).pivot_ranges is None


def test_times_of_two_sequences_do_not_interleave():
    sequence = replace(DATA, times=np.arange(40.0), split="blocks")
    joined = sequence[:20] + sequence
    assert (np.diff(joined.times) > 0).all()
    np.testing.assert_array_equal((sequence[:20] + sequence[20:]).times, sequence.times)
    assert joined.split == (DATA + sequence).split == (sequence + DATA).split == "blocks"


def test_where_one_set_has_no_times_a_sequence_keeps_its_order():
    order = np.random.default_rng(0).permutation(40)
    sequence = replace(DATA, times=np.argsort(order).astype(float), split="blocks")
    joined = sequence + DATA
    assert joined.times is None
    np.testing.assert_array_equal(joined.images[:40], DATA.images[order])
    np.testing.assert_array_equal(joined.T_world_cam[:40], DATA.T_world_cam[order])


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (planar_data_set(5, 20), r"images of 16 x 16 px and the other images of 20 x 20 px"),
        (replace(DATA, pivot=0.3), r"a pivot 0.55 m before .* a pivot 0.3 m"),
        (
            replace(moved(DATA), reference_image=DATA.reference_image // 2),
            r"374 mm and 47.3 deg apart, and the images differ",
        ),
    ],
)
def test_sets_that_do_not_fit_are_refused_and_what_differs_is_named(other, message):
    with pytest.raises(DataSetError) as error:
        DATA + other
    one_line(error, message)


def test_only_sets_join():
    with pytest.raises(TypeError):
        DATA + DATA.images


def of_folder(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def test_images_are_appended_on_disk(tmp_path):
    DATA[:30].save(tmp_path / "data")
    joined = PoseImageSet.append(tmp_path / "data", DATA[30:])
    loaded = PoseImageSet.load(tmp_path / "data")
    for one in (joined, loaded):
        np.testing.assert_array_equal(one.images, DATA.images)
        np.testing.assert_allclose(one.T_world_cam, DATA.T_world_cam, atol=1e-12)
        assert list(one.names) == list(DATA.names)
    assert not list((tmp_path / "data").glob(".*"))


@pytest.mark.parametrize("step", ["write_images", "write_text", "write_json", "forget_progress"])
def test_an_append_that_is_stopped_loses_nothing_and_can_be_repeated(tmp_path, monkeypatch, step):
    DATA[:30].save(tmp_path / "data")
    before = of_folder(tmp_path / "data")

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(dataset_folder, step, stop)
        with pytest.raises(KeyboardInterrupt):
            PoseImageSet.append(tmp_path / "data", DATA[30:])
    assert of_folder(tmp_path / "data") == before
    assert len(PoseImageSet.append(tmp_path / "data", DATA[30:])) == 40


def test_what_does_not_fit_is_not_appended(tmp_path):
    DATA[:30].save(tmp_path / "data")
    before = of_folder(tmp_path / "data")
    with pytest.raises(DataSetError, match="a pivot"):
        PoseImageSet.append(tmp_path / "data", replace(DATA, pivot=0.3))
    with pytest.raises(DataSetError, match="is not a folder"):
        PoseImageSet.append(tmp_path / "none", DATA)
    assert of_folder(tmp_path / "data") == before
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (DATA, "PoseImageSet(40 images of 16 x 16, 6 dofs move, range 25 mm, 15 deg)"),
        (DATA[:1], "PoseImageSet(1 image of 16 x 16, no dof moves)"),
        (
            replace(DATA, images=DATA.images[:, :12], reference_image=DATA.reference_image[:12]),
            "PoseImageSet(40 images of 16 x 12, 6 dofs move, range 25 mm, 15 deg)",
        ),
    ],
)
def test_a_set_is_described_in_one_line(data, text):
    assert repr(data) == text


def test_a_notebook_shows_a_table_with_the_reference_and_no_foreign_markup():
    class Parser(HTMLParser):
        def __init__(self):
            super().__init__()
            self.tags, self.text = [], ""

        def handle_starttag(self, tag, attrs):
            self.tags.append((tag, dict(attrs)))

        def handle_data(self, data):
            self.text += data + " "

    names = ["<script>alert(1)</script>", *DATA.names[1:]]
    parser = Parser()
    parser.feed(replace(DATA, names=names)._repr_html_())
    assert {tag for tag, _ in parser.tags} == {"table", "tr", "th", "td", "img"}
    assert "<script>" in parser.text  # as text
    (image,) = (attrs for tag, attrs in parser.tags if tag == "img")
    assert image["src"].startswith("data:image/png;base64,iVBOR")
    assert "40 of 16 x 16 px" in parser.text
    assert "25 mm" in parser.text


def test_the_public_name_has_it_all():
    assert sv.PoseImageSet is PoseImageSet
