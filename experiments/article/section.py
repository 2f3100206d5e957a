"""What the page holds of one of the article's figures: panels, a text, and the numbers."""

from dataclasses import dataclass, field

import pandas as pd

from softslide.experiments.pages.figures import Panel


@dataclass(frozen=True)
class Section:
    """figures: the article's numbers, "17" or "9 and 11". article: what it shows and says; here: what is found here.

    table: the numbers, written as `file`.csv, if any. missing: what cannot be made, and why.
    """

    figures: str
    title: str
    article: str
    here: str = ""
    panels: tuple[Panel, ...] = ()
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    missing: str = ""

    @property
    def file(self) -> str:
        """The CSV's name."""
        first, *_ = self.figures.split()
        return f"figure-{int(first):02d}.csv"
