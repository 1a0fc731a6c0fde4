"""The log of a robot beside images with times: whatever the units, images get their poses."""

import warnings

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from moving_camera import image_at, pose_at
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats import LogOptions, read_log
from servoscope.poses import pose_error

N = 60
TIMES = 50.0 + np.arange(N) / 30
LOGGED = 49.5 + np.arange(0, N / 30 + 1, 0.008)
SHOWN = [image_at(t) for t in TIMES]


class Log:
    """Images, and a log of rotation vectors at 125 Hz."""

    def __init__(self, path):
        self.path = path
        path.mkdir()
        self.names = [f"shot {i:03d}.png" for i in range(N)]
        for name, image in zip(self.names, SHOWN, strict=True):
            cv2.imwrite(str(path / name), image)
        T = pose_at(LOGGED)
        rotvec = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
        self.numbers = np.column_stack([T[:, :3, 3], rotvec])

    def write(self, header="time,tx,ty,tz,rx,ry,rz", factor=1, extra=""):
        rows = [
            ",".join([f"{t * factor:.9g}" if factor == 1 else f"{t * factor:.0f}"])
            + ","
            + ",".join(map(repr, row))
            + extra
            for t, row in zip(LOGGED, self.numbers.tolist(), strict=True)
        ]
        self.text("poses.csv", [header, *rows] if header else rows)

    def write_images(self, header="name,time", factor=1.0, swap=False, delimiter=","):
        times = [f"{t * factor:.9f}" if factor == 1 else f"{t * factor:.0f}" for t in TIMES]
        pairs = zip(times, self.names, strict=True) if swap else zip(self.names, times, strict=True)
        rows = [delimiter.join(pair) for pair in pairs]
        self.text("images.csv", [header, *rows] if header else rows)

    def text(self, name, lines):
        (self.path / name).write_text("\n".join(lines))


@pytest.fixture
def log(tmp_path):
    return Log(tmp_path / "log")


UR = {"rotation": "ur", "clock_offset": 0.0, "reference_index": 30}


def read(log, **options):
    return read_log(log.path, LogOptions(**{**UR, **options}))


def assert_camera_at(data, times, mm=0.2):
    assert 1e3 * pose_error(data.T_world_cam, pose_at(times))[0].max() < mm
    np.testing.assert_array_equal(data.images, SHOWN)


def test_images_get_the_poses_of_their_times(log):
    log.write()
    log.write_images()
    data = read(log)
    assert_camera_at(data, TIMES)
    assert data.names == log.names
    np.testing.assert_allclose(data.times, TIMES, atol=1e-8)
    assert data.split == "blocks"


@pytest.mark.parametrize("images", [{}, {"swap": True}, {"delimiter": " "}])
def test_neither_table_needs_a_header(log, images):
    log.write(header=None)
    log.write_images(header=None, **images)
    assert_camera_at(read(log), TIMES)


def test_columns_are_named_among_others(log):
    log.write(header="Timestamp_x,px0,px1,px2,r0,r1,r2,gripper", extra=",0.3")
    log.write_images()
    with pytest.raises(DataSetError, match=r"lacks time, tx, ty, tz, rx, ry, rz"):
        read(log)
    log.write_images(header="Bild,t")
    columns = {"columns": "px0,px1,px2,r0,r1,r2", "time_column": "1"}
    with pytest.raises(DataSetError, match=r"images.csv: the header .* lacks name"):
        read(log, **columns)
    log.write_images()
    assert_camera_at(read(log, **columns), TIMES)
    log.write_images(header="time,name", swap=True)
    assert_camera_at(read(log, **columns), TIMES)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_may_be_in_other_units(log, unit, factor):
    log.write(factor=factor)
    log.write_images(factor=factor)
    mm = {"ms": 0.3, "us": 0.2, "ns": 0.2}[unit]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*written in steps of 0.001 s")
        assert_camera_at(read(log, time_unit=unit), TIMES, mm)
    log.write_images()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*written in steps of 0.001 s")
        assert_camera_at(read(log, time_unit=unit, image_time_unit="s"), TIMES, mm)


def test_names_may_be_the_times(log):
    log.write()
    for name, time in zip(log.names, TIMES, strict=True):
        (log.path / name).rename(log.path / f"frame_{1e9 * time:.0f}.png")
    options = {"image_times": "names", "images": "frame_*.png", "image_time_unit": "ns"}
    assert_camera_at(read(log, **options), TIMES)
    (log.path / "frame_one.png").write_bytes(b"")
    with pytest.raises(DataSetError, match=r"frame_one.png: the time must be a finite number"):
        read(log, **options)
    with pytest.raises(DataSetError, match=r"holds no image 'shot_\*.png'"):
        read(log, **{**options, "images": "shot_*.png"})


def test_late_images_are_found_in_a_log(log):
    log.write()
    log.write_images()
    path = log.path / "images.csv"
    header, *rows = path.read_text().splitlines()
    late = [f"{r.split(',')[0]},{float(r.split(',')[1]) + 0.07:.6f}" for r in rows]
    path.write_text("\n".join([header, *late]))
    with pytest.warns(ServoscopeWarning, match="behind their poses.*that was applied"):
        data = read(log, clock_offset="estimate")
    assert data.source["clock_offset_s"] == pytest.approx(0.07, abs=0.004)
    assert_camera_at(data, TIMES, mm=1.0)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda log: log.text("poses.csv", ["tx,ty,tz,rx,ry,rz", "1,2,3,0,0,0"]), "lacks time"),
        (lambda log: log.text("poses.csv", ["1,2,3,0,0,0"]), "must be a time and 6 numbers"),
        (lambda log: log.text("poses.csv", ["time,tx,ty,tz,rx,ry,rz"]), "holds no pose"),
        (lambda log: log.text("images.csv", ["a.png,1,2"]), "must be a name and a time"),
        (lambda log: log.text("images.csv", ["name,time"]), "names no image"),
        (lambda log: log.text("images.csv", ["a.png,soon"]), "the header must hold name,time"),
        (lambda log: log.text("images.csv", ["a.png,1", "b.png,x"]), "line 2: time must be a fin"),
        (lambda log: log.text("images.csv", ["a.png,1", "a.png,2"]), "more than once"),
        (lambda log: (log.path / "images.csv").unlink(), "images.csv is missing"),
        (lambda log: log.text("images.csv", [f"{n},9.123456" for n in log.names]),
         "none of the images has a pose in poses.csv within 0.1 s"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_one_line(log, spoil, message):
    log.write()
    log.write_images()
    spoil(log)
    with pytest.raises(DataSetError) as caught:
        read(log)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
