"""From how few recordings: the figures are of the test slides, and recordings help."""

from pathlib import Path

from experiments.few import study
from pipeline.atlas_library import atlas_of
from pipeline.recordings import Folder, read_folder

SAMPLE = Path(__file__).parents[1] / "pipeline" / "sample"


def test_twelve_recordings_are_better_than_none():
    folder = read_folder(SAMPLE)
    manifest = folder.manifest
    scored = manifest.index[manifest["split"] == "test"][:4]
    taught = manifest.index[manifest["split"].str.startswith("calibration")]
    some = Folder(folder.root, folder.sensor, manifest.loc[[*taught, *scored]])
    none, twelve = study(some, [0, 12], 1, ["test"], atlas_of(folder.sensor))
    assert (none["slides"], twelve["slides"]) == (0, 12)
    assert twelve["offset_mm_mean"] < none["offset_mm_mean"] < 2.0
    assert twelve["speed_percent_mean"] < 3.0
    assert twelve["direction_deg_max"] < 6.0
