"""A headless Chromium, where there is one."""

import shutil
from contextlib import contextmanager

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
PHONE = {"width": 390, "height": 844}
DESK = {"width": 1280, "height": 800}
SHEET = {"width": 687, "height": 1017}
"""What is left of A4 within margins of 14 mm, at 96 px an inch."""


@contextmanager
def chromium():
    """A browser; the test is skipped where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        pytest.skip(f"no browser on the path, such as {NAMES[0]}")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def opened(browser, path, viewport=DESK, **options):
    """A page in a tab; fails if it wrote to the console, threw, or asked for anything."""
    tab = browser.new_page(viewport=viewport, **options)
    said, asked = [], []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(path.as_uri())
    yield tab
    tab.close()
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]


def sticks_out(tab):
    """By how many px a page is wider than its window."""
    return tab.evaluate("document.documentElement.scrollWidth - window.innerWidth")


def bottom_of(tab, selector):
    """How far down something ends, [px]."""
    box = tab.locator(selector).bounding_box()
    return box["y"] + box["height"]


def printed(tab):
    """What a page is on paper: the text of each sheet, and the share of it that is used."""
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 is not installed")
    sheets = pdfium.PdfDocument(tab.pdf(format="A4", prefer_css_page_size=True))
    texts = [sheet.get_textpage().get_text_bounded() for sheet in sheets]
    used = []
    for sheet in sheets:
        grey = np.asarray(sheet.render(scale=0.5).to_pil().convert("L"))
        inked = np.flatnonzero((grey < 200).any(axis=1))
        used.append((inked[-1] + 1) / len(grey) if inked.size else 0.0)
    return texts, used


def violations(tab):
    """The rules of axe-core that a page breaks, and where."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not there")
    found = axe.Axe().run(tab).response["violations"]
    return {rule["id"]: [node["html"][:120] for node in rule["nodes"]] for rule in found}
