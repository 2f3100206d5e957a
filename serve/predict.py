"""Estimates of recorded files: `softslide predict`."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from softslide.features.errors import InputError
from softslide.serve.files import read_for
from softslide.serve.localizer import Localizer
from softslide.serve.records import record
from softslide.serve.whole_contacts import whole_contacts


def predict(
    model: str | Path,
    files: str | Path | Sequence[str | Path],
    track: bool = False,
    refused: Callable[[InputError], None] | None = None,
    height_mm: float | None = None,
    whole_contact: bool = False,
    unsigned: bool = False,
) -> Iterator[dict[str, Any]]:
    """The estimate at the end of each recording, or of the one, ready for JSON; None: not estimated.

    track: every estimate, one a block. whole_contact: the same, but each moment's from its whole contact, what comes
    after it included (`whole_contacts`). refused: is called with why a file could not be read, and the others go on;
    None: the first ends it. height_mm: the skin's, for a bundle over heights; None: as the static output shows it.
    unsigned: also a bundle whose card carries no hash of itself.

    Raises:
        InputError: the bundle or a file is missing, damaged, or of another format, or the bundle knows no whole
            contacts.
    """
    opened = localizer = Localizer.load(model, height_mm, unsigned)
    for path in map(Path, [files] if isinstance(files, str | Path) else files):
        try:
            volts, rate_hz = read_for(path, opened.card)
        except InputError as error:
            if refused is None:
                raise
            refused(error)
            continue
        if rate_hz != localizer.card.sample_rate_hz:
            localizer = opened.at_rate(rate_hz)
        localizer.reset()
        if whole_contact:
            estimates = whole_contacts(localizer, volts)
        elif track:
            estimates = localizer.push(volts)
        else:
            localizer.feed(volts)
            estimates = [localizer.read()]
        for estimate in estimates:
            yield {"recording": path.stem, "file": str(path), **record(estimate)}
