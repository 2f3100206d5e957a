"""Tracks: estimates over time against the truth, by hand, against the outside's scorer, and through a real bundle."""

import importlib.util
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import touched_bundle
import touched_skin
from front_door import call
from small_bundle import write_small_bundle

from softslide.experiments.evaluation.tracks import estimate_table, judge, summarize
from softslide.pipeline.atlas.atlas import read_atlas
from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.paths.distribution import PathDistribution
from softslide.pipeline.synthesis.specimen import draw_specimen
from softslide.pipeline.synthesis.synthesize import noise_of, path_plan, record, sensor_of

REFERENCE = (5.0, 0.0)
SCORER = Path(__file__).parents[1].parent / "shared" / "tools" / "score_track.py"


def a_truth() -> pd.DataFrame:
    """Ten seconds at 100 Hz: touch at 2 s, 3 mm/s along +x at y = 4 mm until 6 s, rest, and off at 8 s."""
    time = np.arange(1001) / 100
    moved = np.clip(time - 2, 0, 4)
    return pd.DataFrame(
        {
            "time_s": time,
            "x_mm": -10 + 3 * moved,
            "y_mm": 4.0,
            "vx_mm_s": np.where((time >= 2) & (time < 6), 3.0, 0.0),
            "vy_mm_s": 0.0,
            "contact": ((time >= 2) & (time < 8)).astype(int),
            "depth_mm": 0.5,
        }
    )


def perfect(moment: float, **changes) -> dict:
    """What was so, as an estimate with intervals of 90 %."""
    x = -10 + 3 * float(np.clip(moment - 2, 0, 4))
    moving = 2 <= moment < 6
    speed = 3.0 if moving else 0.0
    true = {
        "x": (x, "mm"),
        "y": (4.0, "mm"),
        "direction": (0.0, "deg"),
        "speed": (speed, "mm_s"),
        "offset": (4.0, "mm"),
    }
    half = {"x": 0.5, "y": 0.5, "direction": 2.0, "speed": 0.1, "offset": 0.5}
    row: dict = {"time_s": moment, "state": "slide", "valid": True}
    for stem, (value, unit) in true.items():
        value = changes.pop(stem, value)
        row |= {f"{stem}_{unit}": value}
        row |= {f"{stem}_lo_{unit}": value - half[stem], f"{stem}_hi_{unit}": value + half[stem]}
    return row | changes


def stream(said) -> list[dict]:
    """An estimate every 20 ms."""
    return [said(float(moment)) for moment in np.arange(1, 500) / 50]


def summary_of(records: list[dict], truth: pd.DataFrame | None = None) -> dict:
    return summarize([judge(estimate_table(records), a_truth() if truth is None else truth, REFERENCE)])


def test_a_perfect_stream_is_perfect() -> None:
    row = summary_of(stream(lambda t: perfect(t) if 2.005 < t < 7.995 else perfect(t, valid=False)))
    assert row["valid_share"] > 0.99
    assert (row["wrong_share"], row["gross_share"], row["phantom_s"], row["never"]) == (0, 0, 0, 0)
    for quantity in ("position", "direction", "speed", "offset"):
        assert row[quantity]["p95"] == pytest.approx(0, abs=1e-9)
        assert row[f"{quantity}_coverage"] == 1
    assert row["depth"]["median"] is None
    assert row["depth_coverage"] is None
    assert row["still_share"] == 0


def test_errors_are_what_was_put_in() -> None:
    """Each estimate off by a known amount, in one quantity at a time."""
    # The interval is y +- 0.5 mm: wrong is what is off by three times that, gross by 5 mm.
    for off, held, wrong, gross in ((0.3, 1, 0, 0), (0.6, 0.5, 0, 0), (1.6, 0.5, 1, 0), (5.6, 0.5, 1, 1)):
        aside = summary_of([perfect(float(t), y=4.0 + off) for t in np.arange(1, 500) / 50])
        assert aside["position"]["median"] == pytest.approx(off)
        assert (aside["position_coverage"], aside["wrong_share"], aside["gross_share"]) == (
            held,
            wrong,
            gross,
        )

    turned = summary_of(stream(lambda t: perfect(t, direction=359.0)))
    assert turned["direction"]["median"] == pytest.approx(1.0)  # over the seam of 0 degrees
    assert turned["direction_coverage"] == 1
    # A standing contact has no direction: wrong where it moves, four of six seconds.
    assert summary_of(stream(lambda t: perfect(t, direction=90.0)))["wrong_share"] == pytest.approx(
        4 / 6, abs=0.01
    )

    fast = summary_of(stream(lambda t: perfect(t, speed=3.15)))
    assert fast["speed"]["median"] == pytest.approx(5.0)
    assert (fast["speed_coverage"], fast["still_share"]) == (0, 1)


def test_time_is_counted_as_it_passes() -> None:
    late = summary_of(stream(lambda t: perfect(t, valid=3 < t < 9)))
    assert late["first_s"]["median"] == pytest.approx(1.0, abs=0.03)
    assert late["valid_share"] == pytest.approx(5 / 6, abs=0.01)
    assert late["phantom_s"] == pytest.approx(1.0, abs=0.03)
    mute = summary_of(stream(lambda t: perfect(t, valid=False)))
    assert (mute["valid_share"], mute["never"], mute["wrong_share"]) == (0, 1, None)
    over = summary_of(stream(lambda t: perfect(t, state="ended" if t > 4 else "slide")))
    assert over["ended_share"] == pytest.approx(0.5, abs=0.01)
    assert over["valid_share"] == pytest.approx(2 / 6, abs=0.01)


def test_velocities_alone_say_direction_and_speed() -> None:
    said = {"state": "slide", "valid": True, "vx_mm_s": 0.0, "vy_mm_s": -3.0}
    half = {"vx_lo_mm_s": -1.0, "vx_hi_mm_s": 1.0, "vy_lo_mm_s": -4.0, "vy_hi_mm_s": -2.0}
    row = summary_of([{"time_s": float(t), **said, **half} for t in np.arange(110, 290) / 50])
    assert row["direction"]["median"] == pytest.approx(90.0)
    assert row["speed"]["median"] == pytest.approx(0.0, abs=1e-9)
    assert row["velocity_coverage"] == 0
    assert row["gross_share"] == 1
    assert row["position"]["median"] is None


@pytest.mark.skipif(not SCORER.is_file(), reason="the outside's scorer is not next to this checkout")
def test_figures_agree_with_the_outsides_scorer() -> None:
    """Three noisy streams with gaps, gross errors, seams and missing intervals."""
    spec = importlib.util.spec_from_file_location("score_track", SCORER)
    assert spec is not None
    assert spec.loader is not None
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    random = np.random.default_rng(7)
    truth, streams = a_truth(), []

    def noisy(moment: float, share: float) -> dict:
        return perfect(
            moment,
            y=4 + 0.4 * random.standard_normal() + 6 * (random.uniform() < 0.05),
            direction=(2 * random.standard_normal() + 40 * (random.uniform() < 0.05)) % 360,
            speed=3 * np.exp(0.05 * random.standard_normal()),
            offset=4 + 0.5 * random.standard_normal(),
            valid=random.uniform() < share,
            state="slide" if random.uniform() < 0.9 else "ended",
        )

    for share in (0.7, 0.5, 0.3):
        records = [noisy(float(moment), share) for moment in np.arange(1, 500) / 50]
        for row in records[::7]:
            row |= {"offset_lo_mm": None, "offset_hi_mm": None}
        streams.append(records)
    mine = summarize([judge(estimate_table(records), truth, REFERENCE) for records in streams])
    theirs = scorer.summary([scorer.judged(records, truth, REFERENCE) for records in streams])
    percent = {
        "valid %": "valid_share",
        "held %": "ended_share",
        "false %": "wrong_share",
        "gross %": "gross_share",
        "still %": "still_share",
        "c-pos": "position_coverage",
        "c-dir": "direction_coverage",
        "c-spd": "speed_coverage",
        "c-off": "offset_coverage",
    }
    for column, name in percent.items():
        assert theirs[column] == f"{100 * mine[name]:.0f}", column
    pairs = {
        "pos mm": ("position", 2),
        "dir deg": ("direction", 1),
        "spd %": ("speed", 1),
        "off mm": ("offset", 2),
    }
    for column, (name, digits) in pairs.items():
        assert theirs[column] == f"{mine[name]['median']:.{digits}f} / {mine[name]['p95']:.{digits}f}", column
    assert theirs["first s"] == f"{mine['first_s']['median']:.1f} / {mine['first_s']['p95']:.1f}"
    assert theirs["phantom s"] == f"{mine['phantom_s']:.2f}"
    assert (theirs["n"], theirs["never"]) == (mine["recordings"], mine["never"])


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """A line and a curve, quickly done, with their truth; and the line once more, in a test split, without it."""
    quick = PathDistribution(speed_mm_s=(7.0, 8.0))
    atlas, sensor = read_atlas(), sensor_of(read_atlas())
    specimen = draw_specimen(sensor, Distribution(), 3)
    drawn = [path_plan(n, 3, atlas, sensor, Distribution(), quick) for n in range(2)]
    made = [(path, record(path, specimen, atlas, noise_of(n, 3))) for n, path in enumerate(drawn)]
    line, recording = made[0]
    rows = [path.labels() for path, _ in made] + [line.labels() | {"recording": "again", "split": "test"}]
    recordings = [each for _, each in made] + [replace(recording, name="again", truth=None)]
    root = tmp_path_factory.mktemp("paths") / "d"
    return write_folder(root, sensor, pd.DataFrame(rows), recordings)


def test_evaluate_scores_whole_contacts_next_to_the_live_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a skin that is touched anywhere."""
    volts = touched_bundle.outputs(
        touched_bundle.at_rest(1.5), touched_bundle.circle(), touched_bundle.at_rest(1.0)
    )
    time = np.arange(len(volts)) / touched_skin.RATE_HZ
    touching = (time >= 1.5) & (time < time[-1] - 1.0)
    motion = np.where(touching[:, None], touched_bundle.on_the_circle(time - 1.5), 0.0)
    truth = pd.DataFrame(motion, columns=["x_mm", "y_mm", "vx_mm_s", "vy_mm_s"]).assign(
        time_s=time, contact=touching.astype(int), depth_mm=0.5
    )
    rows = pd.DataFrame([{"recording": "round", "split": "track-circle"}])
    folder = write_folder(tmp_path / "d", touched_skin.SENSOR, rows, [Recording("round", time, volts, truth)])
    bundle, out = touched_bundle.write_touched_bundle(tmp_path / "m"), tmp_path / "out"
    command = ["evaluate", "--model", bundle, "--recordings", folder.root, "--jobs", 1]
    assert call(*command, "--split", "track-circle", "--out", out, "--allow-untested") == 0
    metrics = json.loads((out / "metrics.json").read_text())
    live, whole = metrics["tracks"]["track-circle"], metrics["whole_contacts"]["track-circle"]
    assert whole["valid_share"] > max(live["valid_share"], 0.9)
    assert whole["position"]["median"] < live["position"]["median"]
    assert whole["direction"]["median"] < live["direction"]["median"]
    assert "track-circle, from whole contacts: valid" in capsys.readouterr().out
    assert "--whole-contact" in (out / "report.html").read_text()


def test_evaluate_scores_tracks(paths: Folder, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", replace(paths.sensor, name="trial"))
    common = ["evaluate", "--model", bundle, "--recordings", paths.root, "--jobs", 1]
    call(*common, "--split", "track-line", "track-curve", "test", "--out", tmp_path / "tracks")
    metrics = json.loads((tmp_path / "tracks/metrics.json").read_text())
    assert list(metrics["tracks"]) == ["track-line", "track-curve"]
    line = metrics["tracks"]["track-line"]
    assert line["recordings"] == 1
    # This model always says 30 degrees and 2 mm/s.
    true = paths.manifest.loc["p00000"]
    error = abs((30.0 - true["direction_deg"] + 180) % 360 - 180)
    assert line["valid_share"] > 0
    assert line["direction"]["median"] == pytest.approx(error, abs=0.01)
    assert line["speed"]["median"] == pytest.approx(100 * abs(2.0 / true["speed_mm_s"] - 1), rel=0.01)
    report = (tmp_path / "tracks/report.html").read_text()
    assert report.count("best, middle and worst by place") == 2
    assert "Contacts followed" in report
    said = capsys.readouterr()
    assert "track-curve: valid" in said.out
    assert "whole_contacts" not in metrics
    assert "1 of 3 recordings have no truth" in said.err

    call(*common, "--split", "test", "--out", tmp_path / "lines")
    assert "tracks" not in json.loads((tmp_path / "lines/metrics.json").read_text())
    assert "Contacts followed" not in (tmp_path / "lines/report.html").read_text()
    assert "no truth" not in capsys.readouterr().err


def test_a_broken_truth_is_refused(paths: Folder, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", replace(paths.sensor, name="trial"))
    lab, out = shutil.copytree(paths.root, tmp_path / "lab"), tmp_path / "out"
    file = lab / "slides/p00001.truth.csv"
    file.write_text(file.read_text().replace("contact", "touching", 1))
    words = ["--model", bundle, "--recordings", lab, "--split", "track-curve", "--out", out, "--jobs", 1]
    assert call("evaluate", *words) == 2
    assert "p00001.truth.csv: column 'contact' is missing" in capsys.readouterr().err
    assert not out.exists()
