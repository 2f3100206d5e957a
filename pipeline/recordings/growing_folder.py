"""A folder of recordings that grows by one recording at a time and is whole after each."""

from pathlib import Path

import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Folder, Recording, read_folder
from softslide.pipeline.recordings.manifest import LABELS, REQUIRED, check_manifest, write_manifest
from softslide.pipeline.recordings.slide_file import write_slide
from softslide.pipeline.recordings.truth import truth_path, write_truth
from softslide.pipeline.sensor import Sensor, read_sensor, write_sensor
from softslide.pipeline.staging import whole, writing


def open_growing(root: Path, sensor: Sensor | None) -> Folder:
    """The folder as it stands, to be gone on with; a new one, without recordings, where there is not one.

    sensor: of the new folder; None: the one that the folder names.

    Raises:
        InputError: the folder is of another sensor, is not a folder, or is new and no sensor is given.
    """
    root = Path(root)
    kept = root / "sensor.toml"
    known = read_sensor(kept) if kept.exists() else None
    if sensor is not None and known is not None and sensor != known:
        raise InputError(f"{kept}: another sensor than the one given; name a new folder, or that sensor")
    if (root / "manifest.csv").exists():
        return read_folder(root)
    sensor = known or sensor  # known of a run that ended before its first recording
    if sensor is None:
        raise InputError("give the sensor.toml of the new folder", "sensor")
    with writing(root):
        (root / "slides").mkdir(parents=True, exist_ok=True)
    with whole(kept) as scratch:
        write_sensor(scratch, sensor)
    columns = [name for name in (*REQUIRED, *LABELS) if name != "recording"]
    return Folder(root, sensor, pd.DataFrame(columns=columns, index=pd.Index([], name="recording")))


def add_recording(folder: Folder, recording: Recording, labels: dict[str, object]) -> Folder:
    """The folder with one more recording, written: its slide and truth first, each whole or not at all, then the
    manifest likewise.

    labels: `split` and any of the manifest's columns.

    Raises:
        InputError: a label that a manifest may not hold, or a name that the folder has already.
    """
    name = recording.name
    row = {"recording": name, "file": f"slides/{name}.parquet", **labels}
    path = folder.root / "manifest.csv"
    before = folder.manifest.reset_index().astype(object)
    table = pd.concat([before, pd.DataFrame([row], dtype=object)], ignore_index=True)
    manifest = check_manifest(table, folder.sensor, path)
    slide = folder.root / str(row["file"])
    with whole(slide) as scratch:
        write_slide(scratch, recording.time_s, recording.samples, folder.sensor.columns)
    if recording.truth is not None:
        with whole(truth_path(slide)) as scratch:
            write_truth(scratch, recording.truth)
    with whole(path) as scratch:
        write_manifest(scratch, manifest)
    return Folder(folder.root, folder.sensor, manifest)
