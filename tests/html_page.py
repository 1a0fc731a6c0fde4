"""A page as its tags and text, and what every page has to be for whoever reads it, and however."""

import re
from collections import Counter
from html.parser import HTMLParser
from itertools import pairwise

VOID = {"meta", "img", "br", "link", "input", "hr"}
MOST_BYTES = 5_000_000


class Page(HTMLParser):
    """Tags with their attributes, and the text; fails on tags that do not nest."""

    def __init__(self, path):
        super().__init__()
        self.tags, self.open, self.text = [], [], []
        self.folder = path.parent
        self.source = path.read_text(encoding="utf-8")
        self.feed(self.source)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


def check_page(path):
    """That a page asks for nothing, is small, folded, and can be followed without seeing it."""
    page = Page(path)
    asks_for_nothing(page)
    is_in_order(page)
    is_read_aloud(page)
    assert len(page.source.encode()) < MOST_BYTES
    folds = page.all("details")
    assert folds
    assert not any("open" in fold for fold in folds)
    assert len(page.all("summary")) == len(folds)
    assert len(page.all("script")) == 1
    return page


def asks_for_nothing(page):
    for tag, attributes in page.tags:
        for name in ("src", "href", "srcset", "action", "data", "poster"):
            if name in attributes:
                at = attributes[name]
                within = at.startswith(("data:image/png;base64,", "#"))
                assert within or (tag == "a" and (page.folder / at).is_file()), tag
        assert not any(name.startswith("on") or name == "style" for name in attributes)
    text = re.sub(r"base64,[\w+/=]+", "", page.source)
    assert not re.search(r"https?://|url\(|@import|fetch\(|XMLHttp", text)


def is_in_order(page):
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))
    ids = Counter(attributes["id"] for _, attributes in page.tags if "id" in attributes)
    assert set(ids.values()) == {1}
    within = (link["href"] for link in page.all("a") if link["href"].startswith("#"))
    assert {place[1:] for place in within} <= ids.keys()
    body = [tag for tag, _ in page.tags]
    first = body[body.index("body") + 1 :]
    assert first[0] == "a"  # skips to the verdict
    assert Counter(first)["main"] == Counter(first)["header"] == 1


def is_read_aloud(page):
    assert page.all("html") == [{"lang": "en"}]
    assert all(image["alt"].strip() for image in page.all("img"))
    assert len(page.all("caption")) == len(page.all("table")) > 0
    assert {head.get("scope") for head in page.all("th")} <= {"col", "row"}
    for region in (div for div in page.all("div") if "scroll" in div.get("class", "").split()):
        assert region["role"] == "group"
        assert region["aria-label"].strip()
        assert region["tabindex"] == "0"
