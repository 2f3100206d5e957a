"""Each kind of file, read as the program reads it: what wrong input is tried on."""

from pathlib import Path

from softslide.pipeline.recordings.folder import SAMPLE
from softslide.pipeline.recordings.manifest import check_manifest, read_table
from softslide.pipeline.recordings.slide_file import read_slide
from softslide.pipeline.sensor import read_sensor
from softslide.serve.files import read_recording

CHANNELS = ("a0_vx", "a0_vy", "a0_vz")


def manifest(path: Path) -> None:
    check_manifest(read_table(path), read_sensor(SAMPLE / "sensor.toml"), path)


def slide(path: Path) -> None:
    read_slide(path, CHANNELS)


def recording(path: Path) -> None:
    read_recording(path, CHANNELS, 1000.0)
