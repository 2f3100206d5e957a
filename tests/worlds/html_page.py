"""A page as a browser would read it, without a network."""

import re
from html.parser import HTMLParser
from pathlib import Path


class Page(HTMLParser):
    """What a page holds: its text, and all that it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.words = ""
        self.alts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "br"):
            self.open.append(tag)
        loading = ("src", "href", "xlink:href", "srcset", "data")
        self.loads += [value or "" for name, value in attrs if name in loading]
        assert tag not in ("script", "link", "iframe", "img", "image", "foreignobject")
        if tag == "svg":
            named = dict(attrs)
            assert named["role"] == "img"
            self.alts.append(named["aria-label"] or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_data(self, data: str) -> None:
        self.words += data


def self_contained(path: Path) -> Page:
    """The page, once it is seen that it loads nothing: a figure refers to its own clipping path alone."""
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert all(source.startswith("#") for source in page.loads)
    assert not re.search(r"url\((?!#)|@import|https?://", text)
    return page
