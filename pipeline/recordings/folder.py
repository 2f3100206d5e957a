"""A folder of recordings: `sensor.toml`, `manifest.csv`, `slides/`. Read, validated, written.

Rows in messages are counted from 1 and leave the header out, in tables and in slides alike.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.features.base_motion import BaseMotion
from softslide.features.clock import check_clock
from softslide.features.errors import InputError
from softslide.pipeline.recordings.manifest import check_manifest, read_table, write_manifest
from softslide.pipeline.recordings.slide_file import read_slide, write_slide
from softslide.pipeline.recordings.truth import read_truth, truth_path, write_truth
from softslide.pipeline.sensor import Sensor, read_sensor, write_sensor
from softslide.pipeline.staging import staged

# 60 emulated bench recordings that ship with the project; see the README next to them.
SAMPLE = Path(__file__).parents[1] / "sample"


@dataclass(frozen=True)
class Recording:
    """One slide's samples in float64: time_s (n,) s, volts (n, channels) V in `Sensor.channels` order.

    truth: what was so at each moment, as `pipeline.recordings.truth` says; None where the lab did not give it.
    base_v: (n, 3) V of the sensor's base; None where it has none, or after `without`.
    """

    name: str
    time_s: np.ndarray
    volts: np.ndarray
    truth: pd.DataFrame | None = None
    base_v: np.ndarray | None = None

    @property
    def samples(self) -> np.ndarray:
        """All that was recorded, in `Sensor.columns` order, V."""
        return self.volts if self.base_v is None else np.hstack([self.volts, self.base_v])

    def without(self, motion: BaseMotion, place: Path | str) -> "Recording":
        """The recording with the base's motion taken out of its volts. place: opens an error's message.

        Raises:
            InputError: it has no base, or leans over too far.
        """
        if self.base_v is None:
            raise InputError(f"{place}: holds nothing of a base whose motion could be taken out")
        volts, upright = motion.without(self.volts, self.base_v)
        if not upright.all():
            raise InputError(
                f"{place}: from {self.time_s[~upright.all(axis=1)][0]:g} s on the base leans over further than a "
                "contact can be separated from; leave it out"
            )
        return replace(self, volts=volts, base_v=None)


@dataclass(frozen=True)
class Folder:
    """A folder whose sensor and manifest are valid; a slide's samples are validated when it is loaded.

    manifest: one row a recording, indexed by its name, with `file`, `split` and every label as a column;
    a label that the lab did not give is NaN. base_motion: what `load` takes out of every recording; None: nothing.
    """

    root: Path
    sensor: Sensor
    manifest: pd.DataFrame
    base_motion: BaseMotion | None = None

    def __len__(self) -> int:
        return len(self.manifest)

    def load(self, recording: str) -> Recording:
        """One recording as a model learns from it: without the motion of the sensor's base, where that is known.

        Raises:
            InputError: as `read`, or the base leans over too far.
        """
        read = self.read(recording)
        if self.base_motion is None:
            return read
        return read.without(self.base_motion, self.root / str(self.manifest.at[recording, "file"]))

    def read(self, recording: str) -> Recording:
        """One recording as it was recorded, and its truth if any; held against the sensor's rate and the moments of
        motion.

        Raises:
            InputError: no such recording, a broken file, or samples that do not fit the sensor or the manifest.
        """
        if recording not in self.manifest.index:
            raise InputError(f"{self.root}: the manifest lists no recording '{recording}'; name one it lists")
        row = self.manifest.loc[recording]
        path = self.root / row["file"]
        time_s, samples = read_slide(path, self.sensor.columns)
        check_clock(path, time_s, self.sensor.sample_rate_hz)
        step = 1 / self.sensor.sample_rate_hz
        for label in ("motion_start_s", "motion_end_s"):
            if row[label] < time_s[0] - step or row[label] > time_s[-1] + step:
                raise InputError(
                    f"{self.root / 'manifest.csv'}: {recording}, {label} = {row[label]:g} lies outside the "
                    f"recording ({time_s[0]:g} to {time_s[-1]:g} s); correct it or leave it empty"
                )
        truth = truth_path(path)
        table = read_truth(truth) if truth.is_file() else None
        volts, base_v = np.split(samples, [len(self.sensor.channels)], axis=1)
        return Recording(recording, time_s, volts, table, base_v if self.sensor.base else None)

    def select(self, *prefixes: str) -> "Folder":
        """The recordings whose split begins with one of the prefixes; may be none."""
        return replace(self, manifest=self.manifest[self.manifest["split"].str.startswith(prefixes)])

    def labelled(self) -> "Folder":
        """The recordings whose direction, speed and offset are all given."""
        known = self.manifest[["direction_deg", "speed_mm_s", "offset_mm"]].notna().all(axis=1)
        return replace(self, manifest=self.manifest[known])


def read_folder(root: str | Path, files: bool = True) -> Folder:
    """Reads `sensor.toml` and `manifest.csv`. files: see that every file named exists; else `Folder.load` does.

    Raises:
        InputError: a file is missing or malformed.
    """
    root = Path(root)
    if not root.is_dir():
        raise InputError(f"{root}: no such folder; name one with sensor.toml, manifest.csv and slides/")
    sensor = read_sensor(root / "sensor.toml")
    path = root / "manifest.csv"
    manifest = check_manifest(read_table(path), sensor, path)
    for row, (recording, file) in enumerate(manifest["file"].items() if files else (), 1):
        if not (root / file).is_file():
            raise InputError(
                f"{path}: row {row} ({recording}), file = {file}: no such file in {root}; "
                "put it there or take the row out"
            )
    return Folder(root, sensor, manifest)


def write_folder(
    out: str | Path,
    sensor: Sensor,
    manifest: pd.DataFrame,
    recordings: Iterable[Recording],
    notes: Mapping[str, str] | None = None,
) -> Folder:
    """Writes a folder whole or not at all; the recordings may come from a generator, one at a time.

    manifest: as in `Folder`, or with a `recording` column; its `file` column is set here. Each row needs its
    recording and the other way round. notes: further files by name, such as where it all comes from.

    Raises:
        InputError: the manifest holds what `read_folder` would refuse, or `out` cannot be written.
    """
    if "recording" in manifest.columns:
        manifest = manifest.set_index("recording")
    names = [str(name) for name in manifest.index]
    table = manifest.reset_index(names="recording").assign(file=[f"slides/{name}.parquet" for name in names])
    table = check_manifest(table, sensor, Path(out) / "manifest.csv")
    with staged(Path(out)) as scratch:
        (scratch / "slides").mkdir()
        write_sensor(scratch / "sensor.toml", sensor)
        write_manifest(scratch / "manifest.csv", table)
        for name, text in (notes or {}).items():
            (scratch / name).write_text(text, encoding="utf-8")
        written = []
        for recording in recordings:
            if recording.name not in table.index:
                raise InputError(f"{out}: recording '{recording.name}' has no row in the manifest; add one")
            if (recording.base_v is None) != (sensor.base is None):
                raise InputError(
                    f"{out}: recording '{recording.name}' and the sensor do not both have a base; give base_v or take "
                    "[base] out"
                )
            file = scratch / "slides" / f"{recording.name}.parquet"
            write_slide(file, recording.time_s, recording.samples, sensor.columns)
            if recording.truth is not None:
                write_truth(truth_path(file), recording.truth)
            written.append(recording.name)
        if missing := sorted(set(names) - set(written)):
            raise InputError(f"{out}: recording '{missing[0]}' is in the manifest alone; take its row out")
    return Folder(Path(out), sensor, table)
