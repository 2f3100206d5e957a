"""Estimates of recorded files: `softslide predict`."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from serve.files import read_recording
from serve.localizer import Localizer
from serve.records import record


def predict(bundle: Path, paths: Sequence[Path], track: bool = False) -> Iterator[dict[str, Any]]:
    """The estimate at the end of each recording, ready for JSON; None: not estimated.

    track: every estimate, one a block.

    Raises:
        InputError: the bundle or a file is missing, damaged, or of another format.
    """
    localizer = Localizer.load(bundle)
    card = localizer.card
    for path in paths:
        volts = read_recording(path, card.channels, card.sample_rate_hz)
        localizer.reset()
        name = {"recording": path.stem, "file": str(path)}
        if track:
            yield from ({**name, **record(estimate)} for estimate in localizer.push(volts))
        else:
            localizer.feed(volts)
            yield {**name, **record(localizer.read())}
