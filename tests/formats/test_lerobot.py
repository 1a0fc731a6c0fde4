"""LeRobotDataset v3, written by pyarrow and PyAV: images and poses come back."""

import json
import sys
from fractions import Fraction

import av
import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from moving_camera import HEIGHT, WIDTH, image_at, pose_at
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats import LeRobotOptions, read_lerobot
from servoscope.poses import pose_error

FPS, LENGTHS = 30, (25, 20, 15)
WRIST = "observation.images.wrist"


def times_of(episode):
    return 10.0 * episode + np.arange(LENGTHS[episode]) / FPS


def all_times(episodes=range(3)):
    return np.concatenate([times_of(e) for e in episodes])


def write_video(path, images, codec):
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=FPS)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.time_base = Fraction(1, FPS)
        if codec == "libsvtav1":
            stream.options = {"crf": "20", "g": "2", "preset": "12"}
        else:
            stream.bit_rate = 8_000_000
        for image in images:
            frame = av.VideoFrame.from_ndarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB), "rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def vectors(values):
    flat = pa.array(values.astype(np.float32).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


class Dataset:
    """Three episodes in two tables and two videos."""

    def __init__(self, folder, codec="mpeg4", *, as_images=False):
        self.folder = folder
        features = {
            "observation.state": {
                "dtype": "float32",
                "shape": [8],
                "names": {"motors": ["grip", "x", "y", "z", "rx", "ry", "rz", "speed"]},
            },
            "action": {"dtype": "float32", "shape": [7], "names": None},
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
        }
        video = {"dtype": "video", "shape": [HEIGHT, WIDTH, 3], "info": {"video.codec": codec}}
        features[WRIST] = {**video, "dtype": "image"} if as_images else video
        data = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
        self.info = {
            "codebase_version": "v3.0",
            "robot_type": "ur5e",
            "fps": FPS,
            "data_path": data,
            "video_path": ("videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"),
            "features": features,
        }
        (folder / "meta" / "episodes" / "chunk-000").mkdir(parents=True)
        self.write_info()
        tables, files = {}, [(0, 0), (0, 0), (0, 1)]
        episodes = {"episode_index": [0, 1, 2]}
        episodes |= {"data/chunk_index": [0, 0, 0], "data/file_index": [0, 0, 1]}
        episodes |= {f"videos/{WRIST}/chunk_index": [0, 0, 0]}
        episodes |= {f"videos/{WRIST}/file_index": [0, 0, 1]}
        episodes |= {f"videos/{WRIST}/from_timestamp": [0.0, LENGTHS[0] / FPS, 0.0]}
        pq.write_table(
            pa.table(episodes), folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
        )
        for episode in range(3):
            tables.setdefault(files[episode], []).append(self.rows(episode, as_images))
        for (chunk, file), parts in tables.items():
            path = folder / data.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(pa.concat_tables(parts), path, row_group_size=20)
        if not as_images:
            for file, shown in enumerate(((0, 1), (2,))):
                path = folder / "videos" / WRIST / "chunk-000" / f"file-{file:03d}.mp4"
                write_video(path, [image_at(t) for t in all_times(shown)], codec)

    def write_info(self):
        (self.folder / "meta" / "info.json").write_text(json.dumps(self.info))

    def rows(self, episode, as_images):
        times, n = times_of(episode), LENGTHS[episode]
        T = pose_at(times)
        rotvec = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
        q = Rotation.from_matrix(T[:, :3, :3]).as_quat(scalar_first=True)
        state = np.column_stack([np.full(n, 9), T[:, :3, 3], rotvec, np.full(n, 8)])
        columns = {
            "observation.state": vectors(state),
            "action": vectors(np.column_stack([1e3 * T[:, :3, 3], q])),
            "timestamp": pa.array((np.arange(n) / FPS).astype(np.float32)),
            "frame_index": pa.array(np.arange(n)),
            "episode_index": pa.array(np.full(n, episode)),
        }
        if as_images:
            packed = [cv2.imencode(".png", image_at(t))[1].tobytes() for t in times]
            columns[WRIST] = pa.array([{"bytes": b, "path": None} for b in packed])
        return pa.table(columns)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return Dataset(tmp_path_factory.mktemp("lerobot"))


@pytest.fixture
def fresh(tmp_path):
    return Dataset(tmp_path / "set")


POSE = {"rotation": "ur", "columns": "observation.state.x,y,z,rx,ry,rz"}
QUIET = {"clock_offset": 0.0, "reference_index": 10}


def read(dataset, **options):
    with pytest.warns(ServoscopeWarning, match=r"frames of lossy video \(mpeg4\)"):
        return read_lerobot(dataset.folder, LeRobotOptions(**{**POSE, **QUIET, **options}))


def refusal(dataset, **options):
    with pytest.raises(DataSetError) as caught:
        read_lerobot(dataset.folder, LeRobotOptions(**{**POSE, **QUIET, **options}))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def assert_camera_at(data, times):
    distance, angle = pose_error(data.T_world_cam, pose_at(times))
    assert distance.max() < 1e-6
    assert angle.max() < 1e-6


def test_every_frame_has_its_image_and_pose(recorded):
    data = read(recorded)
    wanted = np.stack([image_at(t) for t in all_times()]).astype(int)
    assert np.abs(data.images - wanted).mean() < 3
    apart = np.abs(data.images[1:] - wanted[:-1]).mean(axis=(1, 2))
    assert apart.min() > np.abs(data.images - wanted).mean(axis=(1, 2)).max()
    assert_camera_at(data, all_times())
    assert data.names[:2] == ["0000_000000", "0000_000001"]
    assert data.split == "blocks"
    assert (np.diff(data.times) > 0).all()
    assert data.source["camera"] == WRIST


@pytest.mark.parametrize(("asked", "episodes"), [("1", [1]), ("0,2", [0, 2]), ("1-2", [1, 2])])
def test_episodes_are_chosen(recorded, asked, episodes):
    data = read(recorded, episodes=asked)
    assert_camera_at(data, all_times(episodes))
    wanted = np.stack([image_at(t) for t in all_times(episodes)]).astype(int)
    assert np.abs(data.images - wanted).mean() < 3


@pytest.mark.filterwarnings("ignore::servoscope.errors.ServoscopeWarning")
@pytest.mark.parametrize("codec", ["libx264", "libsvtav1"])
def test_codecs_that_store_images_out_of_order_are_read_in_order(tmp_path, codec):
    if codec not in av.codecs_available:
        pytest.skip(f"PyAV is built without {codec}")
    dataset = Dataset(tmp_path, codec)
    options = LeRobotOptions(**POSE, **QUIET, episodes="1")
    data = read_lerobot(dataset.folder, options)
    wanted = np.stack([image_at(t) for t in times_of(1)]).astype(int)
    own = np.abs(data.images - wanted).mean(axis=(1, 2))
    next_ = np.abs(data.images[:-1] - wanted[1:]).mean(axis=(1, 2))
    before = np.abs(data.images[1:] - wanted[:-1]).mean(axis=(1, 2))
    assert own.mean() < 0.3 * min(next_.mean(), before.mean())


@pytest.mark.parametrize(
    "pose",
    [
        {"columns": "x,y,z,rx,ry,rz"},
        {"columns": ",".join(f"observation.state[{i}]" for i in range(1, 7))},
        {"columns": "action", "rotation": "abb-quaternion"},
    ],
)
def test_columns_are_named_in_several_ways(recorded, pose):
    assert_camera_at(read(recorded, **pose), all_times())


def test_images_within_the_table_are_read_as_they_are(tmp_path):
    dataset = Dataset(tmp_path, as_images=True)
    data = read_lerobot(dataset.folder, LeRobotOptions(**POSE, **QUIET))
    np.testing.assert_array_equal(data.images, [image_at(t) for t in all_times()])


def test_a_clock_offset_moves_poses_within_their_episode_alone(recorded):
    with pytest.warns(ServoscopeWarning, match="54 frames kept; left out: 6 without a pose near"):
        data = read(recorded, clock_offset=2 / FPS)
    shown = np.concatenate([times_of(e)[2:] for e in range(3)])
    distance, _ = pose_error(data.T_world_cam, pose_at(shown - 2 / FPS))
    assert distance.max() < 1e-6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": None}, "say which columns hold the pose"),
        ({"rotation": None}, "observation.state (grip x y z rx ry rz speed), action (7)"),
        ({"columns": "x,y,z"}, "ur has 6 numbers (tx ty tz rx ry rz), but --columns names 3"),
        ({"columns": "x,y,z,a,b,c"}, "the column 'a' is none"),
        ({"columns": "observation.state[8],x,y,z,rx,ry"}, "'observation.state[8]' is none"),
        ({"camera": "observation.images.top"}, f"has images in {WRIST}; choose one"),
        ({"episodes": "7"}, "no episode 7; they are numbered 0 to 2"),
        ({"episodes": "a-b"}, "episodes must be numbers such as 0,2,5-8"),
    ],
)
def test_what_is_not_said_or_not_there_is_refused(recorded, options, message):
    assert message in refusal(recorded, **options)


@pytest.mark.filterwarnings("ignore::servoscope.errors.ServoscopeWarning")
def test_damage_is_refused_in_one_line(fresh):
    fresh.info["codebase_version"] = "v2.1"
    fresh.write_info()
    assert "of version v2.1, but v3 is read" in refusal(fresh)
    fresh.info |= {"codebase_version": "v3.0", "data_path": "../../x.parquet"}
    fresh.write_info()
    assert "leads out of the folder" in refusal(fresh)
    fresh.info["data_path"] = "data/{file_index.__class__}.parquet"
    fresh.write_info()
    assert "is missing" in refusal(fresh)
    fresh.info["data_path"] = None
    fresh.write_info()
    video = fresh.folder / "videos" / WRIST / "chunk-000" / "file-000.mp4"
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) // 2])
    assert "file-000.mp4" in refusal(fresh)
    video.write_bytes(whole)
    (fresh.folder / "data" / "chunk-000" / "file-001.parquet").write_bytes(b"PAR1 no table")
    assert "file-001.parquet cannot be read" in refusal(fresh)


def test_without_its_packages_the_extra_is_named(recorded, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    assert "but av is not installed; install servoscope[lerobot]" in refusal(recorded)
