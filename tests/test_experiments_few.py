"""From how few recordings: the figures are of the test slides, and recordings help."""

from pathlib import Path

import pytest

from experiments.studies import few_recordings as few
from experiments.studies import sensor_drift as injection
from pipeline.atlas.library import atlas_of
from pipeline.recordings.folder import Folder, read_folder

SAMPLE = Path(__file__).parents[1] / "pipeline" / "sample"


def test_twelve_recordings_are_better_than_none():
    folder = read_folder(SAMPLE)
    manifest = folder.manifest
    scored = manifest.index[manifest["split"] == "test"][:4]
    taught = manifest.index[manifest["split"].str.startswith("calibration")]
    some = Folder(folder.root, folder.sensor, manifest.loc[[*taught, *scored]])
    none, twelve = few.study(some, [0, 12], 1, ["test"], atlas_of(folder.sensor))
    assert (none["slides"], twelve["slides"]) == (0, 12)
    assert twelve["offset_mm_mean"] < none["offset_mm_mean"] < 2.0
    assert twelve["speed_percent_mean"] < 3.0
    assert twelve["direction_deg_max"] < 6.0


@pytest.mark.parametrize(
    ("command", "line", "said"),
    [
        (few, ["--recordings", "nowhere"], "nowhere"),
        (few, ["--recordings", str(SAMPLE), "--draws", "0"], "in 0 draws"),
        (few, ["--recordings", str(SAMPLE), "--split", "holiday"], "holiday"),
        (injection, ["--model", "nowhere", "--recordings", str(SAMPLE)], "nowhere"),
        (injection, ["--model", "nowhere", "--recordings", str(SAMPLE), "--every", "0"], "--every 0"),
    ],
)
def test_bad_input_is_one_line(command, line, said, capsys):
    assert command.main(line) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith(command.__name__.rpartition(".")[2])
    assert said in last
