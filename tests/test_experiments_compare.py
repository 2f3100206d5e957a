"""The comparison: every model read out as a device would, work that is taken up again, figures worked out by hand."""

import json
import math
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mlflow
import numpy as np
import onnxruntime as ort
import pandas as pd
import pytest
from bump_slides import bump_folder, bump_sensor, lines
from pandas.testing import assert_frame_equal
from small_bundle import OUTPUTS, write_small_bundle

import softslide
from experiments.comparison import figures as comparison_figures
from experiments.comparison.page import verdict
from experiments.comparison.paired import interval, paired
from experiments.comparison.peers import Study, kept
from experiments.comparison.table import error_rows, markdown
from experiments.evaluation import efficiency
from experiments.evaluation.archive import Archive
from experiments.evaluation.readout import predictions
from experiments.evaluation.window_readout import window_card, window_predictions
from experiments.tracking.store import find_run
from features.card import Interval, Validity
from features.stream.conditioning import Conditioning
from models.classical import regression
from pipeline.recordings.folder import Folder
from pipeline.recordings.windows import labelled_windows

AXES, OFFSETS = (0.0, 90.0, 180.0, 270.0), (-9.0, -6.0, -3.0, 3.0, 6.0, 9.0)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    splits = {
        "calibration": lines(AXES, OFFSETS, (6.0, 10.0, 15.0)),
        "test": lines(AXES, (-4.5, 4.5), (8.0, 12.0)),
        "test-diagonal": lines((45.0,), (2.0,), (8.0,)),
    }
    return bump_folder(tmp_path_factory.mktemp("labs") / "lab", bump_sensor(1), splits)


@pytest.fixture(scope="module")
def out(lab: Folder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the interpolation and the Gaussian process were compared on the lab's slides."""
    out = tmp_path_factory.mktemp("compared") / "out"
    assert compared(lab.root, out, "interpolation", "gp") == 0
    return out


def compared(recordings: Path, out: Path, *models: str) -> int:
    return softslide.main(
        ["compare", "--recordings", str(recordings), "--out", str(out), "--models", *models]
    )


def test_the_table_holds_what_evaluate_says_of_the_same_bundle(
    lab: Folder, out: Path, tmp_path: Path
) -> None:
    table = pd.read_csv(out / "comparison.csv")
    bundle = out / "lab" / "gp" / "bundle"
    arguments = ["--model", bundle, "--recordings", lab.root, "--out", tmp_path / "e", "--jobs", 1]
    softslide.main(["evaluate", *map(str, arguments)])
    metrics = json.loads((tmp_path / "e" / "metrics.json").read_text())
    seen = table[(table["model"] == "gp") & (table["folder"] == "lab")]
    assert len(seen) == 2 * 10
    for row in seen.to_dict("records"):
        said = metrics["splits"][row["split"]][f"{row['stroke_fraction']:.1f}"]
        assert row["n"] == said["recordings"] == (8 if row["split"] == "test" else 1)
        assert row["valid_share"] == pytest.approx(said["valid_share"])
        for column, name, kind in (
            ("direction_mean_deg", "direction_deg", "mean"),
            ("speed_max_percent", "speed_percent", "max"),
            ("offset_mean_mm", "offset_mm", "mean"),
            ("direction_coverage", "direction_deg_coverage", "share"),
        ):
            assert row[column] == pytest.approx(said[name].get(kind, math.nan), rel=1e-4, nan_ok=True)
    end = seen[(seen["stroke_fraction"] == 1.0) & (seen["split"] == "test")].iloc[0]
    assert end["valid_share"] == 1.0
    assert end["direction_mean_deg"] < 5.0


def test_tables_and_figures_name_every_model_and_split(out: Path) -> None:
    text = (out / "comparison.md").read_text(encoding="utf-8")
    figure = (out / "errors-lab.svg").read_text(encoding="utf-8")
    ElementTree.fromstring(figure)
    for name in ("interpolation", "gp", "test-diagonal"):
        assert f"| {name} |" in text
        assert f">{name}<" in figure
    for axis in ("mean direction error, deg", "mean speed error, %", "mean distance error, mm"):
        assert axis in figure
    times = pd.read_csv(out / "times.csv")
    assert times["model"].tolist() == ["interpolation", "gp"]
    assert (times["window_ms"] > 0).all()
    assert np.allclose(times["ratio"], times["window_ms"] / times["one_node_ms"], rtol=1e-4)


def test_a_comparison_is_a_run_with_one_below_it_for_each_model(out: Path, tracking_store: str) -> None:
    client = mlflow.MlflowClient(tracking_store, tracking_store)
    table = pd.read_csv(out / "comparison.csv")
    whole = find_run(client, {"command": "compare"}, "FINISHED")
    assert whole is not None
    below = f"tags.`mlflow.parentRunId` = '{whole.info.run_id}'"
    parts = {run.data.params["model"]: run for run in client.search_runs([whole.info.experiment_id], below)}
    assert set(parts) == {"interpolation", "gp"}
    for model, run in parts.items():
        rows = table[
            (table["model"] == model) & (table["split"] == "test") & (table["stroke_fraction"] == 1.0)
        ]
        mean = rows["offset_mean_mm"].item()
        assert run.data.metrics["test.offset_mean_mm"] == pytest.approx(mean, rel=1e-5)
    files = {item.path for item in client.list_artifacts(whole.info.run_id, "comparison")}
    assert {"comparison/comparison.md", "comparison/times.csv"} <= files


def test_work_that_is_there_is_taken_up_again(lab: Folder, out: Path) -> None:
    place = out / "lab" / "interpolation"
    bundle, readout = place / "bundle" / "model.onnx", place / "readout" / "table.parquet"
    before, table = bundle.stat().st_mtime_ns, (out / "comparison.csv").read_bytes()
    (place / "readout" / "made.json").unlink()
    read = readout.stat().st_mtime_ns
    assert compared(lab.root, out, "interpolation", "gp") == 0
    assert bundle.stat().st_mtime_ns == before
    assert readout.stat().st_mtime_ns > read
    assert (out / "comparison.csv").read_bytes() == table


def test_other_data_are_learnt_anew(tmp_path: Path) -> None:
    root = tmp_path / "lab"
    bundle = tmp_path / "out" / "lab" / "interpolation" / "bundle" / "model.onnx"
    graphs = []
    for speed in (6.0, 7.0):
        splits = {
            "calibration": lines(AXES, OFFSETS, (speed, 10.0, 15.0)),
            "test": lines((0.0,), (4.5,), (8.0,)),
        }
        bump_folder(root, bump_sensor(1), splits)
        assert compared(root, tmp_path / "out", "interpolation") == 0
        graphs.append(bundle.read_bytes())
    assert graphs[0] != graphs[1]
    # So is a bundle that this release cannot read.
    (bundle.parent / "model.json").write_text("{}")
    assert compared(root, tmp_path / "out", "interpolation") == 0
    assert bundle.read_bytes() == graphs[1]
    assert (bundle.parent / "model.json").read_text() != "{}"


def test_kept_is_made_again_only_for_something_else(tmp_path: Path) -> None:
    calls = []

    def make() -> tuple[pd.DataFrame, dict[str, float]]:
        calls.append(1)
        return pd.DataFrame({"recording": ["001"], "n": [len(calls)]}), {"window_ms": 0.5}

    first = kept(tmp_path / "a", {"of": (1, 2)}, make)
    again = kept(tmp_path / "a", {"of": (1, 2)}, make)
    assert_frame_equal(first[0], again[0])
    assert again[1] == {"window_ms": 0.5}
    assert len(calls) == 1
    other, _ = kept(tmp_path / "a", {"of": (1, 3)}, make)
    assert other["n"].tolist() == [2]


def test_an_estimator_on_windows_is_read_as_a_bundle_is(lab: Folder, tmp_path: Path) -> None:
    """The same graph, once as a bundle and once as a function of windows: the same rows."""
    bundle = write_small_bundle(tmp_path / "bundle", lab.sensor, offset_mm_per_v=50.0)
    session = ort.InferenceSession(str(bundle / "model.onnx"), providers=["CPUExecutionProvider"])
    intervals = {
        "direction_deg": Interval(1.0, 2.0),
        "log_speed": Interval(1.0, 0.1),
        "offset_mm": Interval(1.0, 1.0),
    }
    card = window_card("function", OUTPUTS, lab.sensor, Conditioning(), Validity(), intervals)

    def predict(volts: np.ndarray, elapsed_s: np.ndarray) -> np.ndarray:
        weight = np.ones((len(volts), 1), np.float32)
        inputs = {"volts": volts, "elapsed_s": elapsed_s.astype(np.float32), "weight": weight}
        return session.run(None, inputs)[0]

    some = lab.select("test-diagonal")
    bundled = pd.concat(predictions(bundle, some, Archive(jobs=1)), ignore_index=True)
    assert bundled["valid"].any()
    assert bundled["offset_mm"].nunique() > 3
    assert_frame_equal(window_predictions(predict, card, some), bundled, rtol=1e-6)


def test_error_rows_by_hand() -> None:
    nan = math.nan
    scored = pd.DataFrame(
        {
            "recording": ["a", "b", "c"],
            "split": "test",
            "stroke_fraction": 1.0,
            "valid": [True, True, False],
            "direction_deg_error": [1.0, 3.0, nan],
            "speed_percent_error": [2.0, 2.0, nan],
            "offset_mm_error": [0.1, 0.3, nan],
            "offset_percent_error": nan,
            "position_mm_error": nan,
            "position_percent_error": nan,
            "depth_mm": [0.6, 0.9, 5.0],
            "true_depth_mm": 0.5,
            "direction_deg_covered": [1.0, 0.0, nan],
            "speed_mm_s_covered": [1.0, 1.0, nan],
            "offset_mm_covered": nan,
        }
    )
    (row,) = error_rows(scored)
    assert (row["n"], row["split"], row["stroke_fraction"]) == (3, "test", 1.0)
    assert row["valid_share"] == pytest.approx(2 / 3)
    assert (row["direction_mean_deg"], row["direction_max_deg"]) == (2.0, 3.0)
    assert row["depth_mean_mm"] == pytest.approx(0.25)  # of what is valid alone
    assert (row["direction_coverage"], row["speed_coverage"]) == (0.5, 1.0)
    assert math.isnan(row["offset_coverage"])


def test_ratios_to_the_bound_by_hand() -> None:
    scored = pd.DataFrame(
        {
            "recording": ["a", "b", "c", "d"],
            "stroke_fraction": 0.1 + 0.2,  # not quite 0.3
            "valid": [True, True, True, False],
            "direction_deg": [359.0, 3.0, 92.0, 0.0],
            "true_direction_deg": [0.0, 0.0, 90.0, 90.0],
            "speed_mm_s": [math.exp(0.01), math.exp(0.01), 1.0, 9.0],
            "true_speed_mm_s": 1.0,
            "offset_mm": [0.2, -1.2, -6.5, 0.0],
            "true_offset_mm": [0.0, -1.0, -6.0, 0.0],
        }
    )
    bounds = pd.DataFrame(
        {
            "recording": ["a", "b", "c", "d"],
            "stroke_fraction": 0.3,
            "direction_deg_bound": [1.0, 1.0, 4.0, 1.0],
            "log_speed_bound": 0.01,
            "offset_mm_bound": 0.1,
        }
    )
    near, far = efficiency.ratios(scored, bounds).to_dict("records")
    assert (near["distance_mm"], near["n"], far["distance_mm"], far["n"]) == ("0-5", 2, "5-10", 1)
    assert near["direction_deg_ratio"] == pytest.approx(math.sqrt((1 + 9) / 2))
    assert near["log_speed_ratio"] == pytest.approx(1.0)
    assert near["offset_mm_ratio"] == pytest.approx(2.0)
    assert far["direction_deg_ratio"] == pytest.approx(0.5)
    assert far["log_speed_ratio"] == pytest.approx(0.0)
    (row,) = efficiency.ratios(scored.assign(split="test"), bounds, "split").to_dict("records")
    assert (row["split"], row["n"]) == ("test", 3)
    assert row["direction_deg_ratio"] == pytest.approx(math.sqrt((1 + 9 + 4) / (1 + 1 + 16)))


def test_the_bound_s_figure_has_a_line_for_each_distance() -> None:
    rows = [
        {
            "model": model,
            "distance_mm": distance,
            "stroke_fraction": fraction,
            **dict.fromkeys(comparison_figures.RATIOS, 1.2),
        }
        for model in ("cnn", "inversion")
        for distance in ("0-5", "5-10")
        for fraction in (0.5, 1.0)
    ]
    figure = comparison_figures.efficiency(pd.DataFrame(rows))
    ElementTree.fromstring(figure)
    for text in (">0-5 mm<", ">5-10 mm<", ">cnn: speed<", ">inversion: distance<", ">rms error / bound<"):
        assert text in figure


def test_bundles_are_compared_as_they_are_without_calibration_slides(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = bump_folder(
        tmp_path / "lab", bump_sensor(1), {"test": lines((0.0,), (-4.5, -2.0, 3.0), (8.0,))}
    ).root
    bundles = [
        write_small_bundle(tmp_path / name, bump_sensor(1), direction_deg=direction, speed_mm_s=8.0)
        for name, direction in (("near", 1.0), ("far", 3.0))
    ]
    assert compared(root, tmp_path / "out", *map(str, bundles)) == 0
    pairs = pd.read_csv(tmp_path / "out" / "paired.csv").set_index("quantity")
    assert pairs["model"].tolist() == ["far"] * 3
    assert (pairs["against"] == "near").all()
    assert pairs.loc["direction_deg", "difference"] == pytest.approx(2.0, abs=1e-3)
    assert pairs.loc["speed_percent", "difference"] == pytest.approx(0.0, abs=1e-3)
    assert "far" in (tmp_path / "out" / "errors-lab.svg").read_text(encoding="utf-8")
    capsys.readouterr()
    assert compared(root, tmp_path / "again", str(bundles[0]), str(bundles[0])) == 2
    assert "two models of this name" in capsys.readouterr().err
    assert compared(root, tmp_path / "again", str(tmp_path / "none")) == 2
    assert "nor a bundle there" in capsys.readouterr().err


def judged(errors: list[float], lines: list[float]) -> pd.DataFrame:
    """Scores at the end of the stroke of slides along x at these offsets, mm; errors in deg, NaN: no estimate."""
    same = pd.DataFrame(
        {"recording": [f"r{n}" for n in range(len(errors))], "split": "test", "stroke_fraction": 1.0}
    )
    known = {
        "speed_percent_error": 1.0,
        "offset_mm_error": 0.5,
        "true_direction_deg": 0.0,
        "true_offset_mm": lines,
    }
    return same.assign(direction_deg_error=errors, **known)


def test_paired_differences_by_hand() -> None:
    """Two slides of one line count once: lines differ by 1, 2 and 6, whose mean is 3 +- 4.303 sqrt(7 / 3)."""
    nan = math.nan
    lines = [1.0, 1.0, 2.0, 3.0, 4.0]
    ours, theirs = judged([1.5, 2.5, 3.0, 7.0, 9.0], lines), judged([1.0, 1.0, 1.0, 1.0, nan], lines)
    table = paired({"ours": ours, "theirs": theirs}, "theirs").set_index("quantity")
    row = table.loc["direction_deg"]
    assert (row["model"], row["against"], row["lines"], row["recordings"]) == ("ours", "theirs", 3, 4)
    assert (row["valid_alone"], row["against_alone"]) == (1, 0)
    assert row["difference"] == pytest.approx(3.0)
    assert row["high"] - 3.0 == pytest.approx(4.3027 * math.sqrt(7 / 3), rel=1e-4)
    assert 3.0 - row["low"] == pytest.approx(row["high"] - 3.0)
    assert verdict(row.to_dict()) == ""
    assert verdict(table.loc["speed_percent"].to_dict() | {"low": 0.1, "high": 0.2}) == "larger"
    few = paired({"ours": ours[:2], "theirs": theirs[:2]}, "theirs").iloc[0]
    assert math.isnan(few["low"])
    assert verdict(few.to_dict()) == "too few"


def test_ninety_five_of_a_hundred_intervals_hold_the_truth() -> None:
    random = np.random.default_rng(0)
    drawn = (interval(random.normal(0.3, 1.0, 8)) for _ in range(2000))
    held = np.mean([low < 0.3 < high for _, low, high in drawn])
    assert held == pytest.approx(0.95, abs=0.015)


def test_the_page_shows_models_side_by_side(out: Path) -> None:
    pairs = pd.read_csv(out / "paired.csv")
    assert set(pairs["model"]) == {"gp"}
    assert set(pairs["against"]) == {"interpolation"}  # the first, without the default model
    text = (out / "comparison.html").read_text(encoding="utf-8")
    assert not re.search(r"url\((?!#)|@import|https?://|<script", text)
    alts = re.findall(r'aria-label="([^"]*)"', text)
    assert len(alts) == 3
    for alt, unit in zip(alts, ("(deg)", "(%)", "(mm)"), strict=True):
        assert unit in alt
        assert "each model less interpolation on the same slides" in alt
    assert "test-diagonal, gp" in text
    assert ">too few<" in text  # of one diagonal line


def test_emulated_recordings_are_called_so() -> None:
    errors = pd.DataFrame(columns=["folder", "stroke_fraction"], data=[["mine", 0.5]])
    nothing = pd.DataFrame()
    assert "never measured on hardware" in markdown("emulated", errors, nothing, nothing, {})
    assert "hardware" not in markdown("measured", errors, nothing, nothing, {})


def test_a_model_that_the_sensor_does_not_suit_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    splits = {"calibration": lines(AXES, (-6.0, 6.0), (9.0,)), "test": lines((0.0,), (3.0,), (9.0,))}
    root = bump_folder(tmp_path / "two", bump_sensor(2), splits).root
    assert compared(root, tmp_path / "out", "interpolation", "gp") == 0
    text = (tmp_path / "out" / "comparison.md").read_text(encoding="utf-8")
    assert "Left out is interpolation: the interpolation reads one accelerometer" in text
    assert set(pd.read_csv(tmp_path / "out" / "comparison.csv")["model"]) == {"gp"}
    capsys.readouterr()
    assert compared(root, tmp_path / "out", "interpolation") == 2
    assert "one accelerometer" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("splits", "arguments", "says"),
    [
        ({"calibration": 1, "test": 1}, ["--models", "oracle"], "no model 'oracle'"),
        ({"calibration": 1, "test": 1}, ["--recordings", "lab", "lab"], "two folders of this name"),
        ({"calibration": 1}, [], "no labelled slide of a split test*"),
        ({"test": 1}, [], "no labelled slide of a split calibration or train*"),
        ({"calibration": 1, "test": 1}, ["--recordings", "nowhere"], "nowhere"),
        ({"calibration": 1, "test": 1}, ["--out", "lab/sensor.toml"], "cannot be written"),
    ],
    ids=str,
)
def test_bad_input_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    splits: dict[str, int],
    arguments: list[str],
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    bump_folder(tmp_path / "lab", bump_sensor(1), {name: lines((0.0,), (3.0,), (20.0,)) for name in splits})
    given = {"--recordings": ["lab"], "--out": ["out"], "--models": ["interpolation"]}
    for n, word in enumerate(arguments):
        if word.startswith("--"):
            given[word] = arguments[n + 1 :]
    assert (
        softslide.main(["compare", *(word for name, values in given.items() for word in (name, *values))])
        == 2
    )
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("softslide compare: ")
    assert says in line


@pytest.mark.long
def test_minirocket_learns_in_its_own_environment(lab: Folder, tmp_path: Path) -> None:
    """Real packages in a real environment; it knows the axes' directions and speeds, as it did when published."""
    assert compared(lab.root, tmp_path / "out", "minirocket") == 0
    table = pd.read_csv(tmp_path / "out" / "comparison.csv")
    end = table[(table["split"] == "test") & (table["stroke_fraction"] == 1.0)].iloc[0]
    assert end["valid_share"] == 1.0
    assert end["direction_mean_deg"] < 15.0
    assert end["speed_mean_percent"] < 10.0
    window_ms = pd.read_csv(tmp_path / "out" / "times.csv")["window_ms"].iloc[0]
    assert 0.05 < window_ms < 1000.0


def test_minirocket_s_features_hold_no_time(lab: Folder) -> None:
    from experiments.comparison.minirocket import shape_and_scale

    windows = labelled_windows(lab.select("test"))
    waves, scales = shape_and_scale(windows.volts)
    assert waves.shape == (len(windows), 2, 64)
    assert np.abs(waves).max(axis=(1, 2)) == pytest.approx(1.0, abs=1e-3)
    twice, louder = shape_and_scale(2 * windows.volts)
    assert np.allclose(twice, waves, atol=1e-4)
    assert np.allclose(louder - scales, [math.log(2.0), 0.0], atol=1e-3)
    # Speed times the energy's width is what it learns: a length, the same for a slide at any speed.
    target = regression.targets(windows)[:, 2]
    assert np.ptp(target[windows.stroke_fraction == 1.0]) < 1.5


def test_a_study_learns_from_no_test_slide(lab: Folder, tmp_path: Path) -> None:
    study = Study(lab.root, tmp_path, "sqlite:///none.db")
    assert set(study.taught.manifest["split"]) == {"calibration"}
    assert set(study.scored.manifest["split"]) == {"test", "test-diagonal"}
    assert set(study.windows.recording) <= set(study.scored.manifest.index)
