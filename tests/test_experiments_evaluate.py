"""Evaluation through a real bundle: the contract's files, exit statuses, a model that sees volts alone."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bump_map import bump_map
from front_door import call, refused
from html_page import Page, self_contained
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from playwright.sync_api import Browser
from small_bundle import write_small_bundle
from trial_folder import SENSOR, a_folder

from softslide.experiments.evaluation import figures
from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.efficiency import bounds_of, over_bound
from softslide.experiments.evaluation.readout import COLUMNS
from softslide.experiments.evaluation.scoring import score
from softslide.experiments.pages.figures import COLOURS, INK, drawn, log_about_zero
from softslide.models.response_map.card import contact_calibration
from softslide.serve.localizer import Localizer


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return write_small_bundle(tmp_path / "bundle", SENSOR, offset_mm_per_v=50.0)


@pytest.fixture
def mapped(tmp_path: Path) -> Path:
    """The same with a response map."""
    contact = contact_calibration(bump_map())
    return write_small_bundle(tmp_path / "mapped", SENSOR, offset_mm_per_v=50.0, contact=contact)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page on slides with and without moments, in two splits."""
    root = tmp_path_factory.mktemp("report")
    small = write_small_bundle(root / "bundle", SENSOR, offset_mm_per_v=50.0)
    unknown = {"motion_start_s": np.nan, "offset_mm": np.nan}
    a_folder(root / "lab", one={}, two=unknown, three={"split": "test-other", "direction_deg": 90.0})
    evaluated(small, root / "lab", root / "out", report=True)
    return root / "out" / "report.html"


def evaluated(
    bundle: Path, recordings: Path, out: Path, *options: str, report: bool = False
) -> tuple[int, pd.DataFrame]:
    """The exit status, and predictions.csv as texts."""
    options = options if report else ("--no-report", *options)
    status = call(
        "evaluate", "--model", bundle, "--recordings", recordings, "--out", out, "--jobs", 1, *options
    )
    return status, pd.read_csv(out / "predictions.csv", dtype=str, keep_default_na=False)


def test_predictions_are_the_contracts(bundle: Path, tmp_path: Path) -> None:
    a_folder(
        tmp_path / "lab",
        one={},
        two={"motion_end_s": np.nan, "direction_deg": np.nan, "travel_mm": np.nan},
        three={"split": "train"},
    )
    _, table = evaluated(bundle, tmp_path / "lab", tmp_path / "out")
    assert table.columns.tolist() == list(COLUMNS) == contract_columns()
    one, two = table[table["recording"] == "one"], table[table["recording"] == "two"]
    assert one["stroke_fraction"].tolist() == [f"{n / 10:.1f}" for n in range(1, 11)]
    assert two["stroke_fraction"].tolist() == ["1.0"]
    assert set(table["recording"]) == {"one", "two"}
    assert set(table["valid"]) <= {"true", "false"}
    assert set(table["depth_mm"]) == {""}  # this model does not estimate it
    assert table.loc[table["valid"] == "true", "direction_deg"].astype(float).to_numpy() == pytest.approx(
        30.0
    )


def contract_columns() -> list[str]:
    names = (
        "recording, stroke_fraction, direction_deg, direction_lo_deg, direction_hi_deg, speed_mm_s, "
        "speed_lo_mm_s, speed_hi_mm_s, offset_mm, offset_lo_mm, offset_hi_mm, depth_mm, x_mm, y_mm, valid"
    )
    return names.split(", ")


def test_each_row_is_the_device_at_that_moment(bundle: Path, tmp_path: Path) -> None:
    """A device that is given the samples up to the moment, and no more, says the same."""
    folder = a_folder(tmp_path / "lab", one={})
    _, table = evaluated(bundle, tmp_path / "lab", tmp_path / "out")
    recording = folder.load("one")
    for row in table.astype({"stroke_fraction": float}).to_dict("records"):
        moment = 1.0 + row["stroke_fraction"] * 4.0
        device = Localizer.load(bundle)
        seen = device.push(recording.volts[recording.time_s <= moment + 1e-9])
        assert row["valid"] == str(seen[-1].valid).lower()
        assert (row["offset_mm"] or "nan") == f"{seen[-1].offset_mm:.9g}"
    assert table["offset_mm"].nunique() > 5  # it does change as the stroke goes on


def test_no_label_reaches_the_model(bundle: Path, tmp_path: Path) -> None:
    """Labels scrambled: not a byte differs. Moments of motion moved: equal moments, equal estimates."""
    names = ("one", "two")
    a_folder(tmp_path / "right", **{name: {} for name in names})
    lies = {
        "direction_deg": 211.0,
        "speed_mm_s": 0.7,
        "offset_mm": -20.0,
        "start_x_mm": 3.0,
        "travel_mm": 11.0,
    }
    a_folder(tmp_path / "lies", **dict.fromkeys(names, lies))
    a_folder(tmp_path / "moved", **{name: {"motion_start_s": 0.6, "motion_end_s": 4.6} for name in names})
    _, right = evaluated(bundle, tmp_path / "right", tmp_path / "a")
    evaluated(bundle, tmp_path / "lies", tmp_path / "b")
    _, moved = evaluated(bundle, tmp_path / "moved", tmp_path / "c")
    assert (tmp_path / "a/predictions.csv").read_bytes() == (tmp_path / "b/predictions.csv").read_bytes()
    # 0.4 s are a tenth of the motion: each moment is the next one's of the other folder.
    for name in names:
        early, late = (t[t["recording"] == name].drop(columns="stroke_fraction") for t in (right, moved))
        assert early[:-1].to_numpy().tolist() == late[1:].to_numpy().tolist()


def test_twice_gives_the_same_bytes_on_one_process_or_two(bundle: Path, tmp_path: Path) -> None:
    a_folder(tmp_path / "lab", one={}, two={}, three={})
    for out, jobs in (("a", "1"), ("b", "2")):
        evaluated(bundle, tmp_path / "lab", tmp_path / out, "--jobs", jobs, report=True)
    for file in ("predictions.csv", "metrics.json", "report.html"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_metrics_say_what_was_found(bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    a_folder(tmp_path / "lab", one={}, two={"split": "test-other"})
    status, _ = evaluated(bundle, tmp_path / "lab", tmp_path / "out")
    assert status == 1  # nothing is tested, and so nothing is met
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    # 14.5 mm/s is faster than the article promises anything for.
    printed = capsys.readouterr()
    assert printed.out.count("not tested, no such recording") == len(metrics["bounds"])
    assert "6 of 6 bounds are not tested" in printed.err
    assert list(metrics["splits"]) == ["test", "test-other"]
    end = metrics["overall"]["1.0"]
    assert end["recordings"] == 2
    assert end["direction_deg"]["mean"] == pytest.approx(30.0, abs=1e-4)
    assert end["speed_percent"]["max"] == pytest.approx(100 * (1 - 2 / 14.5), abs=1e-4)
    assert end["direction_deg_coverage"] == {"n": 2, "share": 0.0}
    assert {b["name"] for b in metrics["bounds"]} >= {"direction", "speed", "distance"}
    assert metrics["bundle"]["card"]["model"] == "small"


@pytest.mark.parametrize(("speed_mm_s", "status"), [(2.0, 0), (2.2, 1)])
def test_the_exit_status_is_the_bounds(tmp_path: Path, speed_mm_s: float, status: int) -> None:
    """A model that is right by construction passes; one that is 10 % off in speed fails."""
    write_small_bundle(tmp_path / "b", SENSOR, direction_deg=0.0, speed_mm_s=speed_mm_s, offset_mm=3.0)
    a_folder(tmp_path / "lab", one={"speed_mm_s": 2.0, "offset_mm": 3.0})
    lab, out = tmp_path / "lab", tmp_path / "out"
    assert evaluated(tmp_path / "b", lab, out, "--allow-untested")[0] == status
    assert evaluated(tmp_path / "b", lab, out)[0] == 1  # the other bounds are not tested


def test_a_bound_that_nothing_tests_names_the_missing_labels(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without = dict.fromkeys(("offset_mm", "start_x_mm", "start_y_mm"), np.nan)
    a_folder(tmp_path / "lab", one=without, two=without, three={"speed_mm_s": 14.5})
    evaluated(bundle, tmp_path / "lab", tmp_path / "out")
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    reasons = {b["name"]: b["untested"] for b in metrics["bounds"]}
    assert reasons["speed"] == "no such recording: of 3, offset_mm is missing in 2"
    gaps = (f"{name} is missing in 2" for name in without)
    assert reasons["position"] == f"no such recording: of 3, {', '.join(gaps)}"
    assert reasons["speed"] in capsys.readouterr().out


def test_bounds_hold_at_the_folders_own_depth(tmp_path: Path) -> None:
    write_small_bundle(tmp_path / "b", SENSOR, direction_deg=0.0, speed_mm_s=2.2, offset_mm=3.0)
    slide = {"speed_mm_s": 2.0, "offset_mm": 3.0}
    calibration = {"split": "calibration", "offset_mm": 6.0, "depth_mm": 0.8}
    a_folder(tmp_path / "deep", one=slide | {"depth_mm": 0.8}, two=calibration)
    a_folder(tmp_path / "shallow", one=slide, two=calibration)
    for lab, tested in (("deep", 1), ("shallow", 0)):
        evaluated(tmp_path / "b", tmp_path / lab, tmp_path / f"out-{lab}")
        bounds = json.loads((tmp_path / f"out-{lab}/metrics.json").read_text())["bounds"]
        speed = next(b for b in bounds if b["name"] == "speed")
        assert (speed["recordings"], speed["pass"]) == (tested, False if tested else None)


def test_slides_along_calibrated_lines_are_scored_apart(tmp_path: Path) -> None:
    """The slide along a calibration line is off in speed; neither the figures nor the verdicts hold it."""
    write_small_bundle(tmp_path / "b", SENSOR, direction_deg=0.0, speed_mm_s=2.0, offset_mm=3.0)
    a_folder(
        tmp_path / "lab",
        along={"speed_mm_s": 2.5, "offset_mm": 3.02},
        unseen={"speed_mm_s": 2.0, "offset_mm": 3.3},
        calibration={"split": "calibration", "offset_mm": 3.0},
    )
    evaluated(tmp_path / "b", tmp_path / "lab", tmp_path / "out", report=True)
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert metrics["calibration_lines"]["names"] == ["along"]
    assert metrics["calibration_lines"]["end_of_stroke"]["speed_percent"]["mean"] == pytest.approx(20.0)
    assert metrics["end_of_stroke"]["recordings"] == 1
    assert metrics["end_of_stroke"]["speed_percent"]["max"] == pytest.approx(0.0, abs=1e-4)
    assert [b["recordings"] for b in metrics["bounds"] if b["name"] == "speed"] == [1]
    assert "1 more recording" in Page((tmp_path / "out/report.html").read_text()).words


def test_a_folder_of_calibrated_lines_alone_has_no_figures(bundle: Path, tmp_path: Path) -> None:
    a_folder(tmp_path / "lab", one={}, two={"split": "calibration"})
    status, _ = evaluated(bundle, tmp_path / "lab", tmp_path / "out")
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert (status, metrics["end_of_stroke"]["recordings"]) == (1, 0)


def test_splits_are_chosen_by_full_name(bundle: Path, tmp_path: Path) -> None:
    a_folder(
        tmp_path / "lab", one={}, two={"split": "test-deep"}, three={"split": "train"}, four={"split": "x"}
    )
    chosen = evaluated(bundle, tmp_path / "lab", tmp_path / "out", "--split", "test", "x")[1]
    assert set(chosen["recording"]) == {"one", "four"}


def test_the_report_opens_without_a_network(report: Path) -> None:
    words = self_contained(report).words
    for word in ("section 5.2.2", "not tested", "X forward", "test"):
        assert word in words


def test_every_row_of_the_report_shows_its_numbers_on_a_telephone(report: Path, browser: Browser) -> None:
    page = browser.new_page(viewport={"width": 400, "height": 800})
    page.goto(report.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    rows = "[...document.querySelectorAll('table.cards tbody tr')]"
    right = "Math.max(...[...row.querySelectorAll('[data-name]')].map(cell => cell.getBoundingClientRect().right))"
    reaches = page.evaluate(f"{rows}.map(row => {right})")
    assert len(reaches) > 5
    assert max(reaches) <= 400
    page.close()


@pytest.mark.parametrize(
    ("break_it", "says"),
    [
        (lambda lab, bundle: (lab / "slides/one.parquet").unlink(), "no such file"),
        (lambda lab, bundle: (lab / "slides/one.parquet").write_bytes(b"PAR1"), "one.parquet"),
        (lambda lab, bundle: (bundle / "model.onnx").write_bytes(b"x"), "model.onnx"),
        (lambda lab, bundle: (bundle / "model.json").unlink(), "model.json"),
        (
            lambda lab, bundle: (lab / "manifest.csv").write_text(
                (lab / "manifest.csv").read_text().replace("test", "train")
            ),
            "--split",
        ),
        (
            lambda lab, bundle: (lab / "sensor.toml").write_text(
                (lab / "sensor.toml").read_text().replace("= 200.0", "= 20.0")
            ),
            "sample_rate_hz 20 Hz is not read",
        ),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], break_it, says: str
) -> None:
    a_folder(tmp_path / "lab", one={})
    break_it(tmp_path / "lab", bundle)
    before = sorted(path.name for path in tmp_path.iterdir())
    arguments = ["--model", bundle, "--recordings", tmp_path / "lab", "--out", tmp_path / "out", "--jobs", 2]
    assert says in refused(capsys, "evaluate", *arguments)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def report_of(bundle: Path, lab: Path, out: Path) -> Page:
    evaluated(bundle, lab, out, report=True)
    return Page((out / "report.html").read_text(encoding="utf-8"))


def test_the_report_begins_with_its_answer(tmp_path: Path) -> None:
    slide = {"speed_mm_s": 2.0, "offset_mm": 3.0}
    a_folder(tmp_path / "lab", one=slide, two={"split": "calibration", "offset_mm": 6.0})
    for speed, says in ((2.0, "As far as it was tested"), (2.2, "Not within the article's bounds: “speed”")):
        bundle = write_small_bundle(
            tmp_path / f"b{speed}", SENSOR, direction_deg=0.0, speed_mm_s=speed, offset_mm=3.0
        )
        words = report_of(bundle, tmp_path / "lab", tmp_path / f"out{speed}").words
        assert (
            words.index(says) < words.index("What the recordings cover") < words.index("The article's bounds")
        )
    assert "Directions near 30, 60, 90" in words
    assert "Speeds other than 2 mm/s." in words


def test_errors_are_held_against_the_bound_of_the_bundles_own_map(
    bundle: Path, mapped: Path, tmp_path: Path
) -> None:
    folder = a_folder(tmp_path / "lab", one={}, two={"split": "test-deep", "depth_mm": 0.8})
    page = report_of(bundle, tmp_path / "lab", tmp_path / "without")
    assert "this bundle carries no response map" in page.words
    assert json.loads((tmp_path / "without/metrics.json").read_text())["over_bound"] is None
    # This map is another sensor's, and so no estimate is valid.
    said = report_of(mapped, folder.root, tmp_path / "with").words
    assert "no labelled recording with a valid estimate" in said

    least = pd.concat(bounds_of(mapped, folder, Archive(1)))
    assert set(least["recording"]) == {"one"}  # the map's depth is 0.5 mm: the deep slide has no bound
    scored = score(pd.read_csv(tmp_path / "without/predictions.csv"), folder.manifest, folder.sensor)
    found = over_bound(scored, least)
    assert list(found) == ["test"]
    end = least.set_index("stroke_fraction").loc[1.0]
    assert found["test"]["1.0"]["recordings"] == 1
    assert found["test"]["1.0"]["direction_deg"] == pytest.approx(30.0 / end["direction_deg_bound"], rel=1e-3)
    captions = " ".join(panel.caption for panel in figures.over_bound(found))
    for word in ("direction", "speed", "distance"):
        assert f"Rms error of the {word} over its Cramer-Rao bound" in captions
    assert captions.count("Recordings behind each point: test 1.") == 3


def test_a_folder_without_any_bound_is_evaluated_all_the_same(
    bundle: Path, mapped: Path, tmp_path: Path
) -> None:
    """No slide has one: all are of another depth than the map."""
    deep = a_folder(tmp_path / "deep", one={"depth_mm": 0.8}, two={"depth_mm": 0.9})
    evaluated(mapped, deep.root, tmp_path / "out")
    assert json.loads((tmp_path / "out/metrics.json").read_text())["over_bound"] == {}
    evaluated(bundle, deep.root, tmp_path / "plain")
    scored = score(pd.read_csv(tmp_path / "plain/predictions.csv"), deep.manifest, deep.sensor)
    assert scored["valid"].any()
    assert over_bound(scored, pd.concat(bounds_of(mapped, deep, Archive(1)))) == {}


def test_every_figure_has_a_text_that_says_it_and_its_unit(report: Path) -> None:
    page = Page(report.read_text(encoding="utf-8"))
    assert len(page.alts) > 12
    assert all(len(alt) > 40 for alt in page.alts)
    assert len(set(page.alts)) == len(page.alts)
    captions = " ".join(page.alts)
    for word in (
        "direction of motion",
        "where the contact is",
        "share of the stroke",
        "90 % interval",
        "(deg)",
        "(mm)",
    ):
        assert word in captions


def test_the_report_says_where_the_recordings_are_from(bundle: Path, report: Path, tmp_path: Path) -> None:
    assert "Origin not said" in Page(report.read_text(encoding="utf-8")).words
    a_folder(tmp_path / "lab", one={})
    path = tmp_path / "lab/sensor.toml"
    path.write_text('origin = "measured"\n' + path.read_text())
    assert "Measured recordings" in report_of(bundle, tmp_path / "lab", tmp_path / "out").words


def test_errors_of_zero_are_drawn_inside_the_axes() -> None:
    """On a logarithmic axis alone they would vanish."""
    errors = np.array([0.0, 0.0, 0.03, 2.0])
    ax = Figure().add_subplot()
    (line,) = ax.plot(np.arange(4.0), errors, "o")
    log_about_zero(ax.yaxis, errors)
    height = ax.transData.transform(line.get_xydata())[:, 1]
    low, high = ax.bbox.y0, ax.bbox.y1
    assert np.isfinite(height).all()
    assert (height > low).all()
    assert (height < high).all()
    assert height[0] < height[2] < height[3]


def test_the_interval_of_a_share_is_wilsons() -> None:
    """The roots of |p - share| = z sqrt(p (1 - p) / n), z of a two-sided 90 % interval."""
    for share, count in ((0.9, 8), (1.0, 5), (0.4, 30)):
        for bound in figures.wilson(share, count):
            assert abs(bound - share) == pytest.approx(1.645 * np.sqrt(bound * (1 - bound) / count), abs=1e-9)


def test_a_figure_in_a_page_takes_the_pages_colours() -> None:
    def draw(ax: Axes) -> None:
        ax.plot([0, 1], color=COLOURS[1])
        ax.set_title("title")

    text = drawn('of "this" & that', draw, 3.0).svg
    assert "var(--series-1)" in text
    assert "var(--ink)" in text
    assert not re.search("|".join([*COLOURS, INK]), text)
    assert 'aria-label="of &quot;this&quot; &amp; that"' in text


def test_the_report_lists_its_sections(report: Path) -> None:
    text = report.read_text(encoding="utf-8")
    titles = dict(re.findall(r'<h2 id="(section-\d+)">(.*?)</h2>', text))
    assert len(titles) > 3
    assert titles == dict(re.findall(r'<li><a href="#(section-\d+)">(.*?)</a></li>', text))
