"""The picture of ``servoscope view``: a run beside the relief of the part, in a headless Chromium.

``python -m benchmarks.view_picture docs/images/view.png [--model FOLDER]``
"""

from __future__ import annotations

import argparse
import io
import shutil
import tempfile
import threading
from pathlib import Path

from PIL import Image

from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.commands.cells import CellOptions, LoopOptions
from servoscope.positioning import Positioner, PositioningModel
from servoscope.positioning.training import train
from servoscope.viewer.browser import Browser
from servoscope.viewer.history import History, Setting
from servoscope.viewer.live import LiveRun

CONDITION = "covered_10"
N_STEPS = 1
SIZE = {"width": 1200, "height": 760}
SOFTWARE = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""A browser that draws without a graphics card."""


def trained(n_jobs: int = -1) -> PositioningModel:
    """A model of the simulated cylinder head, of 40 images."""
    with tempfile.TemporaryDirectory() as folder:
        data = acquire(Path(folder) / "cell", AcquisitionConfig(schedule=((40, 1.6),)))
        return train(data, n_jobs=n_jobs)


def draw(model: PositioningModel) -> bytes:
    """The page after some steps as PNG."""
    settings = LoopOptions().settings(model)
    with CellOptions(condition=CONDITION).opened(model, settings) as cell:
        browser = Browser(History(Setting.of_estimator(model)), port=0)
        run = LiveRun(
            Positioner(model, cell.settings), cell.robot, cell.camera, browser.history,
            browser.show, browser.say,
        )  # fmt: skip
        browser.command(run)
        thread = threading.Thread(target=run.until_end)
        thread.start()
        try:
            return _pictured(browser)
        finally:
            run.stop()
            thread.join()
            browser.close()


def _pictured(browser: Browser) -> bytes:
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, args=[*SOFTWARE])
        tab = chromium.new_page(viewport=SIZE)
        tab.goto(browser.address)
        step = tab.get_by_role("button", name="Step", exact=True)
        for k in range(N_STEPS + 1):
            while len(browser.history.looks) <= k:
                tab.wait_for_timeout(100)
            tab.get_by_text("The robot waits").wait_for()
            if k < N_STEPS:
                step.click()
        notice = tab.locator(".mantine-Notification-closeButton")
        if notice.count():
            notice.first.click()
        tab.mouse.move(400, 600)
        tab.wait_for_timeout(3000)
        picture = tab.screenshot()
        chromium.close()
    out = io.BytesIO()
    Image.open(io.BytesIO(picture)).convert("RGB").save(out, "PNG", optimize=True)
    return out.getvalue()


def main() -> None:
    """Draw the picture and say how big it is."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.view_picture", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--model", type=Path, help="a model of the simulated part; else a new one")
    options = parser.parse_args()
    model = trained() if options.model is None else PositioningModel.load(options.model)
    options.out.write_bytes(draw(model))
    print(f"{options.out}: {options.out.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
