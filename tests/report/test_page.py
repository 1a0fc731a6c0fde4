"""What every page is for whoever reads it: on a phone, in the dark, on paper, aloud."""

import re
from importlib.resources import files
from itertools import product

import pytest

from browser import (
    DESK,
    PHONE,
    SHEET,
    bottom_of,
    chromium,
    opened,
    printed,
    sticks_out,
    violations,
)
from html_page import Page, check_page
from page_samples import HOSTILE, PAGES
from servoscope.report.page import Section, Verdict, bullets, pairs, paragraph, write_page
from servoscope.report.table import Cell, Table

STYLE = files("servoscope.report").joinpath("templates/style.css").read_text()
SORTED = Table(["name", "size"], [["b", "2"], ["a", "10"]], "Sizes", align="lr", style="sortable")


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A page of each application, and one with what is hard to lay out."""
    folder = tmp_path_factory.mktemp("pages")
    drawn = {name: write(folder) for name, write in PAGES.items()}
    return {**drawn, "toolkit": toolkit_page(folder)}


def toolkit_page(folder):
    wide = Table([f"column {k}" for k in range(30)], [["x" * 12] * 30], "Wide", style="decision")
    parts = ["w" * 300, bullets(["w" * 300]), pairs({"Pairs": [("w" * 80, 0.123)]})]
    sections = [Section("Sorted", [SORTED], "sorted"), Section("w" * 100, [*parts, wide])]
    link = paragraph("See the table.")
    link = type(link)('<p><a href="#sorted">See the table</a></p>')
    verdict = Verdict("Yes, " + "w" * 100, "w" * 100, "yes")
    return write_page(
        folder / "toolkit.html", "w" * 90, verdict, [link, wide], sections, kind="x", lead="x"
    )


@pytest.mark.parametrize("name", [*PAGES, "toolkit"])
def test_a_page_can_be_read_by_anybody(pages, name):
    check_page(pages[name])


@pytest.mark.parametrize("name", PAGES)
def test_the_first_screen_is_a_verdict_a_table_and_a_picture(pages, name):
    tags = [tag for tag, _ in Page(pages[name]).tags]
    first = tags[: tags.index("details")]
    assert [first.count(tag) for tag in ("h1", "h2", "table", "img")] == [1, 1, 1, 1]


def test_hostile_names_are_text(pages):
    page = Page(pages["assessment"])
    assert "".join(page.text).count(HOSTILE) >= 3
    assert HOSTILE in "".join(Page(pages["rehearsal"]).text)


def test_everything_is_escaped(tmp_path):
    hostile = "a|b <i>&amp; 50 % \\cmd{x} $y_1$ #2 ~^"
    table = Table([hostile], [[Cell(hostile, mark="best", beside=hostile, below=hostile)]], hostile)
    parts = [hostile, paragraph(hostile, "quiet"), bullets([hostile]), table]
    sections = [Section(hostile, [*parts, pairs({hostile: [("x", 0.123)]})])]
    verdict = Verdict(hostile, hostile)
    path = write_page(
        tmp_path / "page.html", hostile, verdict, parts, sections, kind="test", lead=hostile
    )
    body = path.read_text().split("</style>")[1]
    assert "<i>" not in body
    assert "&amp; 50" not in body.replace("&amp;amp;", "")
    assert "0.12" in body


def luminance(colour):
    """Relative luminance of an sRGB colour, WCAG 2.2."""
    colour = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    shares = [int(colour[k : k + 2], 16) / 255 for k in (0, 2, 4)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_words_stand_out_by_day_and_by_night():
    day, night = (
        dict(re.findall(r"--(\w+): (#\w+)", block))
        for block in re.findall(r":root \{(.*?)\}", STYLE)
    )
    for theme in (day, day | night):
        for words, ground in product(("ink", "quiet", "accent", "good"), ("paper", "wash")):
            a, b = sorted((luminance(theme[words]), luminance(theme[ground])))
            assert (b + 0.05) / (a + 0.05) >= 4.5, (words, ground)
    used = re.findall(r"[a-z-]*color: ([^;}]+)", STYLE.split("\n", 1)[1].replace(":root", ""))
    assert {colour for colour in used if not colour.startswith("var(")} == {"inherit"}


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened_browser:
        yield opened_browser


@pytest.mark.parametrize("name", [*PAGES, "toolkit"])
def test_nothing_sticks_out_of_a_phone(browser, pages, name):
    with opened(browser, pages[name], PHONE) as tab:
        assert sticks_out(tab) <= 0
        for summary in tab.locator("summary").all():
            summary.click()
        assert tab.locator("details[open]").count() == tab.locator("details").count()
        assert sticks_out(tab) <= 0


@pytest.mark.parametrize("name", PAGES)
def test_the_decision_is_on_the_first_screen_and_the_first_sheet(browser, pages, name):
    with opened(browser, pages[name], DESK) as tab:
        assert bottom_of(tab, ".verdict") < DESK["height"] / 2
        assert tab.locator(".first img").bounding_box()["y"] < DESK["height"] / 2
        tab.set_viewport_size(PHONE)
        assert bottom_of(tab, ".verdict") < PHONE["height"]
        tab.emulate_media(media="print")
        tab.set_viewport_size(SHEET)
        assert bottom_of(tab, "#verdict") < SHEET["height"]
        assert sticks_out(tab) <= 0


@pytest.mark.parametrize("name", PAGES)
def test_paper_shows_what_is_folded_away(browser, pages, name):
    with opened(browser, pages[name]) as tab:
        last = tab.locator("details").last.locator("td").last
        assert not last.is_visible()
        tab.emulate_media(media="print")
        assert last.is_visible()
        assert tab.locator("details img").first.bounding_box()["height"] < SHEET["height"] / 2


@pytest.mark.parametrize("name", PAGES)
def test_sheets_are_few_and_full_and_the_first_has_the_verdict(browser, pages, name):
    with opened(browser, pages[name]) as tab:
        verdict = tab.locator(".verdict h2").inner_text()
        texts, used = printed(tab)
        assert verdict.split()[0] in texts[0]
        assert "Next:" in texts[0]
        assert len(used) <= 4
        assert min(used[:-1], default=1.0) > 0.6


@pytest.mark.parametrize(
    ("name", "scheme"), [("assessment", "dark"), *((name, "light") for name in (*PAGES, "toolkit"))]
)
def test_axe_finds_nothing(browser, pages, name, scheme):
    with opened(browser, pages[name], PHONE, color_scheme=scheme) as tab:
        for summary in tab.locator("summary").all():
            summary.click()
        assert violations(tab) == {}


def test_an_appendix_is_printed_only_if_it_is_open(browser, tmp_path):
    sections = [Section("Body", ["inside"]), Section("More", ["beyond"], is_appendix=True)]
    path = tmp_path / "page.html"
    write_page(path, "x", Verdict("Yes", "go"), [SORTED], sections, kind="x", lead="x")
    with opened(browser, path) as tab:
        ((folded,), _) = printed(tab)
        assert "inside" in folded
        assert "beyond" not in folded
        assert "unfold it to print it" in folded
        tab.locator("summary", has_text="More").click()
        ((unfolded,), _) = printed(tab)
        assert "beyond" in unfolded
        assert "unfold" not in unfolded


def test_the_dark_has_a_dark_ground_and_light_cards(browser, pages):
    with opened(browser, pages["assessment"], color_scheme="dark") as tab:
        ground = "selector => getComputedStyle(document.querySelector(selector)).backgroundColor"
        assert tab.evaluate(ground, "html") == "rgb(20, 25, 30)"
        assert tab.evaluate(ground, "figure img") == "rgb(255, 255, 255)"
        tab.emulate_media(media="print")
        assert tab.evaluate(ground, "html") == "rgb(255, 255, 255)"


def test_the_keyboard_skips_unfolds_and_sorts(browser, pages):
    with opened(browser, pages["toolkit"]) as tab:
        tab.keyboard.press("Tab")
        assert tab.locator(":focus").inner_text() == "Skip to the verdict"
        tab.keyboard.press("Enter")
        assert tab.evaluate("document.activeElement.id") == "verdict"
        tab.locator("a", has_text="See the table").focus()
        tab.keyboard.press("Enter")
        button = tab.locator("#sorted button", has_text="size")
        button.focus()
        width = "element => parseFloat(getComputedStyle(element).outlineWidth)"
        assert button.evaluate(width) >= 2
        for key, order, first in (("Enter", "descending", "a"), (" ", "ascending", "b")):
            tab.keyboard.press(key)
            assert tab.locator("#sorted th[aria-sort]").get_attribute("aria-sort") == order
            assert tab.locator("#sorted tbody th").first.inner_text() == first


def test_without_scripts_everything_can_be_read(browser, pages):
    with opened(browser, pages["toolkit"], java_script_enabled=False) as tab:
        tab.locator("summary").first.click()
        assert tab.locator("#sorted td").first.is_visible()
