"""COLMAP, nerfstudio and BOP, written as their descriptions say: the poses come back."""

import json
import struct

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.formats import (
    BopOptions,
    ColmapOptions,
    NerfstudioOptions,
    read_bop,
    read_colmap,
    read_nerfstudio,
)


def inside(source, place):
    """The images of a source, in a folder within it."""
    (source.path / place).mkdir()
    for name in source.names:
        (source.path / name).rename(source.path / place / name)
    return source


def refusal(read, path, options):
    with pytest.raises(DataSetError) as caught:
        read(path, options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# COLMAP


def write_colmap(source, place="sparse/0", scale=1.0, bad=None):
    """As colmap model_converter writes text; the second line of an image may be long or empty."""
    model = source.path / place
    model.mkdir(parents=True, exist_ok=True)
    lines = [
        "# Image list with two lines of data per image:",
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
        "#   POINTS2D[] as (X, Y, POINT3D_ID)",
    ]
    for i, (name, T) in enumerate(zip(source.names, source.T_world_cam, strict=True)):
        T_cam_world = np.linalg.inv(T)
        q = Rotation.from_matrix(T_cam_world[:3, :3]).as_quat(scalar_first=True)
        numbers = " ".join(map(repr, [*q.tolist(), *(T_cam_world[:3, 3] / scale).tolist()]))
        lines.append(
            f"{i + 1} {numbers} 1 {name}" if i != bad else f"{i + 1} 0 0 0 0 1 1 1 1 {name}"
        )
        lines.append("12.5 7.25 -1 " * (20_000 if i == 2 else i % 2))
    (model / "images.txt").write_text("\n".join(lines))
    (model / "cameras.txt").write_text("# Cameras\n1 OPENCV 16 12 20 20 8 6 0.01 0 0 0\n")


COLMAP = {"reference": "02.png", "scale": 1.0}


@pytest.mark.parametrize("place", ["", "sparse/0", "sparse", "other"])
@pytest.mark.parametrize("images", ["images", "pictures"])
def test_a_colmap_model_reads_back(pose_folder, place, images):
    write_colmap(inside(pose_folder, images), place)
    named = {"model": "other"} if place == "other" else {}
    named |= {"images": images} if images == "pictures" else {}
    data = read_colmap(pose_folder.path, ColmapOptions(**COLMAP, **named))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    np.testing.assert_array_equal(data.images, pose_folder.images)
    assert data.source["cameras"] == ["1 OPENCV 16 12 20 20 8 6 0.01 0 0 0"]


def test_the_scale_of_a_reconstruction_is_said_or_warned_of(pose_folder):
    pose_folder.names[3] = "in a folder/03 b.png"
    pose_folder.write_image(pose_folder.names[3], pose_folder.images[3])
    write_colmap(pose_folder, scale=0.25)
    with pytest.warns(ServoscopeWarning, match="unit of a reconstruction is free.*--scale"):
        data = read_colmap(pose_folder.path, ColmapOptions(reference="02.png"))
    T = pose_folder.T_world_cam.copy()
    T[:, :3, 3] /= 0.25
    np.testing.assert_allclose(data.T_world_cam, T, atol=1e-9)
    data = read_colmap(pose_folder.path, ColmapOptions(reference="02.png", scale=0.25))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    with pytest.raises(InvalidInputError, match="scale must be a finite number above 0"):
        ColmapOptions(scale=0)


def test_a_colmap_model_that_cannot_be_used_is_refused(pose_folder):
    options = ColmapOptions(**COLMAP)
    message = refusal(read_colmap, pose_folder.path, options)
    assert "holds no images.txt or images.bin in ., sparse/0" in message
    (pose_folder.path / "images.bin").write_bytes(b"")
    assert "images.bin: the file ends too early" in refusal(read_colmap, pose_folder.path, options)
    write_colmap(pose_folder, bad=4)
    message = refusal(read_colmap, pose_folder.path, options)
    assert "images.txt, line 12: the quaternion" in message
    with pytest.warns(ServoscopeWarning, match=r"1 with an unusable pose \(04.png\)"):
        data = read_colmap(pose_folder.path, ColmapOptions(skip_bad=True, **COLMAP))
    assert len(data) == 5
    (pose_folder.path / "sparse/0/images.txt").write_text("1 1 0 0 0 0 0 0 1")
    assert "line 1: must be 'IMAGE_ID QW" in refusal(read_colmap, pose_folder.path, options)


def test_a_binary_model_that_is_called_text_is_refused(pose_folder):
    (pose_folder.path / "images.txt").write_bytes(b"\x08" + bytes(7) + b"\xff\xfe\x80")
    message = refusal(read_colmap, pose_folder.path, ColmapOptions(**COLMAP))
    assert "is no text; a binary model is called images.bin" in message


def write_binary_colmap(source, place="sparse/0", name=lambda text: text.encode() + b"\0"):
    """As COLMAP documents images.bin and cameras.bin."""
    model = source.path / place
    model.mkdir(parents=True, exist_ok=True)
    content = struct.pack("<Q", len(source.names))
    for i, (image, T) in enumerate(zip(source.names, source.T_world_cam, strict=True)):
        T_cam_world = np.linalg.inv(T)
        q = Rotation.from_matrix(T_cam_world[:3, :3]).as_quat(scalar_first=True)
        content += struct.pack("<I7dI", i + 1, *q, *T_cam_world[:3, 3], 1) + name(image)
        content += struct.pack("<Q", i) + struct.pack("<ddQ", 12.5, 7.25, 2**64 - 1) * i
    (model / "images.bin").write_bytes(content)
    camera = struct.pack("<QIiQQ", 1, 1, 2, 16, 12) + struct.pack("<4d", 20.0, 8.0, 6.0, -0.1)
    (model / "cameras.bin").write_bytes(camera)


def test_a_binary_colmap_model_reads_back(pose_folder):
    write_binary_colmap(inside(pose_folder, "images"))
    data = read_colmap(pose_folder.path, ColmapOptions(**COLMAP))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    np.testing.assert_array_equal(data.images, pose_folder.images)
    assert data.source["cameras"] == ["1 SIMPLE_RADIAL 16 12 20 8 6 -0.1"]


@pytest.mark.parametrize("end", [4, 8, 50, 80, 91, 300, -1])
def test_a_binary_colmap_model_that_is_cut_short_is_refused(pose_folder, end):
    write_binary_colmap(pose_folder, "")
    path = pose_folder.path / "images.bin"
    path.write_bytes(path.read_bytes()[:end])
    assert "write it again" in refusal(read_colmap, pose_folder.path, ColmapOptions(**COLMAP))


@pytest.mark.parametrize("name", [b"", b"\xff\xfe.png\0", b"a" * 5000])
def test_a_binary_colmap_model_with_damaged_names_is_refused(pose_folder, name):
    write_binary_colmap(pose_folder, "", name=lambda _: name)
    message = refusal(read_colmap, pose_folder.path, ColmapOptions(**COLMAP))
    assert "images.bin, image 1" in message


@pytest.mark.parametrize("write", ["write_text", "write_binary"])
@pytest.mark.parametrize("camera", ["SIMPLE_RADIAL", "OPENCV_FISHEYE"])
def test_what_pycolmap_writes_reads_back(pose_folder, write, camera):
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    lens = pycolmap.Camera.create_from_model_name(1, camera, 20.0, 16, 12)
    model.add_camera_with_trivial_rig(lens)
    for i, (name, T) in enumerate(zip(pose_folder.names, pose_folder.T_world_cam, strict=True)):
        image = pycolmap.Image(name=name, camera_id=1, image_id=i + 1)
        pose = pycolmap.Rigid3d(np.linalg.inv(T)[:3])
        model.add_image_with_trivial_frame(image, pose)
    (pose_folder.path / "sparse").mkdir()
    getattr(model, write)(pose_folder.path / "sparse")
    data = read_colmap(pose_folder.path, ColmapOptions(**COLMAP))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    assert data.source["cameras"][0].startswith(f"1 {camera} 16 12 20")


def test_images_of_several_cameras_are_warned_of(pose_folder):
    write_colmap(pose_folder)
    path = pose_folder.path / "sparse/0/images.txt"
    path.write_text(path.read_text().replace(" 1 03.png", " 2 03.png"))
    with pytest.warns(ServoscopeWarning, match="images are of 2 cameras"):
        read_colmap(pose_folder.path, ColmapOptions(**COLMAP))


# nerfstudio


def write_nerfstudio(source, edit=lambda i, entry: entry, place="", name="transforms.json"):
    frames = []
    for i, (image, T) in enumerate(zip(source.names, source.T_world_cam, strict=True)):
        opengl = T @ np.diag([1.0, -1.0, -1.0, 1.0])
        entry = {"file_path": f"{place}{image}", "transform_matrix": opengl.tolist()}
        frames.append(edit(i, entry))
    content = {"camera_model": "OPENCV", "fl_x": 20.0, "frames": frames}
    (source.path / name).write_text(json.dumps(content))


NERF = {"reference_index": 2, "scale": 1.0}


@pytest.mark.parametrize("ending", [True, False])
def test_a_transforms_json_reads_back_with_the_axes_of_opencv(pose_folder, ending):
    inside(pose_folder, "train")
    names = pose_folder.names
    if not ending:
        pose_folder.names = [name.removesuffix(".png") for name in names]
    write_nerfstudio(pose_folder, place="./train/", name="transforms_train.json")
    options = NerfstudioOptions(transforms="transforms_train.json", **NERF)
    data = read_nerfstudio(pose_folder.path, options)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)
    np.testing.assert_array_equal(data.images, pose_folder.images)
    assert data.names == [f"train/{name}" for name in names]


def test_a_transform_that_was_applied_to_the_world_changes_no_displacement(pose_folder):
    applied = np.array([[0, 1, 0, 0.3], [1, 0, 0, 0], [0, 0, -1, 0.2], [0, 0, 0, 1]])

    def moved(_, entry):
        return {**entry, "transform_matrix": (applied @ entry["transform_matrix"]).tolist()}

    write_nerfstudio(pose_folder, moved)
    data = read_nerfstudio(pose_folder.path, NerfstudioOptions(**NERF))
    there = np.linalg.inv(data.T_world_ref) @ data.T_world_cam
    here = np.linalg.inv(pose_folder.T_world_cam[2]) @ pose_folder.T_world_cam
    np.testing.assert_allclose(there, here, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"transform_matrix": [[1, 0], [0, 1]]}, "frame 4: must have a 'transform_matrix' of 4"),
        ({"transform_matrix": "none"}, "frame 4: must have a 'transform_matrix' of 4"),
        ({"transform_matrix": np.diag([1, 1, 1, 2]).tolist()}, "last row of the matrix must be"),
        ({"transform_matrix": np.diag([2, 2, 2, 1]).tolist()}, "frame 4: the rows of the rotation"),
        ({"file_path": 3}, "frame 4: must have a 'file_path'"),
        ({"file_path": "../x.png"}, "leads out of the folder"),
        ({"file_path": "00.png"}, "names 00.png more than once"),
    ],
)
def test_a_frame_that_is_none_is_refused_by_number(pose_folder, change, message):
    write_nerfstudio(pose_folder, lambda i, entry: entry | change if i == 4 else entry)
    assert message in refusal(read_nerfstudio, pose_folder.path, NerfstudioOptions(**NERF))


def test_a_frame_without_a_rotation_is_left_out_on_request(pose_folder):
    bad = np.diag([2, 2, 2, 1]).tolist()
    write_nerfstudio(pose_folder, lambda i, e: e | {"transform_matrix": bad} if i == 4 else e)
    with pytest.warns(ServoscopeWarning, match=r"1 with an unusable pose \(04.png\)"):
        data = read_nerfstudio(pose_folder.path, NerfstudioOptions(skip_bad=True, **NERF))
    assert len(data) == 5


def test_a_file_without_frames_is_refused(pose_folder):
    (pose_folder.path / "transforms.json").write_text('{"frames": {}}')
    options = NerfstudioOptions(**NERF)
    assert "must hold a list 'frames'" in refusal(read_nerfstudio, pose_folder.path, options)


# BOP


def write_bop(source, place="rgb", ending="png"):
    """Object 3 in all images but the fifth, twice in the sixth; object 7 in the first."""
    (source.path / place).mkdir()
    truth, cameras = {}, {}
    T_world_part = np.eye(4)
    T_world_part[:3, 3] = 0.1, 0.2, 0.3
    for i, T in enumerate(source.T_world_cam):
        number = 10 * i
        cv2.imwrite(str(source.path / place / f"{number:06d}.{ending}"), source.images[i])
        T_cam_part = np.linalg.inv(T) @ T_world_part
        entries = [entry(T_cam_part, 3)] * (0 if i == 4 else 2 if i == 5 else 1)
        truth[str(number)] = entries + ([entry(np.eye(4), 7)] if i == 0 else [])
        T_cam_world = np.linalg.inv(T)
        cameras[str(number)] = {
            "cam_K": [20.0, 0, 8, 0, 20, 6, 0, 0, 1],
            "cam_R_w2c": T_cam_world[:3, :3].ravel().tolist(),
            "cam_t_w2c": (1e3 * T_cam_world[:3, 3]).tolist(),
        }
    (source.path / "scene_gt.json").write_text(json.dumps(truth))
    (source.path / "scene_camera.json").write_text(json.dumps(cameras))
    return T_world_part


def entry(T, obj_id):
    return {
        "cam_R_m2c": T[:3, :3].ravel().tolist(),
        "cam_t_m2c": (1e3 * T[:3, 3]).tolist(),
        "obj_id": obj_id,
    }


@pytest.mark.parametrize("place", ["rgb", "gray"])
def test_an_object_of_a_scene_stands_for_the_world(pose_folder, place):
    T_world_part = write_bop(pose_folder, place)
    options = BopOptions(object="3", reference_index=20, skip_bad=True)
    with pytest.warns(ServoscopeWarning, match=r"4 frames kept; left out: 2 without the object"):
        data = read_bop(pose_folder.path, options)
    wanted = np.linalg.inv(T_world_part) @ pose_folder.T_world_cam[:4]
    np.testing.assert_allclose(data.T_world_cam, wanted, atol=1e-12)
    np.testing.assert_array_equal(data.images, pose_folder.images[:4])
    assert data.names[1] == f"{place}/000010.png"
    assert data.source["options"]["units"] == "mm"


def test_the_world_of_a_scene_is_its_own(pose_folder):
    write_bop(pose_folder)
    data = read_bop(pose_folder.path, BopOptions(object="world", reference_index=20))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)


def test_a_scene_that_leaves_a_choice_is_refused(pose_folder):
    write_bop(pose_folder)
    asked = {"reference_index": 20}
    message = refusal(read_bop, pose_folder.path, BopOptions(**asked))
    assert "shows the objects 3, 7; choose the one" in message
    message = refusal(read_bop, pose_folder.path, BopOptions(object="3", **asked))
    assert "image 50: shows the object 3 2 times" in message
    (pose_folder.path / "scene_gt.json").write_text('{"0": [{"obj_id": 1}], "1": []}')
    message = refusal(read_bop, pose_folder.path, BopOptions(**asked))
    assert "image 0: must have cam_R_m2c of 9 numbers" in message
    (pose_folder.path / "scene_gt.json").write_text('{"a": []}')
    message = refusal(read_bop, pose_folder.path, BopOptions(**asked))
    assert "must have the numbers of images as keys" in message
    message = refusal(read_bop, pose_folder.path, BopOptions(object="3", images="x", **asked))
    assert "numbers of images" in message or "no folder of images x" in message
