"""Recordings as a LeRobot data set: the frames are the recordings' blocks and the estimates of the bundle."""

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from streams import RATE_HZ, a_sensor, pass_over, still

import softslide
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.recordings.manifest import LABELS

# LeRobot's own reader, without what moves robots and reads videos: these and what this project has installed.
READER = """
lerobot==0.4.4 datasets<5 huggingface-hub<0.36 fsspec dill multiprocess xxhash jsonlines av torchvision==0.27.0
draccus==0.10.0 einops deepdiff orderly-set termcolor httpx pyyaml-include mergedeep typing-inspect mypy-extensions toml
hf-xet accelerate safetensors
"""
READ = """
import json, sys, torch
# The wheel of torchvision is for graphics cards; without this its import ends in an error.
torchvision = torch.library.Library("torchvision", "DEF")
torchvision.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
from huggingface_hub import DatasetCard, ModelCard
from lerobot.datasets.lerobot_dataset import LeRobotDataset
assert "LeRobot" in DatasetCard.load(sys.argv[1] + "/README.md").data.tags
assert ModelCard.load(sys.argv[2] + "/README.md").data.library_name == "softslide"
data = LeRobotDataset("local/skin", root=sys.argv[1])
later = {"observation.volts": [-0.02, 0.0]}
later = LeRobotDataset("local/skin", root=sys.argv[1], episodes=[1], delta_timestamps=later)
frame = data[60]
print(json.dumps([data.num_episodes, len(data), data.fps, frame["task"], frame["observation.volts"].tolist(),
                  frame["observation.estimate"].tolist(), bool(frame["observation.valid"]), frame["timestamp"].item(),
                  list(later[5]["observation.volts"].shape)]))
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """Two slides of two splits."""
    names = ("one", "two")
    table = pd.DataFrame(np.nan, pd.Index(names, name="recording"), list(LABELS))
    table.insert(0, "split", ["calibration", "test"])

    def recordings():
        for seed, name in enumerate(names):
            slide = np.concatenate([still(1.0), pass_over(2.0 + seed), still(0.505)])
            volts = (
                np.array([1.65, 1.65, 2.45])
                + slide
                + np.random.default_rng(seed).normal(0, 1e-4, slide.shape)
            )
            yield Recording(name, np.arange(len(volts)) / RATE_HZ, volts)

    return write_folder(tmp_path_factory.mktemp("lab") / "lab", a_sensor(), table, recordings())


def frames_of(out: Path) -> pd.DataFrame:
    return pd.read_parquet(out / "data/chunk-000/file-000.parquet")


def test_a_frame_is_a_block_and_its_estimate(bundle: Path, lab: Folder, tmp_path: Path) -> None:
    info = softslide.export_recordings(lab.root, tmp_path / "out", model=bundle)
    frames, localizer = frames_of(tmp_path / "out"), softslide.Localizer.load(bundle)
    assert list(frames) == list(info["features"])
    assert list(frames["index"]) == list(range(info["total_frames"]))
    episodes = pd.read_parquet(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet")
    for episode, row in episodes.iterrows():
        own = frames[row["dataset_from_index"] : row["dataset_to_index"]]
        assert (own["episode_index"] == episode).all()
        volts = lab.load(row["recording"]).volts
        localizer.reset()
        estimates = localizer.push(volts)
        # Half a block at the end is no frame.
        assert len(own) == row["length"] == len(estimates) == int(len(volts) / RATE_HZ / 0.02)
        blocks = volts[: 20 * len(own)].reshape(len(own), 20, 3).mean(axis=1)
        np.testing.assert_allclose(np.stack(own["observation.volts"]), blocks, atol=1e-6)
        assert list(own["observation.valid"]) == [e.valid for e in estimates]
        assert any(own["observation.valid"])
        for values, e in zip(own["observation.estimate"], estimates, strict=True):
            assert values[5] == pytest.approx(e.offset_mm if e.valid else 0.0, rel=1e-6)


def test_the_statistics_are_those_of_the_frames(lab: Folder, tmp_path: Path) -> None:
    softslide.export_recordings(lab.root, tmp_path / "out")
    frames = frames_of(tmp_path / "out")
    stats = json.loads((tmp_path / "out/meta/stats.json").read_text())
    assert stats.keys() == set(frames)
    volts = np.stack(frames["observation.volts"])
    assert stats["observation.volts"]["mean"] == pytest.approx(volts.mean(axis=0))
    assert stats["observation.volts"]["std"] == pytest.approx(volts.std(axis=0), rel=1e-4)
    assert stats["index"] == {"min": [0], "max": [len(frames) - 1], "mean": [(len(frames) - 1) / 2]} | {
        "std": [pytest.approx(frames["index"].std(ddof=0))],
        "count": [len(frames)],
    }


def test_a_split_alone(lab: Folder, tmp_path: Path) -> None:
    info = softslide.export_recordings(lab.root, tmp_path / "out", split=["test"])
    assert (info["total_episodes"], info["splits"]) == (1, {"train": "0:1"})
    episodes = pd.read_parquet(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet")
    assert list(episodes["recording"]) == ["two"]


def test_what_cannot_be_exported_leaves_nothing(lab: Folder, two_boards: Path, tmp_path: Path) -> None:
    for options, says in (
        ({"to": "rlds"}, "rlds: name lerobot"),
        ({"split": ["trial"]}, "no recording of trial; name a split"),
        ({"model": two_boards}, "channels are"),
    ):
        with pytest.raises(InputError, match=says):
            softslide.export_recordings(lab.root, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_lerobot_reads_it(bundle: Path, lab: Folder, tmp_path: Path) -> None:
    """LeRobot's own reader, in an environment of its own on top of this one."""
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True, timeout=300)
    packages = next((tmp_path / "env/lib").iterdir()) / "site-packages"
    (packages / "below.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    python = tmp_path / "env/bin/python"
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps", *READER.split()]
    subprocess.run(install, check=True, timeout=1800)
    softslide.export_recordings(lab.root, tmp_path / "out", model=bundle)
    softslide.export(bundle, "hub", tmp_path / "hub")
    home = {"HF_HOME": str(tmp_path / "home"), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [python, "-c", READ, tmp_path / "out", tmp_path / "hub"],
        capture_output=True,
        text=True,
        env=os.environ | home,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    frames = frames_of(tmp_path / "out")
    episodes, count, fps, task, volts, estimate, valid, time_s, shape = json.loads(
        done.stdout.splitlines()[-1]
    )
    assert (episodes, count, fps) == (2, len(frames), 50)
    assert task == "follow what slides over the skin"
    assert volts == pytest.approx(list(frames["observation.volts"][60]))
    assert estimate == pytest.approx(list(frames["observation.estimate"][60]))
    assert valid == frames["observation.valid"][60]
    assert time_s == pytest.approx(1.2)
    assert shape == [2, 3]
