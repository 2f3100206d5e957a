"""`softslide export-recordings`: a folder of recordings as a LeRobot data set, which robot policies are trained on.

Format v3.0: one Parquet file of frames, one of episodes, one of tasks, `info.json` and `stats.json`. A recording is an
episode, a block of samples (20 ms) a frame. README.md is its page on a data hub.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from softslide.experiments.evaluation.readout import check_fits, samples_for
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.models.export.hub_card import NOT_STATED
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.folder import Folder, Recording, read_folder
from softslide.pipeline.staging import staged
from softslide.serve.localizer import Localizer

VOLTS, ESTIMATE, VALID = "observation.volts", "observation.estimate", "observation.valid"
# What a frame's estimate holds: mm, mm/s.
ESTIMATED = ("x_mm", "y_mm", "vx_mm_s", "vy_mm_s", "depth_mm", "offset_mm")
TASK = "follow what slides over the skin"
CHUNK = "chunk-000/file-000.parquet"
COUNTED = {"timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64"}
COUNTED["task_index"] = "int64"
PAGE = """---
task_categories:
- robotics
tags:
- LeRobot
- tactile-sensing
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# Contacts on a soft skin: {sensor}

{episodes} episodes, {frames} frames at {fps} Hz; recordings: {origin}.
`observation.volts` has {channels}, in {unit}{estimate}.
Written by softslide in LeRobot's format v3.0.
"""
MEGABYTES = 100  # what LeRobot writes into one file; it reads larger ones as well


def export_recordings(
    recordings: str | Path,
    out: str | Path,
    to: str = "lerobot",
    model: str | Path | None = None,
    split: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Writes the data set, whole or not at all, and returns its `info.json`.

    A frame has `observation.volts` (C,) V, the block's mean with the static output still in, and with a model
    `observation.estimate` (6,), ESTIMATED, and `observation.valid`: where it is false, the estimate is 0. A number that
    the model does not estimate is 0 too. split: by their full names; all if None.

    Raises:
        InputError: the folder or the bundle is not what it should be, they are of different sensors, or the format is
            another.
    """
    if to != "lerobot":
        raise InputError(f"{to}: name lerobot", "to")
    folder = read_folder(recordings)
    if split is not None:
        folder = replace(folder, manifest=folder.manifest[folder.manifest["split"].isin(split)])
    if not len(folder):
        raise InputError(
            f"{recordings}: no recording of {' or '.join(split or ())}; name a split that it has"
        )
    localizer = None if model is None else Localizer.load(model)
    if localizer is not None:
        check_fits(localizer.card, folder)
        localizer = localizer.at_rate(folder.sensor.sample_rate_hz)
    block_s = Conditioning().block_s if localizer is None else localizer.card.conditioning.block_s
    features = _features(folder, 1.0 / block_s, localizer is not None)
    with staged(Path(out)) as scratch:
        episodes = _write_frames(scratch, folder, localizer, block_s, features)
        _write(scratch / "meta/episodes" / CHUNK, pa.Table.from_pandas(episodes, preserve_index=False))
        tasks = pd.DataFrame({"task_index": [0]}, index=[TASK])
        _write(scratch / "meta/tasks.parquet", pa.Table.from_pandas(tasks))
        info = {
            "codebase_version": "v3.0",
            "robot_type": folder.sensor.name,
            "total_episodes": len(episodes),
            "total_frames": int(episodes["length"].sum()),
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": MEGABYTES,
            "video_files_size_in_mb": MEGABYTES,
            "fps": round(1.0 / block_s),
            "splits": {"train": f"0:{len(episodes)}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": features,
        }
        for name, content in (("info", info), ("stats", _statistics(scratch / "data" / CHUNK))):
            text = json.dumps(content, indent=1, allow_nan=False)
            (scratch / f"meta/{name}.json").write_text(text, encoding="utf-8")
        (scratch / "README.md").write_text(_page(folder, info), encoding="utf-8")
    return info


def _page(folder: Folder, info: dict[str, Any]) -> str:
    """README.md of the data set, in Markdown."""
    sensor, estimate = folder.sensor, info["features"].get(ESTIMATE)
    return PAGE.format(
        sensor=sensor.name,
        episodes=info["total_episodes"],
        frames=info["total_frames"],
        fps=info["fps"],
        origin=sensor.origin or NOT_STATED,
        channels=", ".join(info["features"][VOLTS]["names"]),
        unit=sensor.accelerometers[0].unit,
        estimate="" if estimate is None else f"; `{ESTIMATE}` has {', '.join(estimate['names'])}",
    )


def _features(folder: Folder, rate_hz: float, estimated: bool) -> dict[str, dict[str, Any]]:
    """`features` of info.json: type, shape and names of each column."""
    if abs(rate_hz - round(rate_hz)) > 1e-6:
        raise InputError(f"blocks of {1 / rate_hz:g} s: LeRobot counts whole frames a second")
    channels = list(folder.sensor.channels)
    found: dict[str, dict[str, Any]] = {}
    found[VOLTS] = {"dtype": "float32", "shape": [len(channels)], "names": channels}
    if estimated:
        found[ESTIMATE] = {"dtype": "float32", "shape": [len(ESTIMATED)], "names": list(ESTIMATED)}
        found[VALID] = {"dtype": "bool", "shape": [1], "names": None}
    return found | {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in COUNTED.items()}


def _write_frames(
    scratch: Path,
    folder: Folder,
    localizer: Localizer | None,
    block_s: float,
    features: dict[str, dict[str, Any]],
) -> pd.DataFrame:
    """Writes the file of frames, an episode at a time; what the file of episodes holds."""
    schema = pa.schema([(name, _type(each)) for name, each in features.items()])
    path, begin, rows = scratch / "data" / CHUNK, 0, []
    path.parent.mkdir(parents=True)
    names = progress_bar("exporting", "recording", folder.manifest.index, len(folder))
    with pq.ParquetWriter(path, schema) as writer:
        for episode, name in enumerate(names):
            frames = _frames(folder.read(str(name)), localizer, block_s, folder.sensor.sample_rate_hz)
            count = len(frames[VOLTS])
            frames |= {
                "timestamp": np.arange(count) * block_s,
                "frame_index": np.arange(count),
                "episode_index": np.full(count, episode),
                "index": np.arange(begin, begin + count),
                "task_index": np.zeros(count, int),
            }
            columns = [pa.array(frames[field.name].tolist(), field.type) for field in schema]
            writer.write_table(pa.table(columns, schema=schema))
            rows.append({"episode_index": episode, "recording": name, "tasks": [TASK], "length": count})
            rows[-1] |= {"dataset_from_index": begin, "dataset_to_index": begin + count}
            begin += count
    places = ("data/chunk_index", "data/file_index", "meta/episodes/chunk_index", "meta/episodes/file_index")
    return pd.DataFrame(rows).assign(**dict.fromkeys(places, 0))


def _frames(
    recording: Recording, localizer: Localizer | None, block_s: float, rate_hz: float
) -> dict[str, np.ndarray]:
    volts = block_means(recording.volts, Conditioning(block_s=block_s), rate_hz)
    if localizer is None:
        return {VOLTS: volts}
    localizer.reset()
    estimates = localizer.push(samples_for(localizer, recording))[: len(volts)]
    rows = np.array([[getattr(e, name) for name in ESTIMATED] for e in estimates], float)
    valid = np.array([e.valid for e in estimates])
    rows = np.where(valid[:, None], np.nan_to_num(rows), 0.0)
    return {VOLTS: volts[: len(rows)], ESTIMATE: rows, VALID: valid}


def _type(feature: dict[str, Any]) -> pa.DataType:
    kind = pa.bool_() if feature["dtype"] == "bool" else pa.type_for_alias(feature["dtype"])
    return pa.list_(kind, feature["shape"][0]) if feature["names"] else kind


def _statistics(path: Path) -> dict[str, dict[str, list[float]]]:
    """`stats.json`: each column's least, largest and mean value, its deviation and how many there are."""
    found = {}
    for column in pq.ParquetFile(path).schema_arrow.names:
        values = np.array(pq.read_table(path, columns=[column])[column].to_pylist(), float)
        values = values.reshape(len(values), -1)
        each = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        found[column] = {name: value.tolist() for name, value in each.items()} | {"count": [len(values)]}
    return found


def _write(path: Path, table: pa.Table) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table, path)
