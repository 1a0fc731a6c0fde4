"""Cameras of GenTL, with a stand-in of harvesters that behaves as its documentation says."""

import inspect
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from servoscope.errors import (
    CameraFaultError,
    InvalidInputError,
    ServoscopeError,
    ServoscopeWarning,
)
from servoscope.robots.devices import open_camera


class Node:
    def __init__(self, value, allowed=None):
        self._value, self.allowed = value, allowed

    @property
    def value(self):
        return self._value

    @value.setter
    def value(self, value):
        if self.allowed is not None and value not in self.allowed:
            raise RuntimeError("AccessException: node is not writable")
        self._value = value


class ImageAcquirer:
    def __init__(self, camera):
        self.camera, self.is_acquiring_now = camera, False
        self.remote_device = SimpleNamespace(node_map=camera.nodes)

    def start(self, *, run_as_thread=False):
        assert not self.is_acquiring_now
        self.is_acquiring_now = True

    def fetch(self, *, timeout=0, is_raw=False, cycle_s=None):
        assert self.is_acquiring_now
        if self.camera.is_silent:
            raise TimeoutError("time out")
        return Buffer(self.camera.component())

    def stop(self):
        self.is_acquiring_now = False

    def destroy(self):
        self.camera.is_destroyed = True


class Buffer:
    def __init__(self, component):
        self.payload, self.is_queued = SimpleNamespace(components=[component]), False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.payload = None  # the memory goes back to the camera


class Harvester:
    camera: "Camera"

    def __init__(self):
        self.device_info_list = []

    def add_file(self, file_path):
        self.file_path = file_path

    def update(self):
        self.device_info_list = [SimpleNamespace(serial_number=s) for s in self.camera.serials]

    def create(self, search_key=None):
        if isinstance(search_key, dict):
            (search_key,) = (
                i
                for i, info in enumerate(self.device_info_list)
                if info.serial_number == search_key["serial_number"]
            )
        self.device_info_list[search_key]
        return ImageAcquirer(self.camera)

    def reset(self):
        self.camera.is_reset = True


class Camera:
    def __init__(self):
        self.serials, self.pixel_format = ["A1"], "Mono8"
        self.image = np.arange(24, dtype=np.uint8).reshape(4, 6)
        self.is_silent = self.is_destroyed = self.is_reset = False
        self.nodes = SimpleNamespace(
            ExposureAuto=Node("Continuous"), GainAuto=Node("Continuous"),
            BalanceWhiteAuto=Node("Continuous"), ExposureTime=Node(1000.0),
            Gain=Node(0.0, allowed=[0.0, 6.0]), PixelFormat=Node("Mono8"),
        )  # fmt: skip

    def component(self):
        height, width = self.image.shape[:2]
        return SimpleNamespace(
            data=self.image.ravel(), height=height, width=width, data_format=self.pixel_format
        )


@pytest.fixture
def camera(monkeypatch, tmp_path):
    one = Camera()
    core = ModuleType("harvesters.core")
    core.Harvester = type("Harvester", (Harvester,), {"camera": one})
    monkeypatch.setitem(sys.modules, "harvesters", ModuleType("harvesters"))
    monkeypatch.setitem(sys.modules, "harvesters.core", core)
    (tmp_path / "maker.cti").touch()
    monkeypatch.chdir(tmp_path)
    return one


def test_images_are_grey_and_automatics_are_off(camera):
    opened = open_camera("gentl:maker.cti?exposure=2500&gain=6")
    np.testing.assert_array_equal(opened.read(), camera.image)
    camera.image = 255 - camera.image
    np.testing.assert_array_equal(opened.read(), camera.image)
    nodes = camera.nodes
    assert nodes.ExposureAuto.value == nodes.GainAuto.value == nodes.BalanceWhiteAuto.value == "Off"
    assert (nodes.ExposureTime.value, nodes.Gain.value) == (2500.0, 6.0)
    opened.close()
    assert camera.is_destroyed
    assert camera.is_reset


def test_images_of_more_bits_and_of_colour(camera):
    opened = open_camera("gentl:maker.cti")
    camera.pixel_format, camera.image = "Mono12", np.full((4, 6), 4080, np.uint16)
    assert (opened.read() == 255).all()
    camera.pixel_format = "BGR8"
    camera.image = np.zeros((4, 6, 3), np.uint8)
    camera.image[..., 2] = 100  # red
    assert (opened.read() == 30).all()
    camera.pixel_format, camera.image = "BayerRG8", np.zeros((8, 8), np.uint8)
    camera.image[::2, ::2] = 100  # red
    assert (opened.read()[2:-2, 2:-2] == 30).all()


def test_the_camera_is_chosen_by_its_serial_number(camera):
    camera.serials = ["A1", "B2"]
    with pytest.raises(CameraFaultError, match="there are 2, name one by serial=A1 or B2"):
        open_camera("gentl:maker.cti")
    assert open_camera("gentl:maker.cti?serial=B2").read().shape == (4, 6)


@pytest.mark.parametrize(
    ("options", "changes", "kind", "said"),
    [
        ("", {"serials": []}, CameraFaultError, "No camera could be opened"),
        ("?gain=3", {}, CameraFaultError, "does not take 3 for Gain"),
        ("?timeout=0", {}, InvalidInputError, "timeout must be from"),
        ("/no.cti", {}, InvalidInputError, r"must be a \.cti file"),
    ],
)
def test_what_cannot_be_opened_says_why(camera, options, changes, kind, said):
    for name, value in changes.items():
        setattr(camera, name, value)
    with pytest.raises(kind, match=said):
        open_camera(f"gentl:maker.cti{options}")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"is_silent": True}, r"no image within 5 s \(time out\)"),
        ({"pixel_format": "Mono12Packed"}, "but the camera gives Mono12Packed"),
    ],
)
def test_what_cannot_be_read_says_why_and_may_be_tried_again(camera, changes, said):
    opened = open_camera("gentl:maker.cti")
    before = {name: getattr(camera, name) for name in changes}
    for values in (changes, changes, before):
        for name, value in values.items():
            setattr(camera, name, value)
        if values is before:
            assert opened.read().shape == (4, 6)
            continue
        with pytest.raises(CameraFaultError, match=said) as caught:
            opened.read()
        assert len(str(caught.value).splitlines()) == 1


def test_what_cannot_be_held_is_named(camera):
    camera.nodes.GainAuto = Node("Continuous", allowed=["Continuous"])
    del camera.nodes.BalanceWhiteAuto
    with pytest.warns(ServoscopeWarning, match="does not let its gain be held"):
        open_camera("gentl:maker.cti")


def test_without_the_library_it_says_what_to_install(camera, monkeypatch):
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(ServoscopeError, match=r"pip install \"servoscope\[gentl\]\""):
        open_camera("gentl:maker.cti")


@pytest.mark.parametrize("kind", [Harvester, ImageAcquirer])
def test_the_stand_in_has_the_methods_of_the_library(kind):
    real = getattr(pytest.importorskip("harvesters.core"), kind.__name__)
    for method, function in inspect.getmembers(kind, inspect.isfunction):
        if method != "__init__":
            known = inspect.signature(getattr(real, method)).parameters
            assert set(inspect.signature(function).parameters) <= set(known)
