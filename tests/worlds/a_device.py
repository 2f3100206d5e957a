"""What a device has: a bundle, and one sample recording as Parquet and as CSV."""

from pathlib import Path

import pandas as pd
from small_bundle import write_small_bundle

from softslide.pipeline.recordings.folder import SAMPLE, read_folder


def write_device(root: Path) -> Path:
    """The folders `bundle`, and the files `slide.csv` and `slide.parquet` of the sample's fastest slide."""
    folder = read_folder(SAMPLE)
    write_small_bundle(root / "bundle", folder.sensor)
    fastest = folder.load(str(folder.manifest["speed_mm_s"].idxmax()))
    table = pd.DataFrame(fastest.volts, columns=list(folder.sensor.channels))
    table.insert(0, "time_s", fastest.time_s)
    table.to_csv(root / "slide.csv", index=False)
    table.to_parquet(root / "slide.parquet")
    return root
