"""Bags, as rosbags writes them: the images and poses that went in come out."""

import json
import tracemalloc
import warnings

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from moving_camera import image_at, pose_at
from recorded_bags import KINDS, Recorder, times_of_images, write_bag
from servoscope.cli import main
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats import BagOptions, bag_files, read_bag
from servoscope.poses import pose_error, rigid_transform

N = 60


@pytest.fixture(scope="module")
def images():
    return np.stack([image_at(t) for t in times_of_images(N)])


@pytest.fixture(scope="module", params=KINDS)
def bag(request, images, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bag"), request.param, images)


@pytest.fixture(scope="module")
def plain(images, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bag"), "mcap", images)


QUIET = {"clock_offset": 0.0, "reference_index": 30}


def refusal(path, **options):
    with pytest.raises(DataSetError) as caught:
        read_bag(path, BagOptions(**{**QUIET, **options}))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def assert_camera_at(data, times, mm=0.05):
    distance, angle = pose_error(data.T_world_cam, pose_at(times))
    assert 1e3 * distance.max() < mm
    assert np.degrees(angle.max()) < 0.02


def test_every_kind_of_bag_gives_back_what_was_recorded(bag, images):
    done = []
    data = read_bag(bag, BagOptions(**QUIET), done.append)
    np.testing.assert_array_equal(data.images, images)
    np.testing.assert_allclose(data.times, times_of_images(N), rtol=0, atol=1e-6)
    assert_camera_at(data, times_of_images(N))
    assert (data.names[0], data.names[-1], data.split) == ("000000", "000059", "blocks")
    assert data.source["image_topic"] == "/image"
    assert data.source["pose_topics"] == ["/pose"]
    assert done[-1] == N


def test_only_the_images_that_are_kept_are_decoded(plain, images, monkeypatch):
    from servoscope.formats import bag as module

    decoded = []
    original = module.grey_of_message
    monkeypatch.setattr(module, "grey_of_message", lambda *a: decoded.append(a[2]) or original(*a))
    with pytest.warns(ServoscopeWarning, match="far from the reference"):
        data = read_bag(plain, BagOptions(max_mm=10, **QUIET))
    numbers = [int(name) for name in data.names]
    np.testing.assert_array_equal(data.images, images[numbers])
    assert 2 <= len(data) < 40
    assert len(decoded) == len(data) + 1


@pytest.mark.filterwarnings("default::servoscope.errors.ServoscopeWarning")
def test_the_command_imports_a_bag_and_reports_late_images(images, tmp_path, capsys):
    path = tmp_path / "recording"
    with Recorder(tmp_path, "mcap") as recorder:
        for i, t in enumerate(times_of_images(N)):
            recorder.write("/image", t, recorder.image(t + 0.06, images[i]))
            for k in range(4):
                at = t + k / 120
                recorder.write("/pose", at, recorder.pose(at, pose_at([at])[0]))
    command = ["import", "bag", str(path), str(tmp_path / "set"), "--json", "--max-gap-s", "0.2"]
    assert main([*command, "--clock-offset", "estimate"]) == 0
    out, err = capsys.readouterr()
    facts = json.loads(out)
    assert facts["images"] == N
    assert "ms behind their poses by what they show" in err
    assert "that was applied" in err


# Encodings


def encoded(grey):
    """Images of one scene in every encoding, with what they should read as."""
    colour = np.stack([grey, 255 - grey, grey // 2], axis=2)
    luma = cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY)
    alpha = np.full(grey.shape, 7, np.uint8)
    wide = grey.astype(np.uint16) * 16
    yuv = np.stack([grey, np.full_like(grey, 128)], axis=2)
    return {
        "mono8": (grey, grey),
        "8UC1": (grey, grey),
        "rgb8": (colour, luma),
        "bgr8": (colour[..., ::-1], luma),
        "rgba8": (np.dstack([colour, alpha]), luma),
        "bgra8": (np.dstack([colour[..., ::-1], alpha]), luma),
        "16UC1": (wide, grey),
        "mono16": (wide, grey),
        "bgr16": (colour[..., ::-1].astype(np.uint16) * 16, luma),
        "yuv422_yuy2": (yuv, grey),
        "uyvy": (yuv[..., ::-1], grey),
    }


@pytest.mark.parametrize(("pad", "big"), [(0, 0), (6, 0), (0, 1)])
@pytest.mark.parametrize("encoding", list(encoded(np.zeros((2, 2), np.uint8))))
def test_every_encoding_is_read_whatever_pads_its_rows(images, tmp_path, encoding, pad, big):
    wanted = []
    with Recorder(tmp_path, "rosbag 1") as recorder:
        for t, image in zip(times_of_images(3), images[::20], strict=True):
            pixels, grey = encoded(image)[encoding]
            if big and pixels.dtype == np.uint16:
                pixels = pixels.byteswap()
            wanted.append(grey)
            message = recorder.image(t, pixels, encoding, pad=pad, big=big)
            recorder.write("/image", t, message)
            recorder.write("/pose", t, recorder.pose(t, pose_at([t])[0]))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*taken to fill 12 bits")
        data = read_bag(recorder.path, BagOptions(clock_offset=0.0, reference_index=1))
    np.testing.assert_allclose(data.images.astype(int), wanted, atol=1)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_show_the_colours_that_were_there(tmp_path, pattern):
    rgb = {"r": 200, "g": 100, "b": 30}
    cell = np.array([[rgb[pattern[0]], rgb[pattern[1]]], [rgb[pattern[2]], rgb[pattern[3]]]])
    mosaic = np.tile(cell, (16, 20)).astype(np.uint8)
    luma = 0.299 * 200 + 0.587 * 100 + 0.114 * 30
    mosaic[:, :8] = 0
    with Recorder(tmp_path, "rosbag 1") as recorder:
        for t in times_of_images(2):
            message = recorder.image(
                t, np.roll(mosaic, int(30 * t) % 2 * 2, 0), f"bayer_{pattern}8"
            )
            recorder.write("/image", t, message)
            recorder.write("/pose", t, recorder.pose(t, pose_at([t])[0]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ServoscopeWarning)
        data = read_bag(recorder.path, BagOptions(clock_offset=0.0, reference_index=1))
    assert abs(data.images[0, 8:-8, 14:-4] - luma).max() < 2


@pytest.mark.parametrize(("ending", "off"), [("png", 0), ("jpeg", 12)])
def test_compressed_images_are_decoded(images, tmp_path, ending, off):
    with Recorder(tmp_path, "sqlite3") as recorder:
        for t, image in zip(times_of_images(3), images[::20], strict=True):
            recorder.write("/image/compressed", t, recorder.compressed(t, image, ending))
            recorder.write("/pose", t, recorder.pose(t, pose_at([t])[0]))
    data = read_bag(recorder.path, BagOptions(clock_offset=0.0, reference_index=1))
    np.testing.assert_allclose(data.images.astype(int), images[::20], atol=off)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"encoding": "32FC1"}, "has the encoding '32FC1'; read are mono8"),
        ({"height": 4_000_000}, "says 64 x 4000000 px of mono8 in rows of 64 bytes, but holds"),
        ({"step": 3}, "in rows of 3 bytes, but holds 3072 bytes"),
    ],
)
def test_an_image_that_is_none_is_refused_by_number_or_left_out(images, tmp_path, spoil, message):
    with Recorder(tmp_path, "mcap") as recorder:
        for i, t in enumerate(times_of_images(4)):
            image = recorder.image(t, images[15 * i])
            if i == 3:
                for name, value in spoil.items():
                    object.__setattr__(image, name, value)
            recorder.write("/image", t, image)
            recorder.write("/pose", t, recorder.pose(t, pose_at([t])[0]))
    options = {"clock_offset": 0.0, "reference_index": 1}
    assert message in refusal(recorder.path, **options)
    assert "image 000003" in refusal(recorder.path, **options)
    with pytest.warns(ServoscopeWarning, match=r"1 with an unusable image \(000003\)"):
        data = read_bag(recorder.path, BagOptions(skip_bad=True, **options))
    np.testing.assert_array_equal(data.images, images[[0, 15, 30]])


# Topics


def test_topics_are_chosen_or_listed(images, tmp_path):
    with Recorder(tmp_path, "mcap") as recorder:
        for i, t in enumerate(times_of_images(10)):
            recorder.write("/left/image", t, recorder.image(t, images[i]))
            recorder.write("/right/image", t, recorder.image(t, 255 - images[i]))
            recorder.write("/pose", t, recorder.pose(t, pose_at([t])[0]))
            recorder.write("/goal", t, recorder.pose(t, np.eye(4)))
    path = recorder.path
    few = {"reference_index": 5}
    assert "has images in /left/image, /right/image; choose one with --image-topic" in refusal(
        path, **few
    )
    assert "has no images in '/middle'" in refusal(path, image_topic="/middle", **few)
    assert "/goal (geometry_msgs/msg/PoseStamped, 10)" in refusal(
        path, image_topic="/middle", **few
    )
    chosen = {"image_topic": "right/image", **few}
    assert "choose poses with --pose-topic" in refusal(path, **chosen)
    data = read_bag(path, BagOptions(clock_offset=0, pose_topic="/pose", **chosen))
    np.testing.assert_array_equal(data.images, 255 - images[:10])
    assert_camera_at(data, times_of_images(10))
    assert "holds no frames" in refusal(path, base="world", **chosen)
    assert "has no poses in '/left/image'" in refusal(path, pose_topic="/left/image", **chosen)


def test_messages_without_stamps_need_the_times_when_they_were_logged(images, tmp_path):
    with Recorder(tmp_path, "sqlite3") as recorder:
        for i, t in enumerate(times_of_images(10)):
            recorder.write("/image", t, recorder.image(0.0, images[i]))
            recorder.write("/pose", t, recorder.pose(0.0, pose_at([t])[0]))
    few = {"clock_offset": 0.0, "reference_index": 5}
    assert "not stamped; take the times when they were logged, with --stamps log" in refusal(
        recorder.path, **few
    )
    data = read_bag(recorder.path, BagOptions(stamps="log", **few))
    assert_camera_at(data, times_of_images(10))


def test_several_files_of_one_recording_are_joined(images, tmp_path):
    (tmp_path / "all").mkdir()
    for part in range(2):
        (tmp_path / f"{part}").mkdir()
        with Recorder(tmp_path / f"{part}", "rosbag 1") as recorder:
            for i in range(30 * part, 30 * part + 30):
                t = times_of_images(N)[i]
                recorder.write("/image", t, recorder.image(t, images[i]))
                recorder.write("/pose", t, recorder.pose(t, pose_at([t])[0]))
        recorder.path.rename(tmp_path / "all" / f"recording_{9 + part}.bag")
    data = read_bag(tmp_path / "all", BagOptions(**QUIET))
    np.testing.assert_array_equal(data.images, images)
    assert_camera_at(data, times_of_images(N))


# Frames


T_BASE_WORLD = rigid_transform(Rotation.from_rotvec([0, 0, 0.4]).as_matrix(), [1, 2, 0])
T_FLANGE_CAM = rigid_transform(Rotation.from_rotvec([0.2, 0, -1.2]).as_matrix(), [0, 0.1, 0.05])


@pytest.fixture(scope="module")
def frames(images, tmp_path_factory):
    """A tree: world -> base -> flange -> camera, of which the middle moves."""
    folder = tmp_path_factory.mktemp("frames")
    with Recorder(folder, "rosbag 1") as recorder:
        static = [
            recorder.transform(0.0, "/world", "base", np.linalg.inv(T_BASE_WORLD)),
            recorder.transform(0.0, "flange", "camera", T_FLANGE_CAM),
        ]
        recorder.write("/tf_static", 999.0, recorder.frames(*static))
        for i, t in enumerate(times_of_images(N)):
            recorder.write("/image", t, recorder.image(t, images[i], frame="/camera"))
            for k in range(3):
                at = t + k / 90 - 0.001
                T_base_flange = T_BASE_WORLD @ pose_at([at])[0] @ np.linalg.inv(T_FLANGE_CAM)
                other = recorder.transform(at, "base", "gripper", np.eye(4))
                moving = recorder.transform(at, "base", "flange", T_base_flange)
                recorder.write("/tf", at + 0.002, recorder.frames(other, moving))
    return recorder.path


@pytest.mark.parametrize(
    "options", [{}, {"camera": "camera"}, {"base": "world"}, {"base": "/world", "camera": "camera"}]
)
def test_a_chain_of_frames_gives_the_pose_of_the_camera_in_the_base(frames, options):
    data = read_bag(frames, BagOptions(**QUIET, **options))
    assert_camera_at(data, times_of_images(N), mm=0.2)


def test_a_chain_may_go_down_and_up(frames):
    data = read_bag(frames, BagOptions(**QUIET, base="gripper"))
    wanted = T_BASE_WORLD @ pose_at(times_of_images(N))
    assert 1e3 * pose_error(data.T_world_cam, wanted)[0].max() < 0.2


def test_frames_that_are_not_there_or_do_not_move_are_refused_with_those_there_are(frames):
    message = refusal(frames, base="table")
    assert "has no frame 'table', which --base names" in message
    assert "its frames are base, camera, flange, gripper, world" in message
    assert "has no frame 'lens', which --camera" in refusal(frames, camera="lens")
    assert "never move against each other" in refusal(frames, base="flange")


def test_a_static_transform_that_changes_is_refused(images, tmp_path):
    with Recorder(tmp_path, "mcap") as recorder:
        for i, t in enumerate(times_of_images(10)):
            recorder.write("/image", t, recorder.image(t, images[i]))
            moving = recorder.transform(t, "base", "flange", pose_at([t])[0])
            recorder.write("/tf", t, recorder.frames(moving))
            T = rigid_transform(np.eye(3), [0.01 * (i > 4), 0, 0])
            static = recorder.transform(t, "flange", "camera", T)
            recorder.write("/tf_static", t, recorder.frames(static))
    message = refusal(recorder.path, reference_index=5)
    assert "static transform flange -> camera changes by 10 mm" in message


# Joints

URDF = """<robot name="arm">
  <link name="base"/><link name="arm"/><link name="slide"/><link name="camera"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0.1 0 0.3" rpy="0.2 -0.1 0.4"/><axis xyz="0 0 2"/></joint>
  <joint name="push" type="prismatic"><parent link="arm"/><child link="slide"/>
    <origin xyz="0.2 0 0" rpy="0 1.2 0"/><axis xyz="1 0 0"/></joint>
  <joint name="mount" type="fixed"><parent link="slide"/><child link="camera"/>
    <origin xyz="0 0.05 0.02" rpy="3.1 0 0"/></joint>
</robot>"""


def test_joints_and_a_urdf_give_the_pose_that_a_physics_engine_gives(images, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "arm.urdf").write_text(URDF)
    ones = "".join(
        f' i{axes}="{int(axes[0] == axes[1])}"' for axes in ("xx", "yy", "zz", "xy", "xz", "yz")
    )
    inertia = f'<inertial><mass value="1"/><inertia{ones}/></inertial>'
    xml = URDF.replace('"/><link', f'">{inertia}</link><link').replace(
        'camera"/>\n  <joint name="turn"', f'camera">{inertia}</link>\n  <joint name="turn"'
    )
    xml = xml.replace(
        '<robot name="arm">', '<robot name="arm"><mujoco><compiler fusestatic="false"/></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(xml)
    state = mujoco.MjData(model)
    wanted = []
    with Recorder(tmp_path, "mcap") as recorder:
        for i, t in enumerate(times_of_images(20)):
            turn, push = 0.3 * np.sin(3 * (t - 1000)), 0.05 * np.cos(2 * (t - 1000))
            recorder.write("/image", t, recorder.image(t, images[i]))
            recorder.write("/joint_states", t, recorder.joints(t, ["grip"], [0.3]))
            names, positions = ["push", "grip", "turn"], [push, 9.0, turn]
            recorder.write("/joint_states", t, recorder.joints(t, names, positions))
            state.joint("turn").qpos[:], state.joint("push").qpos[:] = turn, push
            mujoco.mj_kinematics(model, state)
            body = state.body("camera")
            wanted.append(rigid_transform(body.xmat.reshape(3, 3), body.xpos))
    options = {"urdf": str(tmp_path / "arm.urdf"), "reference_index": 10}
    data = read_bag(recorder.path, BagOptions(clock_offset=0.0, base="base", **options))
    np.testing.assert_allclose(data.T_world_cam, wanted, atol=1e-9)
    assert "which poses are meant is not known; joints" in refusal(
        recorder.path, reference_index=10
    )
    assert "has no link 'lens', which --camera names; it has arm, base, camera" in refusal(
        recorder.path, camera="lens", **options
    )
    (tmp_path / "arm.urdf").write_text(URDF.replace('"turn"', '"shoulder"'))
    assert "holds all of shoulder, push" in refusal(recorder.path, **options)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot>", "is no URDF"),
        ("<robot/>", "holds no joint"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><robot/>', "declares entities"),
        (URDF.replace('"0 0 2"', '"0 0 0"'), "axis of zero length"),
        (URDF.replace("revolute", "floating"), "turn is floating; joints between"),
    ],
)
def test_what_is_no_urdf_is_refused(images, tmp_path, text, message):
    (tmp_path / "arm.urdf").write_text(text)
    with Recorder(tmp_path, "mcap") as recorder:
        for t in times_of_images(2):
            recorder.write("/image", t, recorder.image(t, images[0]))
            recorder.write("/joint_states", t, recorder.joints(t, ["turn", "push"], [0, 0]))
    options = {"urdf": str(tmp_path / "arm.urdf"), "reference_index": 0}
    assert message in refusal(recorder.path, **options)


# Sizes and damage


def test_a_long_bag_is_read_in_little_memory(tmp_path, images):
    large = cv2.resize(images[0], (640, 480))
    with Recorder(tmp_path, "sqlite3") as recorder:
        for i, t in enumerate(times_of_images(200)):
            recorder.write("/image", t, recorder.image(t, np.roll(large, i, 1)))
            recorder.write("/pose", t, recorder.pose(t, pose_at([t])[0]))
    options = BagOptions(max_images=20, image_width=64, clock_offset=0, reference_index=100)
    tracemalloc.start()
    with pytest.warns(ServoscopeWarning, match="180 between others"):
        data = read_bag(recorder.path, options)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(data) == 20
    assert sum(f.stat().st_size for f in recorder.path.iterdir()) > 60e6
    assert peak < 10e6


def test_as_many_images_are_kept_as_fit(plain, monkeypatch):
    monkeypatch.setattr("servoscope.formats.assembly.MOST_BYTES", 20 * 64 * 48)
    with pytest.warns(ServoscopeWarning, match="20 frames kept; left out: 40 between others"):
        data = read_bag(plain, BagOptions(**QUIET))
    assert len(data) == 20
    assert "40 images of 64 x 48 px are more than 0 MB, which hold 20" in refusal(
        plain, max_images=40
    )


@pytest.mark.parametrize(
    "kind", [k for k in KINDS if ("packed" in k and "file" not in k) or "z" in k[-3:]]
)
def test_what_unpacks_to_too_much_is_refused(kind, images, tmp_path, monkeypatch):
    path = write_bag(tmp_path, kind, images[:12])
    monkeypatch.setattr(bag_files, "LARGEST_CHUNK", 2000)
    message = refusal(path, reference_index=5)
    assert "more than 2000" in message or "chunk of" in message


def test_a_packed_file_is_not_unpacked_beyond_the_disk(images, tmp_path, monkeypatch):
    path = write_bag(tmp_path, "sqlite3, packed file", images[:12])
    monkeypatch.setattr(bag_files.shutil, "disk_usage", lambda _: type("", (), {"free": 1000}))
    assert "unpacks to more than 800 bytes" in refusal(path, reference_index=5)


@pytest.mark.parametrize(
    "kind", ["rosbag 1", "rosbag 1, lz4", "sqlite3", "mcap", "mcap, packed chunks"]
)
@pytest.mark.parametrize("where", [0.0, 0.3, 0.6, 0.95])
def test_damage_is_one_line_or_does_no_harm(kind, where, images, tmp_path):
    path = write_bag(tmp_path, kind, images[:12])
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    content = bytearray(file.read_bytes())
    start = int(where * len(content))
    content[start : start + 200] = b"\xff" * 200
    file.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ServoscopeWarning)
        try:
            read_bag(path, BagOptions(clock_offset=0.0, reference_index=5))
        except DataSetError as error:
            assert "\n" not in str(error)  # noqa: PT017
    file.write_bytes(content[: len(content) // 2])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ServoscopeWarning)
        with pytest.raises(DataSetError):
            read_bag(path, BagOptions(clock_offset=0.0, reference_index=5))


def test_what_is_no_bag_is_refused(tmp_path):
    assert "does not exist; name a bag" in refusal(tmp_path / "nothing")
    (tmp_path / "a.txt").write_text("")
    assert "must end with one of .bag, .db3, .mcap" in refusal(tmp_path / "a.txt")
    assert "holds no file that ends with" in refusal(tmp_path)
    (tmp_path / "a.mcap").write_text("no bag")
    assert "a.mcap cannot be read" in refusal(tmp_path)


def test_without_rosbags_the_extra_is_named(plain, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert "install servoscope[bags]" in refusal(plain)
