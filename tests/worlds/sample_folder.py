"""Some slides of the sample as a folder of their own."""

from pathlib import Path

import pandas as pd

from softslide.pipeline.recordings.folder import SAMPLE


def sample_folder(root: Path, rows: str) -> Path:
    """rows: of the manifest, as `DataFrame.query` takes them. The slides themselves are links."""
    root.mkdir(parents=True, exist_ok=True)
    for place in ("sensor.toml", "slides"):
        (root / place).symlink_to(SAMPLE / place)
    pd.read_csv(SAMPLE / "manifest.csv").query(rows).to_csv(root / "manifest.csv", index=False)
    return root
