"""The progress of long work on standard error, with the time left: a bar on a terminal, else a line now and then."""

import sys
import time
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm

LINE_S = 10.0  # between two lines where no person watches


class _Lines:
    """Standard error, a line for a bar, LINE_S after the last one at the earliest."""

    def __init__(self) -> None:
        self._last_s = time.monotonic()

    def write(self, text: str) -> None:
        bar = text.strip("\r\n ")
        if bar and time.monotonic() >= self._last_s + LINE_S:
            self._last_s = time.monotonic()
            sys.stderr.write(f"{bar}\n")

    def flush(self) -> None:
        sys.stderr.flush()


def progress_bar(
    what: str, unit: str, items: Iterable[Any] | None = None, total: float | None = None
) -> tqdm:
    """A bar to iterate over in place of `items`, or to update by hand and close.

    what: its title. unit: of one item; "B" counts bytes, shown as kB, MB, GB. total: items to come; of `items` their
    length, where they have one. What takes less than LINE_S writes no line.
    """
    watched = sys.stderr.isatty()
    return tqdm(
        items,
        desc=what,
        unit=unit,
        unit_scale=unit == "B",
        total=total,
        file=sys.stderr if watched else _Lines(),
        ncols=None if watched else 100,
        ascii=None if watched else True,
    )
