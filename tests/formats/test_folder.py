import os
import shutil
from unicodedata import normalize

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope import PoseImageSet
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats import ImportOptions, read_folder

HEADER = "name,tx,ty,tz,qx,qy,qz,qw"
NAMED = ImportOptions(reference="02.png")
SKIP_BAD = ImportOptions(reference="02.png", skip_bad=True)


def refusal(source, options=NAMED):
    """The one line that refuses a folder."""
    with pytest.raises(DataSetError) as caught:
        read_folder(source.path, options)
    message = str(caught.value)
    assert "\n" not in message
    assert str(source.path) in message
    return message


def test_images_poses_and_names_come_back_in_the_order_of_the_rows(pose_folder):
    pose_folder.write_csv()
    done = []
    data = read_folder(pose_folder.path, NAMED, on_progress=done.append)
    np.testing.assert_array_equal(data.images, pose_folder.images)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)
    assert data.names == pose_folder.names
    assert data.times is None
    assert data.split == "random"
    assert data.pivot == 0.55
    assert done == [1, 2, 3, 4, 5, 6]


def test_the_reference_frame_stays_in_the_set_with_displacement_zero(pose_folder):
    pose_folder.write_csv()
    data = read_folder(pose_folder.path, NAMED)
    np.testing.assert_array_equal(data.reference_image, pose_folder.images[2])
    np.testing.assert_allclose(data.delta_p()[2], 0, atol=1e-12)
    np.testing.assert_allclose(data.delta_p("camera")[3, :3].round(3), [0.01, 0, 0], atol=1e-3)
    assert data.source["reference"] == "02.png"


def test_an_imported_set_survives_saving_and_loading(pose_folder, tmp_path):
    pose_folder.write_csv()
    data = read_folder(pose_folder.path, NAMED)
    data.save(tmp_path / "set")
    loaded = PoseImageSet.load(tmp_path / "set")
    np.testing.assert_array_equal(loaded.images, data.images)
    assert loaded.source == data.source


def test_columns_are_found_by_name_in_any_order(pose_folder):
    columns = ["qw", "qx", "qy", "qz", "exposure", "tz", "ty", "tx", "Name "]
    order = [6, 3, 4, 5, None, 2, 1, 0]
    rows = [
        ",".join([*("9" if i is None else repr(float(row[i])) for i in order), name])
        for name, row in zip(pose_folder.names, pose_folder.numbers, strict=True)
    ]
    pose_folder.write_csv(rows, header=",".join(columns))
    data = read_folder(pose_folder.path, NAMED)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r\n\r\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_windows_line_ends_blank_lines_and_byte_order_marks_are_accepted(
    pose_folder, newline, encoding
):
    pose_folder.write_csv(newline=newline, encoding=encoding)
    assert len(read_folder(pose_folder.path, NAMED)) == 6


def test_a_time_column_asks_for_a_split_by_blocks(pose_folder):
    rows = [f"{row},{time}" for row, time in zip(pose_folder.rows(), range(6), strict=True)]
    pose_folder.write_csv(rows, header="name,tx,ty,tz,qx,qy,qz,qw,time")
    data = read_folder(pose_folder.path, NAMED)
    np.testing.assert_array_equal(data.times, range(6))
    assert data.split == "blocks"
    at_random = ImportOptions(reference="02.png", split="random")
    assert read_folder(pose_folder.path, at_random).split == "random"


def test_times_that_are_not_seconds_are_refused(pose_folder):
    stamps = 1_403_636_579_000_000_000 + 50_000_000 * np.arange(6)
    rows = [f"{row},{time}" for row, time in zip(pose_folder.rows(), stamps, strict=True)]
    pose_folder.write_csv(rows, header="name,tx,ty,tz,qx,qy,qz,qw,time")
    assert "column time: stamps must be seconds" in refusal(pose_folder)


def test_a_split_by_blocks_without_times_is_refused(pose_folder):
    pose_folder.write_csv()
    message = refusal(pose_folder, ImportOptions(split="blocks"))
    assert "add a column 'time'" in message


def test_images_may_lie_in_folders_written_the_windows_way(pose_folder):
    pose_folder.write_image("left/a.png", pose_folder.images[0])
    rows = pose_folder.rows()
    pose_folder.write_csv([rows[0].replace("00.png", ".\\left\\a.png"), *rows[1:]])
    assert read_folder(pose_folder.path, NAMED).names[0] == "left/a.png"


def test_only_frames_near_the_reference_are_kept_and_the_rest_is_counted(pose_folder):
    pose_folder.write_csv()
    options = ImportOptions(reference="02.png", max_mm=15, max_deg=20)
    with pytest.warns(ServoscopeWarning, match="3 frames kept; left out: 3 far from the reference"):
        data = read_folder(pose_folder.path, options)
    assert data.names == ["01.png", "02.png", "03.png"]
    assert data.source["dropped"] == {"far from the reference": 3}
    assert data.source["options"]["max_mm"] == 15


def test_resizing_applies_to_the_reference_image_too(pose_folder):
    pose_folder.write_csv()
    data = read_folder(pose_folder.path, ImportOptions(reference="02.png", image_width=8))
    assert data.image_shape == data.reference_image.shape == (6, 8)


def test_images_of_two_sizes_but_one_aspect_ratio_are_joined_by_resizing(pose_folder):
    pose_folder.write_image("04.png", np.repeat(np.repeat(pose_folder.images[4], 2, 0), 2, 1))
    pose_folder.write_csv()
    data = read_folder(pose_folder.path, ImportOptions(reference="02.png", image_width=16))
    np.testing.assert_array_equal(data.images, pose_folder.images)


def test_images_of_different_sizes_are_refused_by_name(pose_folder):
    pose_folder.write_image("04.png", pose_folder.images[4][:6])
    pose_folder.write_csv()
    message = refusal(pose_folder)
    assert "04.png is 16 x 6 px, but the reference image is 16 x 12 px" in message


@pytest.mark.parametrize("damage", ["truncated", "text", "missing", "size"])
def test_a_bad_image_is_refused_by_name_or_skipped_and_counted(pose_folder, damage):
    path = pose_folder.path / "04.png"
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:120])
    elif damage == "text":
        path.write_text("not an image")
    elif damage == "missing":
        path.unlink()
    else:
        pose_folder.write_image("04.png", pose_folder.images[4][:6])
    pose_folder.write_csv()
    assert "04.png is" in refusal(pose_folder)
    with pytest.warns(ServoscopeWarning, match=r"5 frames kept.* unusable image \(04.png\)"):
        data = read_folder(pose_folder.path, SKIP_BAD)
    assert data.names == [name for name in pose_folder.names if name != "04.png"]
    assert data.source["dropped"] == {"with an unusable image": 1}
    np.testing.assert_array_equal(data.images, pose_folder.images[[0, 1, 2, 3, 5]])


def test_a_named_reference_that_cannot_be_read_is_refused_even_when_skipping(pose_folder):
    (pose_folder.path / "02.png").write_text("not an image")
    pose_folder.write_csv()
    assert "02.png is not a whole image" in refusal(pose_folder, SKIP_BAD)


def test_a_chosen_reference_that_cannot_be_read_gives_way_to_another(pose_folder):
    options = ImportOptions(max_mm=15, skip_bad=True)
    pose_folder.write_csv()
    with pytest.warns(ServoscopeWarning):
        chosen = read_folder(pose_folder.path, options).source["reference"]
    (pose_folder.path / chosen).write_text("not an image")
    with pytest.warns(ServoscopeWarning, match=rf"unusable image \({chosen}\)"):
        data = read_folder(pose_folder.path, options)
    assert data.source["reference"] != chosen


@pytest.mark.parametrize(
    ("column", "text", "message"),
    [
        (1, "nan", "line 5: tx must be a finite number, got 'nan'"),
        (3, "inf", "line 5: tz must be a finite number, got 'inf'"),
        (4, "0,3", "line 5: qx must be a finite number, got"),
        (7, "", "line 5: qw must be a finite number, got ''"),
        (slice(4, 8), "0,0,0,0", "line 5: the quaternion [0.0, 0.0, 0.0, 0.0] has zero length"),
        (slice(5, 8), "", "line 5 has 6 cells, but the first line has 8 columns"),
    ],
)
def test_an_unusable_pose_is_refused_by_line_or_skipped_and_counted(
    pose_folder, column, text, message
):
    rows = pose_folder.rows()
    fields = rows[3].split(",")
    fields[column] = [text] if isinstance(column, slice) else f'"{text}"'
    rows[3] = ",".join(fields)
    pose_folder.write_csv(rows)
    assert message in refusal(pose_folder)
    with pytest.warns(ServoscopeWarning, match=r"1 with an unusable pose \(03.png\)"):
        data = read_folder(pose_folder.path, SKIP_BAD)
    assert data.source["dropped"] == {"with an unusable pose": 1}
    assert len(data) == 5


def test_frames_keep_their_number_when_others_are_skipped(pose_folder):
    rows = pose_folder.rows()
    rows[0] = rows[0].replace("0.0,", "nan,", 1)
    pose_folder.write_csv(rows)
    with pytest.warns(ServoscopeWarning):
        data = read_folder(pose_folder.path, ImportOptions(reference_index=4, skip_bad=True))
    assert data.source["reference"] == "04.png"


@pytest.mark.parametrize(
    "name", ["../../x.png", "/etc/x.png", "a/../../x.png", "C:\\x.png", "..\\x.png", "//host/x.png"]
)
def test_a_name_that_leads_out_of_the_folder_is_refused_even_when_skipping(pose_folder, name):
    rows = pose_folder.rows()
    pose_folder.write_csv([*rows[:5], rows[5].replace("05.png", name)])
    for options in (NAMED, SKIP_BAD):
        message = refusal(pose_folder, options)
        assert f"line 7: {name!r} leads out of the folder" in message


def test_an_empty_name_is_refused(pose_folder):
    pose_folder.write_csv([*pose_folder.rows(), pose_folder.rows()[0].replace("00.png", "")])
    assert "line 8: the name of the image is empty" in refusal(pose_folder)


@pytest.mark.parametrize("again", ["03.png", "./03.png"])
def test_an_image_named_twice_is_refused_even_when_skipping(pose_folder, again):
    rows = pose_folder.rows()
    pose_folder.write_csv([*rows, rows[0].replace("00.png", again)])
    for options in (NAMED, SKIP_BAD):
        assert "poses.csv names 03.png more than once" in refusal(pose_folder, options)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("name,e,n,u,qx,qy,qz,qw", "must hold name,tx,ty,tz,qx,qy,qz,qw, but "),
        ("name,e,n,u,qx,qy,qz,qw", "'name,e,n,u,qx,qy,qz,qw' lacks tx, ty, tz"),
        ("name,x,y,z,a,b,c,d", "lacks qx, qy, qz, qw; other rotations than quaternions are said"),
        ("name,tx,ty,tz,qx,qy,qz,qw,tx", "repeats tx"),
    ],
)
def test_a_wrong_header_is_refused_with_what_was_wanted_and_found(pose_folder, header, message):
    pose_folder.write_csv(header=header)
    assert message in refusal(pose_folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "poses.csv is empty; it must begin with the header name,tx"),
        (b"name,tx,ty,tz,qx,qy,qz,qw\n", "0 images with a pose, but a data set needs two"),
        (b"name,tx,ty,tz,qx,qy,qz,qw\n02.png,0,0,0,0,0,0,1\n", "1 image with a pose, but"),
        (b"\xff\xfen\x00a\x00", "poses.csv is not UTF-8"),
        (b"name\x00", "poses.csv is not text"),
        (b"name," + b"x" * 200_000, "line 1 has more than 65536 characters"),
    ],
)
def test_an_unusable_table_is_refused(pose_folder, content, message):
    (pose_folder.path / "poses.csv").write_bytes(content)
    assert message in refusal(pose_folder)


def test_one_image_left_after_skipping_is_refused_with_the_counts(pose_folder):
    pose_folder.write_csv(pose_folder.rows()[1:3])
    (pose_folder.path / "01.png").unlink()
    message = refusal(pose_folder, SKIP_BAD)
    assert "1 image with a pose" in message
    assert "1 with an unusable image (01.png)" in message


def test_no_neighbour_within_the_limits_is_refused(pose_folder):
    pose_folder.write_csv()
    message = refusal(pose_folder, ImportOptions(reference="02.png", max_mm=1))
    assert "no other frame lies within 1 mm" in message
    assert "is 10.0 mm" in message


def test_millimetres_taken_for_metres_show_in_the_message(pose_folder):
    numbers = pose_folder.numbers * [1000, 1000, 1000, 1, 1, 1, 1]
    pose_folder.write_csv(pose_folder.rows(numbers))
    message = refusal(pose_folder, ImportOptions(reference="02.png", max_mm=150))
    assert "is 10000.0 mm" in message
    assert "check the units" in message
    data = read_folder(pose_folder.path, ImportOptions(reference="02.png", max_mm=150, units="mm"))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)


def test_missing_and_empty_folders_and_tables_are_told_apart(pose_folder):
    assert "poses.csv is missing" in refusal(pose_folder)
    for path in pose_folder.path.iterdir():
        path.unlink()
    assert "is empty; it must hold poses.csv" in refusal(pose_folder)
    shutil.rmtree(pose_folder.path)
    assert "does not exist; name the folder that holds poses.csv" in refusal(pose_folder)
    pose_folder.path.write_text("")
    assert "is a file; name the folder" in refusal(pose_folder)


def test_colour_images_are_imported_grey(pose_folder):
    for name, image in zip(pose_folder.names, pose_folder.images, strict=True):
        pose_folder.write_image(name, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    pose_folder.write_csv()
    np.testing.assert_array_equal(read_folder(pose_folder.path, NAMED).images, pose_folder.images)


@pytest.mark.parametrize(
    "edit",
    [
        lambda fields: [fields[0], *[part for text in fields[1:] for part in text.split(".")]],
        lambda fields: [fields[0], "7", *fields[1:]],
        lambda fields: [*fields, "0.1"],
    ],
    ids=["decimal commas", "a cell too many", "a column without a name"],
)
def test_a_row_longer_than_the_header_is_refused_even_when_skipping(pose_folder, edit):
    rows = pose_folder.rows(np.round(pose_folder.numbers, 4) + 0.001)
    rows[3] = ",".join(edit(rows[3].split(",")))
    pose_folder.write_csv(rows)
    for options in (NAMED, SKIP_BAD):
        message = refusal(pose_folder, options)
        assert "line 5 has " in message
        assert (
            "but the first line has 8 columns: decimal commas, or a separator too many?" in message
        )


def test_a_row_that_lacks_a_cell_before_those_that_are_read_is_refused(pose_folder):
    rows = [f"{row},1,2" for row in pose_folder.rows()]
    rows[3] = rows[3].replace("03.png,", "")  # all cells one to the left, and none empty
    pose_folder.write_csv(rows, header="exposure,name,tx,ty,tz,qx,qy,qz,qw,gain,iso"[9:])
    assert "line 5 has 9 cells, but the first line has 10" in refusal(pose_folder)


def test_commas_that_only_end_the_lines_are_no_harm(pose_folder):
    pose_folder.write_csv([f"{row},," for row in pose_folder.rows()])
    assert len(read_folder(pose_folder.path, NAMED)) == 6


@pytest.mark.parametrize(
    ("separator", "name"), [(";", "semicolons"), ("\t", "tabs"), ("|", "bars"), (" ", "spaces")]
)
def test_any_separator_is_read_but_one_that_changes_is_named(pose_folder, separator, name):
    rows = [row.replace(",", separator) for row in pose_folder.rows()]
    pose_folder.write_csv(rows, header=HEADER.replace(",", separator))
    data = read_folder(pose_folder.path, NAMED)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)
    pose_folder.write_csv(rows)
    assert f"it is divided by {name}" in refusal(pose_folder)


def test_a_decimal_comma_in_quotes_is_known_for_what_it_is(pose_folder):
    rows = pose_folder.rows()
    rows[3] = '03.png,"0,03",0,0,0,0,0,1'
    pose_folder.write_csv(rows)
    assert "tx must be a finite number, got '0,03'; write decimals with a point" in refusal(
        pose_folder
    )


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ("1e200,0,0,0,0,0,1", "the translation [1e+200, 0.0, 0.0] is in no room"),
        ("0,0,0,1e200,0,0,1e200", "the quaternion [1e+200, 0.0, 0.0, 1e+200] is none"),
        ("0,0,0,1e-200,0,0,0", "zero length"),
        ("1_000,0,0,0,0,0,1", "tx must be a finite number, got '1_000'"),
    ],
)
def test_numbers_beyond_all_sense_are_refused_by_line_or_skipped(pose_folder, pose, message):
    rows = pose_folder.rows()
    rows[3] = f"03.png,{pose}"
    pose_folder.write_csv(rows)
    assert message in refusal(pose_folder)
    with pytest.warns(ServoscopeWarning, match=r"1 with an unusable pose \(03.png\)"):
        assert len(read_folder(pose_folder.path, SKIP_BAD)) == 5


@pytest.mark.parametrize(("on_disk", "in_table"), [("NFD", "NFC"), ("NFC", "NFD")])
def test_names_are_found_in_either_unicode_form(pose_folder, on_disk, in_table):
    name = "prüf/größe é.png"
    pose_folder.write_image(normalize(on_disk, name), pose_folder.images[3])
    rows = pose_folder.rows()
    rows[3] = rows[3].replace("03.png", normalize(in_table, name))
    pose_folder.write_csv(rows)
    data = read_folder(pose_folder.path, ImportOptions(reference=normalize("NFD", name)))
    np.testing.assert_array_equal(data.images, pose_folder.images)
    assert data.names[3] == data.source["reference"] == normalize("NFC", name)


def test_names_are_found_in_small_letters_or_capitals_where_one_file_alone_has_them(pose_folder):
    pose_folder.write_csv([row.replace(".png", ".PNG") for row in pose_folder.rows()])
    options = ImportOptions(reference="02.PNG")
    data = read_folder(pose_folder.path, options)
    np.testing.assert_array_equal(data.images, pose_folder.images)
    pose_folder.write_image("03.Png", pose_folder.images[4])
    assert "03.PNG is missing" in refusal(pose_folder, options)


def test_one_name_in_two_unicode_forms_is_named_twice(pose_folder):
    rows = pose_folder.rows()
    rows[2] = rows[2].replace("02.png", normalize("NFC", "é.png"))
    rows[3] = rows[3].replace("03.png", normalize("NFD", "é.png"))
    pose_folder.write_csv(rows)
    assert "more than once" in refusal(pose_folder, ImportOptions())


# Images that show nothing


def spoil(pose_folder, **by_kind):
    levels = {"black": 0, "saturated": 255, "flat": 90}
    for kind, i in by_kind.items():
        image = pose_folder.images[0] if kind == "repeated" else np.full((12, 16), levels[kind])
        pose_folder.write_image(f"{i:02d}.png", image.astype(np.uint8))
    pose_folder.write_csv()


def test_images_that_show_nothing_are_counted_and_named_or_left_out(pose_folder):
    spoil(pose_folder, black=1, saturated=3, flat=4, repeated=5)
    words = r"1 black \(01.png\), 1 saturated \(03.png\), 1 flat \(04.png\), 1 repeated \(05.png\)"
    with pytest.warns(ServoscopeWarning, match=f"of 6 images {words}; leave them out"):
        assert len(read_folder(pose_folder.path, NAMED)) == 6
    with pytest.warns(ServoscopeWarning, match=f"2 frames kept; left out: {words}"):
        data = read_folder(pose_folder.path, SKIP_BAD)
    assert data.names == ["00.png", "02.png"]
    assert data.source["dropped"] == dict.fromkeys(("black", "saturated", "flat", "repeated"), 1)
    np.testing.assert_array_equal(data.images, pose_folder.images[[0, 2]])


@pytest.mark.parametrize("options", [NAMED, SKIP_BAD])
def test_a_named_reference_that_shows_nothing_is_refused(pose_folder, options):
    spoil(pose_folder, black=2)
    assert "the reference 02.png is black; name another" in refusal(pose_folder, options)


def test_a_chosen_reference_that_shows_nothing_gives_way_to_another(pose_folder):
    pose_folder.write_csv()
    chosen = read_folder(pose_folder.path).source["reference"]
    spoil(pose_folder, flat=int(chosen[:2]))
    for skip_bad in (False, True):
        with pytest.warns(ServoscopeWarning, match=rf"1 flat \({chosen}\)"):
            data = read_folder(pose_folder.path, ImportOptions(skip_bad=skip_bad))
        assert data.source["reference"] != chosen
        assert (chosen in data.names) != skip_bad


def test_a_folder_that_shows_nothing_is_refused(pose_folder):
    for name in pose_folder.names:
        pose_folder.write_image(name, np.zeros((12, 16), np.uint8))
    pose_folder.write_csv()
    for skip_bad in (False, True):
        message = refusal(pose_folder, ImportOptions(skip_bad=skip_bad))
        assert "none of 6 images can be the reference: they are black" in message


# Poses that a tracker held


@pytest.mark.parametrize("held", [[0, 0, 0, 0, 0, 0, 1], None], ids=["identity", "last pose"])
def test_one_pose_for_images_that_differ_is_told_or_left_out(pose_folder, held):
    numbers = pose_folder.numbers
    numbers[3:] = numbers[3] if held is None else held
    pose_folder.write_csv(pose_folder.rows(numbers))
    words = r"3 with a pose that stays while the image changes \(03.png, 04.png, 05.png\)"
    options = {"reference": "01.png"}
    with pytest.warns(ServoscopeWarning, match=words):
        read_folder(pose_folder.path, ImportOptions(**options))
    with pytest.warns(ServoscopeWarning, match=words):
        data = read_folder(pose_folder.path, ImportOptions(skip_bad=True, **options))
    assert data.names == ["00.png", "01.png", "02.png"]


def test_repeated_shots_of_one_pose_are_no_fault(pose_folder, rng):
    numbers = pose_folder.numbers
    numbers[3:] = numbers[3]
    for i in (4, 5):
        noisy = pose_folder.images[3].astype(int) + rng.integers(-9, 10, (12, 16))
        pose_folder.write_image(f"{i:02d}.png", np.clip(noisy, 0, 255).astype(np.uint8))
    pose_folder.write_csv(pose_folder.rows(numbers))
    assert len(read_folder(pose_folder.path, NAMED)) == 6


# Units and angles


def test_ranges_that_the_part_does_not_allow_are_told_with_units(pose_folder):
    pose_folder.write_csv(pose_folder.rows(pose_folder.numbers * [1000, 1, 1, 1, 1, 1, 1]))
    with pytest.warns(ServoscopeWarning, match=r"up to 30000 mm .* part is .* 550 mm .*--units mm"):
        read_folder(pose_folder.path, NAMED)
    pose_folder.write_csv(pose_folder.rows(pose_folder.numbers * [0.01, 1, 1, 1, 1, 1, 1]))
    with pytest.warns(ServoscopeWarning, match=r"within 0.0003 mm .* --units m\."):
        read_folder(pose_folder.path, ImportOptions(reference="02.png", units="mm"))


def test_angles_that_wrap_are_told(pose_folder):
    degrees = np.outer([0, 10, 0, 170, 185, 200], [0, 0, 1])
    pose_folder.quaternions = Rotation.from_rotvec(np.radians(degrees)).as_quat()
    pose_folder.write_csv()
    with pytest.warns(ServoscopeWarning, match=r"rz wrap at 180 deg \(-175.0 to 170.0 deg\)"):
        read_folder(pose_folder.path, NAMED)


# Things that are no files


@pytest.mark.parametrize("name", ["poses.csv", "03.png"])
def test_pipes_and_folders_are_refused_without_waiting(pose_folder, name):
    pose_folder.write_csv()
    (pose_folder.path / name).unlink()
    os.mkfifo(pose_folder.path / name)
    assert f"{name} must be a file, but is a pipe" in refusal(pose_folder)
    (pose_folder.path / name).unlink()
    (pose_folder.path / name).mkdir()
    assert f"{name} must be a file, but is a folder" in refusal(pose_folder)


@pytest.mark.parametrize("bits", [8, 16])
def test_images_that_exceed_the_memory_are_imported_by_way_of_the_disk(
    pose_folder, monkeypatch, tmp_path, bits
):
    pose_folder.write_csv()
    if bits == 16:
        for name in pose_folder.names:
            image = cv2.imread(str(pose_folder.path / name), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(pose_folder.path / name), image.astype(np.uint16) << 4)
    cv2.imwrite(str(pose_folder.path / pose_folder.names[4]), np.zeros((1, 1), np.uint8))
    options = ImportOptions(reference="02.png", skip_bad=True)
    with pytest.warns(ServoscopeWarning):
        in_memory = read_folder(pose_folder.path, options)
    monkeypatch.setattr("servoscope.formats.assembly.images_share", lambda memory: 0)
    with pytest.warns(ServoscopeWarning):
        on_disk = read_folder(pose_folder.path, options)
    assert not isinstance(on_disk.images, np.ndarray)
    np.testing.assert_array_equal(np.asarray(on_disk.images), in_memory.images)
    assert on_disk.names == in_memory.names
