from contextlib import nullcontext

import cv2
import numpy as np
import pytest
from PIL import Image

from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats import ImportOptions, read_folder
from servoscope.formats.images import decode_files, read_grey, stack_images


@pytest.fixture
def grey(rng):
    noise = rng.integers(0, 256, (60, 80), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (7, 7), 0)


def test_a_grey_image_is_read_as_it_is(tmp_path, grey):
    cv2.imwrite(str(tmp_path / "a.png"), grey)
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), grey)


def test_colour_becomes_luma_as_opencv_computes_it(tmp_path, rng):
    bgr = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), bgr)
    expected = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY).astype(int)
    assert np.abs(read_grey(tmp_path / "a.png") - expected).max() <= 1


def test_transparency_is_ignored(tmp_path, rng):
    bgra = rng.integers(0, 256, (20, 30, 4), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), bgra)
    cv2.imwrite(str(tmp_path / "b.png"), bgra[..., :3])
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png"), read_grey(tmp_path / "b.png"))


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_sixteen_bits_keep_the_upper_eight(tmp_path, rng, suffix):
    values = rng.integers(0, 65536, (20, 30), dtype=np.uint16)
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), values)
    np.testing.assert_array_equal(read_grey(tmp_path / f"a.{suffix}"), values // 256)


def test_floating_point_pixels_are_refused(tmp_path):
    Image.fromarray(np.zeros((4, 4), np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(DataSetError, match=r"a\.tif .*floating-point pixels, save it with 8 or 16"):
        read_grey(tmp_path / "a.tif")


def test_a_palette_and_a_bitmap_are_read_as_grey(tmp_path):
    black_and_white = np.array([[0, 255], [255, 0]], np.uint8)
    for mode in ("P", "1"):
        Image.fromarray(black_and_white).convert(mode).save(tmp_path / f"{mode}.png")
        np.testing.assert_array_equal(read_grey(tmp_path / f"{mode}.png"), black_and_white)


def test_exif_rotation_is_ignored(tmp_path, grey):
    exif = Image.Exif()
    exif[274] = 6  # to be shown turned by 90 degrees
    Image.fromarray(grey).save(tmp_path / "a.jpg", exif=exif)
    assert read_grey(tmp_path / "a.jpg").shape == grey.shape


def test_shrinking_averages_over_areas_and_keeps_the_aspect_ratio(tmp_path, grey):
    cv2.imwrite(str(tmp_path / "a.png"), grey)
    small = read_grey(tmp_path / "a.png", width=40)
    means = grey.reshape(30, 2, 40, 2).mean(axis=(1, 3))
    assert small.shape == (30, 40)
    assert np.abs(small - means).max() <= 0.5


def test_enlarging_keeps_the_aspect_ratio(tmp_path, grey):
    cv2.imwrite(str(tmp_path / "a.png"), grey)
    assert read_grey(tmp_path / "a.png", width=160).shape == (120, 160)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.95])
@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tif", "webp", "pgm"])
def test_a_truncated_file_is_refused_by_name(tmp_path, grey, suffix, share):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(grey).save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(DataSetError, match=rf"a\.{suffix} is not a whole image .*--skip-bad") as e:
        read_grey(path)
    assert "\n" not in str(e.value)


def test_a_text_file_is_refused_by_name(tmp_path):
    (tmp_path / "a.png").write_text("version https://git-lfs.example\n")
    with pytest.raises(DataSetError, match=r"a\.png is not a whole image \(it is none of PNG"):
        read_grey(tmp_path / "a.png")


@pytest.mark.parametrize(("name", "reason"), [("x" * 300, "is missing"), ("", "is a folder")])
def test_what_cannot_be_opened_is_refused_with_the_reason(tmp_path, name, reason):
    with pytest.raises(DataSetError, match=rf"{reason}.*--skip-bad"):
        read_grey(tmp_path / name)


def test_what_is_too_large_gets_one_piece_of_advice(tmp_path):
    Image.new("1", (9000, 9000)).save(tmp_path / "a.png")
    with pytest.raises(DataSetError, match=r"more than \d+ pixels; replace it, .*--skip-bad"):
        read_grey(tmp_path / "a.png")


def test_a_missing_file_is_told_from_a_damaged_one(tmp_path):
    with pytest.raises(DataSetError, match=r"a\.png is missing"):
        read_grey(tmp_path / "a.png")


def test_a_stack_keeps_the_order_and_says_which_file_failed(tmp_path, rng):
    images = rng.integers(0, 256, (40, 6, 8), dtype=np.uint8)
    paths = [tmp_path / f"{i}.png" for i in range(40)]
    for path, image in zip(paths, images, strict=True):
        cv2.imwrite(str(path), image)
    paths[7].write_text("no image")
    cv2.imwrite(str(paths[9]), images[9, :3])
    done = []
    stack, brightest, errors = stack_images(
        decode_files(paths), paths, images[0], on_progress=done.append, skip_bad=True
    )
    good = [i for i in range(40) if errors[i] is None]
    assert [i for i in range(40) if errors[i] is not None] == [7, 9]
    assert "8 x 3 px, but the reference image is 8 x 6 px" in str(errors[9])
    np.testing.assert_array_equal(stack[good], images[good])
    assert brightest == images[good].max()
    assert done == list(range(1, 41))
    with pytest.raises(DataSetError, match=r"7\.png is not a whole image"):
        stack_images(decode_files(paths), paths, images[0])


def write_sixteen(folder, values):
    for i, image in enumerate(values):
        cv2.imwrite(str(folder / f"{i:02d}.png"), image)


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("colour", [False, True])
def test_the_bits_that_16_bit_files_fill_are_kept_and_told(pose_folder, bits, colour):
    levels = pose_folder.images.astype(np.uint16) << (bits - 8)
    levels[0, 0, 0] = 2**bits - 1
    write_sixteen(pose_folder.path, np.repeat(levels[..., None], 3, -1) if colour else levels)
    pose_folder.write_csv()
    says = pytest.warns(ServoscopeWarning, match=f"{2**bits - 1} were taken to fill {bits} bits")
    with says if bits < 16 else nullcontext():
        data = read_folder(pose_folder.path)
    np.testing.assert_array_equal(data.images, levels >> (bits - 8))
    assert data.source["bit_depth"] == bits
    chosen = pose_folder.names.index(data.source["reference"])
    np.testing.assert_array_equal(data.reference_image, levels[chosen] >> (bits - 8))


def test_the_largest_level_of_all_images_decides_before_they_are_shrunk(pose_folder):
    levels = pose_folder.images.astype(np.uint16)
    levels[5, 3, 3] = 4000
    write_sixteen(pose_folder.path, levels)
    pose_folder.write_csv()
    with pytest.warns(ServoscopeWarning) as caught:
        data = read_folder(pose_folder.path, ImportOptions(image_width=8))
    assert "largest grey level is 4000 were taken to fill 12 bits" in str(caught[0].message)
    assert data.images.max() < 4000 / 16 / 2


def test_a_bit_depth_that_is_given_is_taken_in_silence_or_refused(pose_folder):
    write_sixteen(pose_folder.path, pose_folder.images.astype(np.uint16) << 2)
    pose_folder.write_csv()
    data = read_folder(pose_folder.path, ImportOptions(bit_depth=12))
    np.testing.assert_array_equal(data.images, pose_folder.images >> 2)
    with pytest.raises(DataSetError, match=r"largest grey level is 1020, which 9 bits .*depth 10"):
        read_folder(pose_folder.path, ImportOptions(bit_depth=9))


def test_a_bit_depth_for_8_bit_files_is_refused(pose_folder):
    pose_folder.write_csv()
    with pytest.raises(DataSetError, match="its images are of 8 bits, so that --bit-depth 12"):
        read_folder(pose_folder.path, ImportOptions(bit_depth=12))


def test_files_of_8_and_of_16_bits_are_not_mixed(pose_folder):
    pose_folder.write_image("03.png", pose_folder.images[3].astype(np.uint16) << 8)
    pose_folder.write_csv()
    with pytest.raises(DataSetError, match=r"03\.png is of uint16, but the reference .* of uint8"):
        read_folder(pose_folder.path, ImportOptions(reference="02.png"))


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_colour_of_sixteen_bits_becomes_luma_as_opencv_computes_it(tmp_path, rng, suffix):
    bgr = rng.integers(0, 65536, (20, 30, 3), dtype=np.uint16)
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), bgr)
    expected = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY) >> 8
    np.testing.assert_array_equal(read_grey(tmp_path / f"a.{suffix}"), expected)
