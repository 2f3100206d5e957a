"""Estimates of recordings that are sent to the page, in the page's own process."""

import tempfile
from pathlib import Path
from typing import Any

from softslide.features.errors import InputError

# A recording as CSV: half an hour at 1 kHz of one accelerometer.
MOST_BYTES = 1 << 26


def answer(bundle: Path, height_mm: float | None, unsigned: bool, recording: bytes) -> dict[str, Any]:
    """What `softslide predict` says of a recording in CSV, but for its name.

    Raises:
        InputError: it is not a recording, or not of this bundle's sensor; or the bundle is refused by now.
    """
    # A page that nobody asks this needs no ONNX Runtime.
    from softslide.serve.predict import predict

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.csv"
        path.write_bytes(recording)
        try:
            (estimate,) = predict(bundle, [path], height_mm=height_mm, unsigned=unsigned)
        except InputError as error:
            raise InputError(str(error).replace(f"{path}", "recording")) from None
    return {name: value for name, value in estimate.items() if name not in ("recording", "file")}
