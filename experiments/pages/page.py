"""Renders a page: one HTML file that opens anywhere, without a network."""

import re
from collections.abc import Sequence
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from softslide.experiments.pages.figures import Panel

LEAST_LISTED = 4  # sections of a page that begins with a list of them
HERE = Path(__file__).parent
# Verdicts that pages colour, with the class of the colour.
VERDICTS = {
    **dict.fromkeys(("met", "holds", "smaller"), "met"),
    **dict.fromkeys(("missed", "does not hold", "larger"), "missed"),
    **dict.fromkeys(("not tested", "in part", "too few"), "untested"),
}
# What `origin` of a sensor.toml means.
ORIGINS = {
    "measured": ("Measured recordings", "of a real skin."),
    "emulated": (
        "Emulated bench recordings",
        "never measured on hardware: what these figures say about a real sensor is not known.",
    ),
    "assembled": (
        "Assembled slides",
        "each sample is a press that was measured on a real skin; the motion is made by walking from press to press. "
        "Friction, lag and the time course of a contact are not in them.",
    ),
    "synthetic": (
        "Synthetic recordings",
        "of the project's own simulator: what these figures say about a real sensor is not known.",
    ),
    "": (
        "Origin not said",
        'sensor.toml does not say whether these recordings are measured, emulated or synthetic (origin = "..."). Take '
        "no figure here for a measurement on hardware.",
    ),
}


def render(template: Path, **values: Any) -> str:
    """The page of a template, which extends `page.html.j2`."""
    page = _environment(template.parent).get_template(template.name)
    return with_contents(page.render(origins=ORIGINS, **values))


@cache
def _environment(folder: Path) -> Environment:
    environment = Environment(
        loader=FileSystemLoader([folder, HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "words": _words, "percent": percent}
    environment.filters["verdict"] = lambda word: VERDICTS.get(word, "")
    return environment


def with_contents(page: str) -> str:
    """The page with a list of its sections before the first, where there are several."""
    titles = re.findall(r"<h2>(.*?)</h2>", page)
    if len(titles) < LEAST_LISTED:
        return page
    items = "".join(f'<li><a href="#section-{n}">{title}</a></li>' for n, title in enumerate(titles))
    numbers = count()
    named = re.sub("<h2>", lambda _: f'<h2 id="section-{next(numbers)}">', page)
    return named.replace('<h2 id="section-0">', f'<nav><ul>{items}</ul></nav>\n<h2 id="section-0">', 1)


def panels_page(title: str, lines: Sequence[str], groups: Sequence[tuple[str, Sequence[Panel]]]) -> str:
    """A page of some paragraphs and named groups of figures."""
    return render(HERE / "panels.html.j2", title=title, lines=lines, groups=groups)


def number(value: float | None, digits: int = 3) -> str:
    """A number to so many significant digits; a dash without one."""
    if value is None or value != value:
        return "–"
    return f"{value:#.{digits}g}".rstrip(".") if abs(value) < 10**digits else f"{value:,.0f}"


def _words(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def percent(share: float | None) -> str:
    """A share in percent; a dash without one."""
    return "–" if share is None or share != share else f"{100 * share:.0f} %"
