"""The progress bar of long work: on standard error, only where a person watches, with the time left."""

import sys
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm


def progress_bar(
    what: str, unit: str, items: Iterable[Any] | None = None, total: float | None = None, done: int = 0
) -> tqdm:
    """A bar to iterate over in place of `items`, or to update by hand and close.

    what: its title. unit: of one item; "B" counts bytes, shown as kB, MB, GB. total: items to come; of `items` their
    length, where they have one. done: items finished before.
    """
    return tqdm(
        items,
        desc=what,
        unit=unit,
        unit_scale=unit == "B",
        total=total,
        initial=done,
        file=sys.stderr,
        disable=not sys.stderr.isatty(),
    )
