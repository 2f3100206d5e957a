"""The comparison: every model read out as a device would, figures worked out by hand."""

import json
import math
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pandas as pd
import pytest
from bump_slides import bump_folder, bump_sensor, lines
from front_door import call, refused
from html_page import self_contained
from pandas.testing import assert_frame_equal
from small_bundle import OUTPUTS, write_small_bundle

from softslide.experiments.comparison.compare import Findings, error_rows
from softslide.experiments.comparison.inversion import window_card, window_predictions
from softslide.experiments.comparison.page import verdict
from softslide.experiments.comparison.paired import interval, paired
from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.readout import predictions
from softslide.features.card import Interval, Validity
from softslide.features.stream.conditioning import Conditioning
from softslide.pipeline.recordings.folder import Folder

AXES, OFFSETS = (0.0, 90.0, 180.0, 270.0), (-9.0, -6.0, -3.0, 3.0, 6.0, 9.0)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    splits = {
        "calibration": lines(AXES, OFFSETS, (6.0, 12.0)),
        "test": lines(AXES, (-4.5, 4.5), (8.0, 12.0)),
        "test-diagonal": lines((45.0,), (2.0,), (8.0,)),
    }
    return bump_folder(tmp_path_factory.mktemp("labs") / "lab", bump_sensor(1), splits)


@pytest.fixture(scope="module")
def out(lab: Folder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the interpolation and trees were compared on the lab's slides."""
    out = tmp_path_factory.mktemp("compared") / "out"
    assert compared(lab.root, out, "interpolation", "trees") == 0
    return out


def compared(recordings: Path, out: Path, *models: str) -> int:
    return call("compare", "--recordings", recordings, "--out", out, "--models", *models)


def test_the_table_holds_what_evaluate_says_of_the_same_bundle(
    lab: Folder, out: Path, tmp_path: Path
) -> None:
    table = pd.read_csv(out / "comparison.csv")
    bundle = out / "lab" / "trees" / "bundle"
    arguments = ["--model", bundle, "--recordings", lab.root, "--out", tmp_path / "e", "--jobs", 1]
    call("evaluate", *arguments, "--no-report")
    metrics = json.loads((tmp_path / "e" / "metrics.json").read_text())
    seen = table[(table["model"] == "trees") & (table["folder"] == "lab")]
    assert len(seen) == 2 * 10
    for row in seen.to_dict("records"):
        found = metrics["splits"][row["split"]][f"{row['stroke_fraction']:.1f}"]
        assert row["n"] == found["recordings"] == (8 if row["split"] == "test" else 1)
        assert row["valid_share"] == pytest.approx(found["valid_share"])
        for column, name, kind in (
            ("direction_mean_deg", "direction_deg", "mean"),
            ("speed_max_percent", "speed_percent", "max"),
            ("offset_mean_mm", "offset_mm", "mean"),
            ("direction_coverage", "direction_deg_coverage", "share"),
        ):
            assert row[column] == pytest.approx(found[name].get(kind, math.nan), rel=1e-4, nan_ok=True)
    assert (table["window_ms"] > 0).all()
    end = seen[(seen["stroke_fraction"] == 1.0) & (seen["split"] == "test")].iloc[0]
    assert end["valid_share"] == 1.0
    assert end["direction_mean_deg"] < 5.0


def test_an_estimator_on_windows_is_read_as_a_bundle_is(lab: Folder, tmp_path: Path) -> None:
    """The same graph, once as a bundle and once as a function of windows: the same rows."""
    bundle = write_small_bundle(tmp_path / "bundle", lab.sensor, offset_mm_per_v=50.0)
    session = ort.InferenceSession(str(bundle / "model.onnx"), providers=["CPUExecutionProvider"])
    intervals = {
        "direction_deg": Interval(1.0, 2.0),
        "log_speed": Interval(1.0, 0.1),
        "offset_mm": Interval(1.0, 1.0),
    }
    card = window_card(OUTPUTS, lab, Conditioning(), Validity(), intervals)

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
    found = Findings("", pd.Index([]), {"model": scored}, {"model": 1.5})
    (row,) = error_rows(found)
    assert (row["model"], row["window_ms"]) == ("model", 1.5)
    assert (row["n"], row["split"], row["stroke_fraction"]) == (3, "test", 1.0)
    assert row["valid_share"] == pytest.approx(2 / 3)
    assert (row["direction_mean_deg"], row["direction_max_deg"]) == (2.0, 3.0)
    assert row["depth_mean_mm"] == pytest.approx(0.25)  # of what is valid alone
    assert (row["direction_coverage"], row["speed_coverage"]) == (0.5, 1.0)
    assert math.isnan(row["offset_coverage"])


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
    capsys.readouterr()
    assert compared(root, tmp_path / "again", str(bundles[0]), str(bundles[0])) == 2
    assert "two models of this name" in capsys.readouterr().err


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
    assert set(pairs["model"]) == {"trees"}
    assert set(pairs["against"]) == {"interpolation"}  # the first, without the default model
    page, text = self_contained(out / "comparison.html"), (out / "comparison.html").read_text("utf-8")
    for alt, unit in zip(page.alts[:3], ("(deg)", "(%)", "(mm)"), strict=True):
        assert unit in alt
        assert "each model less interpolation on the same slides" in alt
    assert "test-diagonal, trees" in text
    for word in ("direction error (deg)", "speed error (%)", "distance error (mm)"):
        assert any(word in alt and "a line a model, test-diagonal" in alt for alt in page.alts)
    assert "Origin not said" in page.words
    assert ">too few<" in text  # of one diagonal line


def test_a_model_that_the_sensor_does_not_suit_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    splits = {"calibration": lines(AXES, (-6.0, 6.0), (9.0,)), "test": lines((0.0,), (3.0,), (9.0,))}
    root = bump_folder(tmp_path / "two", bump_sensor(2), splits).root
    assert compared(root, tmp_path / "out", "interpolation", "trees") == 0
    text = (tmp_path / "out" / "comparison.html").read_text(encoding="utf-8")
    assert "Left out is interpolation: the interpolation reads one accelerometer" in text
    assert set(pd.read_csv(tmp_path / "out" / "comparison.csv")["model"]) == {"trees"}
    capsys.readouterr()
    assert compared(root, tmp_path / "out", "interpolation") == 2
    assert "one accelerometer" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("splits", "arguments", "says"),
    [
        ({"calibration": 1, "test": 1}, ["--models", "oracle"], "no model 'oracle', nor a bundle there"),
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
    said = refused(capsys, "compare", *(word for name, values in given.items() for word in (name, *values)))
    assert said.startswith("softslide compare: ")
    assert says in said
