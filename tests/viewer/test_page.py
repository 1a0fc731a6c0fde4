"""The page in a browser: it asks for nothing elsewhere, fits a phone, and its Stop stops."""

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from browser import DESK, PHONE, chromium, sticks_out
from planar_cell import Stoppable
from servoscope import acquire_from
from servoscope.errors import AcquisitionStoppedError
from servoscope.viewer.acquisition import LiveAcquisition

pytest.importorskip("viser")
from servoscope.viewer.browser import Browser


class Acquisition(threading.Thread):
    """An acquisition that waits for the buttons of its page."""

    def __init__(self, folder) -> None:
        super().__init__(daemon=True)
        self.folder, self.robot, self.end = folder, Stoppable(np.zeros(6), noise=1.0), ""
        self.browser: Browser | None = None
        self.live = LiveAcquisition(self.robot, self.opened)
        self.is_open = threading.Event()

    def opened(self, history) -> Browser:
        self.browser = Browser(history, port=0)
        self.is_open.set()
        return self.browser

    def run(self) -> None:
        try:
            acquire_from(
                self.live.robot, self.robot, self.folder, confirm=self.live.confirm,
                on_shot=self.live.on_shot, n_images=30, translation_mm=10, rotation_deg=4,
                n_reference_images=2, settle_s=0.2,
            )  # fmt: skip
        except AcquisitionStoppedError as error:
            self.end = str(error)
            self.live.finish(self.end)


def eventually(is_so: Callable[[], bool], seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while not is_so() and time.monotonic() < end:
        time.sleep(0.02)
    return is_so()


def test_an_acquisition_is_seen_stepped_and_stopped_in_a_browser(tmp_path) -> None:
    with chromium() as driver:
        work = Acquisition(tmp_path / "part")
        work.start()
        assert work.is_open.wait(20)
        page = work.browser
        alone = threading.Event()
        page.on_alone = alone.set
        tab = driver.new_page(viewport=DESK)
        wrong, asked = [], []
        tab.on("pageerror", lambda error: wrong.append(str(error)))
        tab.on("console", lambda said: said.type == "error" and wrong.append(said.location["url"]))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(page.address)
        buttons = {
            name: tab.get_by_role("button", name=name, exact=True)
            for name in ("Step", "Run", "Stop")
        }
        for button in buttons.values():
            button.wait_for()
        assert tab.get_by_text("30 images, ").is_visible()
        assert tab.get_by_text("The robot waits: press Step or Run.").is_visible()
        assert not work.robot.is_moving.is_set()

        buttons["Step"].click()
        tab.get_by_text("1 of 30 images are on disk").wait_for()
        tab.get_by_text("The robot waits: press Step or Run.").wait_for()
        n_poses = len(work.robot.poses)

        work.robot.seconds = 60.0
        work.robot.is_moving.clear()
        buttons["Run"].click()
        assert work.robot.is_moving.wait(20)
        buttons["Stop"].click()
        assert eventually(lambda: work.robot.stops > 0)
        work.join(20)
        assert "1 of 30 images are on disk; the same command goes on from there." in work.end
        assert len(work.robot.poses) == n_poses
        tab.get_by_text("the same command goes on from there.").wait_for()
        assert buttons["Run"].is_disabled()
        assert buttons["Stop"].is_enabled()

        tab.set_viewport_size(PHONE)
        assert sticks_out(tab) <= 0
        box = buttons["Stop"].bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= PHONE["width"]
        assert box["y"] + box["height"] <= PHONE["height"]
        own = (page.address, page.address.replace("http", "ws"), "data:", f"blob:{page.address}")
        assert [url for url in asked if not url.startswith(own)] == []
        # viser frees a picture before the browser has it, which says so.
        assert [what for what in wrong if not what.startswith(f"blob:{page.address}")] == []

        assert not alone.is_set()
        tab.close()
        assert alone.wait(20)
        page.close()
