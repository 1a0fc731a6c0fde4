"""After the site is built: every link in it leads somewhere, and no page asks another site."""

from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.util import logging

logger = logging.getLogger(__name__)


class Page(HTMLParser):
    """What a page links to, what it loads, and where it can be linked to."""

    def __init__(self, path):
        super().__init__()
        self.links, self.loaded, self.anchors = [], [], set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.anchors |= {found[key] for key in ("id", "name") if found.get(key)}
        if tag == "a" and "href" in found:
            self.links.append(found["href"])
        elif tag == "link" and found.get("rel") not in ("canonical", "search"):
            self.loaded.append(found.get("href") or "")
        elif tag in ("img", "script", "iframe", "source"):
            self.loaded += [found[key] for key in ("src",) if found.get(key)]
            self.loaded += [
                part.split()[0] for part in (found.get("srcset") or "").split(",") if part
            ]


def broken(root):
    """What leads nowhere in the pages of a folder, a line each."""
    read = cache(Page)
    for path in sorted(root.rglob("*.html")):
        if "_static" in path.parts:
            continue
        page = read(path)
        for address in (*page.links, *page.loaded):
            parts = urlsplit(address)
            where = path.relative_to(root)
            if parts.scheme or parts.netloc:
                if address in page.loaded and parts.scheme != "data":
                    yield f"{where}: loads {address}"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                yield f"{where}: there is no {address}"
            elif parts.fragment and unquote(parts.fragment) not in read(target).anchors:
                yield f"{where}: there is no place {address}"


def check(app, exception):
    if exception is None and app.builder.name == "html":
        for line in broken(Path(app.outdir)):
            logger.warning(line)


def setup(app):
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
