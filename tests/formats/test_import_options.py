import pytest

from servoscope.errors import InvalidInputError
from servoscope.formats import (
    FORMATS,
    BagOptions,
    BopOptions,
    ColmapOptions,
    FolderOptions,
    ImportOptions,
    LeRobotOptions,
    LogOptions,
    NerfstudioOptions,
    TumOptions,
)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"direction": "cam2world"}, "direction must be one of camera-to-world, world-to-camera"),
        ({"units": "cm"}, "units must be one of m, mm, got 'cm'"),
        ({"axes": "unity"}, "axes must be one of opencv, opengl"),
        ({"split": "time"}, "split must be one of auto, random, blocks"),
        ({"max_mm": 0}, "max_mm must be a finite number above 0, got 0"),
        ({"max_deg": float("nan")}, "max_deg must be a finite number above 0"),
        ({"pivot_mm": float("inf")}, "pivot_mm must be a finite number not below 0"),
        ({"image_width": 0}, "image_width must be a finite number above 0"),
        ({"bit_depth": 7}, "bit_depth must be from 8 to 16, got 7"),
        ({"reference_index": -1}, "reference_index must be a finite number not below 0"),
        ({"reference": "a.png", "reference_index": 1}, "not both"),
    ],
)
def test_a_value_out_of_range_is_refused(wrong, message):
    with pytest.raises(InvalidInputError, match=message):
        ImportOptions(**wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"quaternion_order": "xyz"}, "quaternion_order must be one of xyzw, wxyz"),
        ({"pairing": "linear"}, "pairing must be one of interpolate, nearest"),
        ({"max_gap_s": -1.0}, "max_gap_s must be a finite number not below 0"),
        ({"units": "cm"}, "units must be one of"),
    ],
)
def test_tum_options_check_their_own_values_and_the_common_ones(wrong, message):
    with pytest.raises(InvalidInputError, match=message):
        TumOptions(**wrong)


def test_a_pivot_at_the_camera_is_allowed():
    assert ImportOptions(pivot_mm=0).pivot_mm == 0


def test_the_registry_lists_the_formats_with_their_options():
    assert {name: format_.options for name, format_ in FORMATS.items()} == {
        "folder": FolderOptions,
        "log": LogOptions,
        "bag": BagOptions,
        "lerobot": LeRobotOptions,
        "colmap": ColmapOptions,
        "nerfstudio": NerfstudioOptions,
        "bop": BopOptions,
        "tum": TumOptions,
    }
