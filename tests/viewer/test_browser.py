"""The page is served to this machine alone, and its buttons do what they say."""

import asyncio
import socket
import time
import urllib.request
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.result import Step
from servoscope.viewer.browser import Browser
from servoscope.viewer.history import History, Look, Setting
from small_keyframe import displacements, small_model

viser = pytest.importorskip("viser")
import msgspec  # noqa: E402
from viser import _messages  # noqa: E402
from websockets.asyncio.client import connect  # noqa: E402
from websockets.exceptions import InvalidStatus  # noqa: E402

CAMERA = _messages.ViewerCameraMessage(
    wxyz=(1.0, 0.0, 0.0, 0.0), position=(0.0, 0.0, 0.0), fov=1.0, near=0.1, far=10.0,
    image_height=9, image_width=9, look_at=(0.0, 0.0, 1.0), up_direction=(0.0, -1.0, 0.0),
)  # fmt: skip
"""What a page says first of all: where it is looked from."""


class Pressed:
    """A player that keeps what it was told."""

    def __init__(self) -> None:
        self.heard: list[str] = []

    def step(self) -> None:
        self.heard.append("step")

    def run(self) -> None:
        self.heard.append("run")

    def stop(self) -> None:
        self.heard.append("stop")

    def seek(self, k: int) -> None:
        self.heard.append(f"seek {k}")


@pytest.fixture(scope="module")
def history() -> History:
    model = small_model(guesses=False)
    setting, looks = Setting.of_estimator(model), []
    for D in (*displacements(2), np.eye(4)):
        move = None if (np.eye(4) == D).all() else np.linalg.inv(D)
        step = Step(np.eye(4), 0.1, Estimate(D, np.full(6, 1e-3), 0.1, "fine"), move, None, 0.01)
        looks.append(Look.of_step(step, model.keyframe.render(D)[0], setting))
    return History(setting, looks, "converged: there")


@pytest.fixture(scope="module")
def browser(history) -> Iterator[Browser]:
    browser = Browser(history, port=0)
    yield browser
    browser.close()


@pytest.fixture
def player(browser) -> Pressed:
    pressed = Pressed()
    browser.command(pressed)
    return pressed


async def opened(browser: Browser, origin: str | None):
    return await connect(
        browser.address.replace("http", "ws"),
        origin=origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        max_size=None,
        proxy=None,
    )


def first_message(browser: Browser) -> bytes:
    """What a page of the viewer's own receives first: all that is shown."""

    async def talk() -> bytes:
        async with await opened(browser, browser.address) as connection:
            return await asyncio.wait_for(connection.recv(), 10)

    return asyncio.run(talk())


def set_in_page(browser: Browser, value: object, handle, is_done: Callable[[], bool]) -> bool:
    """Change a control in a page of the viewer's own; whether what it is to do was done in 5 s."""

    async def talk() -> bool:
        async with await opened(browser, browser.address) as connection:
            for message in (
                CAMERA,
                _messages.GuiUpdateMessage(handle._impl.uuid, {"value": value}),
            ):
                await connection.send(msgspec.msgpack.encode(message.as_serializable_dict([])))
            end = time.monotonic() + 5
            while not is_done() and time.monotonic() < end:
                await asyncio.sleep(0.01)
            return is_done()

    return asyncio.run(talk())


def eventually(is_so: Callable[[], bool]) -> bool:
    end = time.monotonic() + 5
    while not is_so() and time.monotonic() < end:
        time.sleep(0.01)
    return is_so()


def test_the_page_is_served(browser) -> None:
    assert browser.address.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(browser.address, timeout=10) as answer:  # noqa: S310
        assert answer.status == 200
        assert b"<html" in answer.read(2000).lower()


def test_it_listens_at_the_loopback_address_alone(browser) -> None:
    port = browser.server.get_port()
    listening = []
    with open("/proc/net/tcp") as four, open("/proc/net/tcp6") as six:
        for line in (*four.readlines()[1:], *six.readlines()[1:]):
            address, state = line.split()[1], line.split()[3]
            if state == "0A" and int(address.split(":")[1], 16) == port:
                listening.append(address.split(":")[0])
    assert listening == ["0100007F"]
    assert browser.is_of_this_machine


def test_pages_of_other_origins_and_programs_that_say_none_are_refused(browser) -> None:
    port = browser.server.get_port()
    for origin in (
        f"http://example.com:{port}", "null", None, f"http://127.0.0.1.example.com:{port}"
    ):  # fmt: skip
        with pytest.raises(InvalidStatus, match="403"):
            asyncio.run(opened(browser, origin))


def test_what_is_shown_reaches_the_page(browser, history) -> None:
    browser.say("look <b>3</b> {here}")
    browser.show(1)
    sent = first_message(browser)
    for name in (b"/relief", b"/reference", b"/camera", b"/next", b"/path"):
        assert name in sent
    assert history.setting.relief.points[:, :].tobytes() in sent
    assert b"look &lt;b&gt;3&lt;/b&gt; {here}" in sent


def test_a_look_is_drawn_where_it_was_taken(browser, history) -> None:
    browser.show(0)
    np.testing.assert_allclose(browser.camera.position, history.looks[0].camera[:3, 3])
    w, x, y, z = browser.camera.wxyz
    forward = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    np.testing.assert_allclose(forward, history.looks[0].camera[:3, 2], atol=1e-9)
    np.testing.assert_allclose(browser.next_camera.position, np.zeros(3), atol=1e-6)
    assert browser.next_camera.visible
    browser.show(2)
    assert not browser.next_camera.visible
    low, high, believed = browser.plots["tz"].data[1:4]
    series = history.series("tz")
    np.testing.assert_array_equal(believed, series.believed)
    np.testing.assert_array_equal(high - low, series.high - series.low)
    assert browser.images.image.shape[0] == history.setting.reference_image.shape[0]


def test_buttons_pressed_in_the_page_command_the_player(browser, player) -> None:
    for name in ("step", "run", "stop"):
        button = getattr(browser, f"{name}_button")
        assert set_in_page(browser, True, button, lambda name=name: player.heard[-1:] == [name])
    assert player.heard == ["step", "run", "stop"]


def test_the_slider_goes_to_a_look_and_is_no_command_where_it_follows(browser, player) -> None:
    browser.show(0)
    browser.show(2)
    assert browser.slider.value == 3
    assert player.heard == []
    assert set_in_page(browser, 2, browser.slider, lambda: player.heard == ["seek 1"])


def test_stop_can_always_be_pressed(browser) -> None:
    browser.allow(step=False, run=False)
    assert browser.step_button.disabled
    assert browser.run_button.disabled
    assert not browser.stop_button.disabled
    browser.allow(step=True, run=True)
    assert not browser.step_button.disabled


def test_the_relief_is_coloured_as_chosen(browser, history) -> None:
    browser.colour.value = "depth"
    assert eventually(
        lambda: np.array_equal(browser.points.colors, history.setting.relief.colours("depth"))
    )


def test_it_is_never_shared_through_a_tunnel(browser, monkeypatch) -> None:
    monkeypatch.setattr("viser._viser.ViserTunnel", None)
    assert browser.server.request_share_url() is None


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "example.com", "192.0.2.1"])  # noqa: S104
def test_hosts_that_are_not_one_address_of_this_machine_are_refused(history, host: str) -> None:
    with pytest.raises(InvalidInputError, match="--host"):
        Browser(history, host, 0)


def test_the_next_free_port_is_taken_and_wrong_ones_are_refused(history) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        browser = Browser(history, port=port)
        try:
            assert port < browser.server.get_port() < port + 50
        finally:
            browser.close()
    for port in (-1, 65536):
        with pytest.raises(InvalidInputError, match="--port"):
            Browser(history, port=port)
