"""The health report finds what is injected, names it, and stays silent on what is sound."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import softslide
from softslide.pipeline.checks.findings import Finding
from softslide.pipeline.checks.report import checked
from softslide.pipeline.recordings.folder import SAMPLE, Folder, Recording, read_folder, write_folder

BENCH = Path(__file__).parents[1].parent / "shared" / "recordings"
Change = Callable[[Recording, pd.Series], None]


@pytest.fixture(scope="module")
def sound() -> tuple[Folder, list[Recording]]:
    """The ten shortest slides of the sample, of all directions."""
    sample = read_folder(SAMPLE)
    chosen = replace(sample, manifest=sample.manifest.sort_values("motion_end_s")[:10])
    return chosen, [chosen.load(str(name)) for name in chosen.manifest.index]


def injured(sound, tmp_path: Path, change: Change, only: int | None = None) -> list[Finding]:
    """The findings after `change` has had its way with the volts and labels of one slide, or of all."""
    folder, recordings = sound
    copies, rows = [], []
    for n, recording in enumerate(recordings):
        copy = Recording(recording.name, recording.time_s.copy(), recording.volts.copy())
        row = folder.manifest.loc[recording.name].copy()
        if only is None or n == only:
            change(copy, row)
        copies.append(copy)
        rows.append(row)
    manifest = pd.DataFrame(rows, index=folder.manifest.index)
    return checked(write_folder(tmp_path / "lab", folder.sensor, manifest, copies)).findings


def volts_changed(function: Callable[[np.ndarray], np.ndarray], channels: object = slice(None)) -> Change:
    def change(recording: Recording, row: pd.Series) -> None:
        recording.volts[:, channels] = function(recording.volts[:, channels])

    return change


def untouched(volts: np.ndarray) -> np.ndarray:
    """As at rest, with white noise of the board's size."""
    return volts[:500].mean(axis=0) + np.random.default_rng(3).normal(0, 0.006, volts.shape)


def wired_wrong_way(n: int) -> Change:
    return volts_changed(lambda v: 3.3 - v, n)


def labels_changed(**labels) -> Change:
    def change(recording: Recording, row: pd.Series) -> None:
        for name, value in labels.items():
            row[name] = value(row) if callable(value) else value

    return change


BACKWARD = {"direction_deg": lambda r: (r.direction_deg + 180) % 360}
PLACES = ("offset_mm", "start_x_mm", "start_y_mm")
MIRRORED = {name: lambda r, name=name: -r[name] for name in PLACES}


def with_tone(volts: np.ndarray, hz: float, amplitude_v: float) -> np.ndarray:
    return volts + amplitude_v * np.sin(2 * np.pi * hz * np.arange(len(volts)) / 1000)[:, None]


def jittering(recording: Recording, row: pd.Series) -> None:
    recording.time_s[:] += np.random.default_rng(0).uniform(0, 2e-4, len(recording.time_s))


def quiet(volts: np.ndarray) -> np.ndarray:
    kernel = np.ones(100) / 100
    return np.column_stack([np.convolve(column, kernel, "same") for column in volts.T])


@pytest.mark.parametrize(
    ("function", "channel"),
    [
        (lambda v: np.clip(v, None, v.max(axis=0) - 0.4 * np.ptp(v, axis=0)), "a0_vx"),
        (lambda v: np.clip(v, v.min(axis=0) + 0.3 * np.ptp(v, axis=0), None), "a0_vz"),
    ],
)
def test_a_clipped_output_is_found(sound, tmp_path: Path, function, channel: str) -> None:
    findings = injured(sound, tmp_path, volts_changed(function), only=3)
    assert channel in {f.channel for f in findings if f.kind == "clipped" and f.recording == sound[1][3].name}


@pytest.mark.parametrize(
    ("change", "kind", "channel"),
    [
        (wired_wrong_way(0), "inverted", "a0_vx"),
        (wired_wrong_way(1), "inverted", "a0_vy"),
        (wired_wrong_way(2), "inverted", "a0_vz"),
        (volts_changed(lambda v: v[:, [1, 0, 2]]), "swapped", "a0_vx"),
        (volts_changed(lambda v: v[:, [2, 1, 0]]), "swapped", "a0_vx"),
        (volts_changed(lambda v: np.full_like(v, 1.65), 1), "dead", "a0_vy"),
        (
            volts_changed(lambda v: np.random.default_rng(len(v)).normal(1.65, 0.006, len(v)), 0),
            "dead",
            "a0_vx",
        ),
    ],
)
def test_a_wrong_wire_is_found(sound, tmp_path: Path, change: Change, kind: str, channel: str) -> None:
    errors = [f for f in injured(sound, tmp_path, change) if f.level == "error"]
    assert (kind, channel) in {(f.kind, f.channel) for f in errors}
    assert "label against signal" not in {f.kind for f in errors}


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (labels_changed(**BACKWARD), "label against signal"),
        (labels_changed(**BACKWARD, **MIRRORED), "label against signal"),
        (labels_changed(offset_mm=lambda r: -r.offset_mm), "labels"),
        (labels_changed(speed_mm_s=lambda r: 2 * r.speed_mm_s), "labels"),
        (labels_changed(motion_start_s=0.2), "no rest"),
        (volts_changed(lambda v: with_tone(v, 50.0, 0.02)), "mains"),
        (volts_changed(lambda v: with_tone(v, 60.0, 0.02)), "mains"),
        (volts_changed(lambda v: with_tone(v, 137.0, 0.02)), "tone"),
        (volts_changed(lambda v: v + np.linspace(0, 0.08, len(v))[:, None]), "drift"),
        (volts_changed(lambda v: v + np.random.default_rng(0).normal(0, 0.03, v.shape)), "noise"),
        (volts_changed(quiet), "noise"),
        (volts_changed(lambda v: v * 0.5), "gravity"),
        (volts_changed(lambda v: np.concatenate([v[:500]] * 200)[: len(v)]), "made up"),
        (volts_changed(lambda v: v[:, [1, 0, 2]]), "swapped"),
        (jittering, "clock"),
        (volts_changed(untouched), "no contact"),
    ],
)
def test_an_injury_of_one_slide_is_found_there(sound, tmp_path: Path, change: Change, kind: str) -> None:
    folder, recordings = sound
    # A slide off the sensor's axis, so that a change of its sign shows.
    row = folder.manifest.reset_index()
    only = int(row[(row.offset_mm.abs() > 5) & (row.direction_deg % 90 == 0)].index[0])
    findings = [f for f in injured(sound, tmp_path, change, only) if f.recording]
    assert (kind, recordings[only].name) in {(f.kind, f.recording) for f in findings}
    assert {f.recording for f in findings if f.level == "error"} <= {recordings[only].name}


@pytest.mark.parametrize(
    ("share", "far", "found"),
    [(0.3, False, False), (0.8, False, True), (0.02, True, False), (0.3, True, True)],
)
def test_the_wrong_sign_of_an_output_shows_another_slide_unless_it_is_small(
    sound, tmp_path: Path, share: float, far: bool, found: bool
) -> None:
    """Next to a board that is off the chamber's centre a small output may have it, and so may what is left near a board
    of an output that is large elsewhere."""

    def inverted(recording: Recording, row: pd.Series) -> None:
        rest_v = recording.volts[:400, :2].mean(axis=0)
        x, y = (recording.volts[:, :2] - rest_v).T
        recording.volts[:, 0] = rest_v[0] - share * np.ptp(y) / np.ptp(x) * x
        # Farther from the board than is compared.
        along = (recording.time_s - row["motion_start_s"]) * row["speed_mm_s"] / row["travel_mm"]
        recording.volts[(along > 0.0) & (along < 0.1), 0] += far * np.ptp(y)

    labels = sound[0].manifest.reset_index()
    only = int(labels.index[labels["direction_deg"] == 90.0][0])
    findings = injured(sound, tmp_path, inverted, only)
    channels = {f.channel for f in findings if f.kind == "label against signal"}
    assert channels == ({"a0_vx"} if found else set())


@pytest.mark.parametrize(
    ("creeping", "timed", "found"),
    [
        (slice(None), True, True),
        (slice(-5, None), True, True),
        (slice(-5, None), False, True),
        (slice(5), True, False),
    ],
)
def test_a_zero_that_creeps_is_found_in_the_slides_that_take_longest(
    tmp_path: Path, creeping: slice, timed: bool, found: bool
) -> None:
    """Either way, as a random walk."""
    sample = read_folder(SAMPLE)
    by_time = sample.manifest.sort_values("motion_end_s")
    manifest = pd.concat([by_time[:7], by_time[-5:]])
    if not timed:
        manifest["motion_start_s"] = np.nan
        manifest["travel_mm"] = np.nan  # nor can it be derived
    recordings = [sample.load(str(name)) for name in manifest.index]
    for recording in recordings[creeping]:
        sign = (-1) ** int(recording.name[-1])
        recording.volts[:, 1] += sign * np.linspace(0, 0.003, len(recording.time_s))
    findings = checked(write_folder(tmp_path / "lab", sample.sensor, manifest, recordings)).findings
    assert {f.channel for f in findings if f.kind == "drift"} == ({"a0_vy"} if found else set())


@pytest.mark.parametrize(("step_v", "dead"), [(5e-4, True), (5e-3, False)])
def test_an_output_that_does_not_change_is_dead_unless_the_converter_hides_its_noise(
    sound, tmp_path: Path, step_v: float, dead: bool
) -> None:
    folder, recordings = sound

    def read(n: int, recording: Recording) -> Recording:
        smooth = quiet(np.pad(recording.volts, ((50, 50), (0, 0)), "edge"))[50:-50]
        volts = smooth + np.random.default_rng(n).normal(0, 1e-3, smooth.shape)
        if n == 2:
            volts[:, 1] = volts[0, 1]
        return replace(recording, volts=step_v * np.round(volts / step_v))

    recordings = [read(n, recording) for n, recording in enumerate(recordings)]
    sensor = replace(folder.sensor, adc_step_v=step_v)
    findings = checked(write_folder(tmp_path / "lab", sensor, folder.manifest, recordings)).findings
    expected = {(recordings[2].name, "a0_vy")} if dead else set()
    assert {(f.recording, f.channel) for f in findings if f.kind == "dead"} == expected
    assert "clipped" not in {f.kind for f in findings}


def test_an_object_that_stays_on_the_skin_is_no_drift(sound, tmp_path: Path) -> None:
    def stopping(recording: Recording, row: pd.Series) -> None:
        whole_s = row["motion_end_s"] - row["motion_start_s"]
        row["motion_end_s"], row["travel_mm"] = row["motion_start_s"] + 0.6 * whole_s, 0.6 * row["travel_mm"]
        after = recording.time_s > row["motion_end_s"]
        noise = recording.volts[: after.sum()] - recording.volts[: after.sum()].mean(axis=0)
        recording.volts[after] = recording.volts[~after][-100:].mean(axis=0) + noise

    assert "drift" not in {finding.kind for finding in injured(sound, tmp_path, stopping)}


def test_a_copy_is_found_wherever_it_begins(sound, tmp_path: Path) -> None:
    folder, recordings = sound
    first, second = recordings[0], recordings[1]

    def copied(recording: Recording, row: pd.Series) -> None:
        recording.volts[200 : 200 + len(first.volts)] = first.volts[: len(recording.volts) - 200]

    findings = injured(sound, tmp_path, copied, only=1)
    assert second.name in {f.recording for f in findings if f.kind == "duplicate"}

    twins = [first, Recording("twin", first.time_s, first.volts)]
    manifest = folder.manifest.loc[[first.name, first.name]].set_axis([first.name, "twin"])
    findings = checked(write_folder(tmp_path / "twins", folder.sensor, manifest, twins)).findings
    assert [(f.kind, f.recording) for f in findings if f.level == "error"] == [("duplicate", "twin")]


def test_a_generator_with_one_seed_is_found(sound, tmp_path: Path) -> None:
    noise = lambda v: quiet(v) + np.random.default_rng(1).normal(0, 0.006, v.shape)  # noqa: E731
    findings = injured(sound, tmp_path, volts_changed(noise))
    assert len({f.recording for f in findings if f.kind == "made up" and f.level == "error"}) == 9


@pytest.mark.parametrize(("from_start", "found"), [(True, True), (False, False)])
def test_two_outputs_with_one_noise_are_found_unless_the_contact_shakes_both(
    sound, tmp_path: Path, from_start: bool, found: bool
) -> None:
    def shaken(recording: Recording, row: pd.Series) -> None:
        begin = 0 if from_start else row["motion_start_s"]
        noise = np.random.default_rng(1).normal(0, 0.03, len(recording.volts))
        recording.volts[:, :2] += (noise * (recording.time_s >= begin))[:, None]

    channels = {f.channel for f in injured(sound, tmp_path, shaken, 0) if "another output" in f.text}
    assert channels == ({"a0_vx", "a0_vy"} if found else set())


def test_equal_variances_are_found_and_real_ones_pass(sound, tmp_path: Path) -> None:
    def real(recording: Recording, row: pd.Series) -> None:
        noise = recording.volts - quiet(recording.volts)
        recording.volts[:] += noise * [0.0, 0.1, 0.2]

    def equal(findings: list[Finding]) -> bool:
        return any(f.kind == "made up" and not f.recording for f in findings)

    # The bench is emulated: the report says so.
    assert equal(checked(sound[0]).findings)
    assert not equal(injured(sound, tmp_path, real))


def test_a_line_of_both_calibration_and_test_is_found(sound, tmp_path: Path) -> None:
    split = iter(["calibration", "test"] * 5)
    one_line = labels_changed(split=lambda r: next(split), offset_mm=2.5, direction_deg=0.0)
    findings = injured(sound, tmp_path, one_line)
    assert len([f for f in findings if f.kind == "leakage"]) == 5


def test_unlabelled_slides_are_judged_by_their_signal_alone(sound, tmp_path: Path) -> None:
    def bare(recording: Recording, row: pd.Series) -> None:
        row[row.index.difference(["file", "split"])] = np.nan

    assert [f for f in injured(sound, tmp_path, bare) if f.recording] == []


def test_the_report_is_json_and_errors_exit_with_2(sound, tmp_path: Path, capsys) -> None:
    assert softslide.main(["check", str(SAMPLE), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["recordings"] == 60
    assert report["errors"] == 0
    assert report["warnings"] == len(report["findings"])
    assert {"level", "kind", "recording", "channel", "figure", "limit", "text"} == set(report["findings"][0])
    injured(sound, tmp_path, wired_wrong_way(1))
    assert softslide.main(["check", str(tmp_path / "lab")]) == 2
    out, err = capsys.readouterr()
    assert "error: inverted: a0_vy" in out
    assert err.count("\n") == 1
    assert "a0_vy" in err


@pytest.mark.parametrize("bench", ["bench-a", "bench-d"])
@pytest.mark.skipif(not BENCH.is_dir(), reason="the shared recordings are not next to this checkout")
def test_the_bench_recordings_have_no_errors(bench: str) -> None:
    assert [f.line() for f in checked(read_folder(BENCH / bench)).findings if f.level == "error"] == []


@pytest.mark.parametrize("samples", [2, 3, 9, 60, 700])
@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize("constant", [True, False])
def test_short_and_constant_recordings_are_judged(sound, tmp_path: Path, samples, labelled, constant) -> None:
    folder, recordings = sound
    names = list(folder.manifest.index[:2])
    manifest = folder.manifest.loc[names].copy()
    manifest[["motion_start_s", "motion_end_s"]] = [0.0, 0.001] if labelled else np.nan
    cut = [Recording(r.name, r.time_s[:samples], r.volts[:samples]) for r in recordings[:2]]
    if constant:
        cut = [Recording(r.name, r.time_s, np.full_like(r.volts, 1.65)) for r in cut]
    findings = checked(write_folder(tmp_path / "lab", folder.sensor, manifest, cut)).findings
    assert not constant or "dead" in {f.kind for f in findings}
    assert all(np.isfinite([f.figure, f.limit]).all() for f in findings)


@pytest.mark.parametrize("rate_hz", [2.0, 10.0, 50.0, 20_000.0])
def test_any_rate_is_judged(sound, tmp_path: Path, rate_hz: float) -> None:
    sensor = replace(sound[0].sensor, sample_rate_hz=rate_hz)
    count = max(60, int(rate_hz))
    noise = [np.random.default_rng(n).normal([1.65, 1.65, 2.45], 0.006, (count, 3)) for n in range(6)]
    slides = [Recording(f"r{n}", np.arange(count) / rate_hz, volts) for n, volts in enumerate(noise)]
    manifest = pd.DataFrame({"recording": [s.name for s in slides], "split": "calibration"})
    findings = checked(write_folder(tmp_path / "lab", sensor, manifest, slides)).findings
    assert [f for f in findings if f.level == "error"] == []


@pytest.mark.parametrize(
    ("function", "unit"),
    [
        (lambda v: 1000 * v, "mV"),
        (lambda v: (v - 1.65) / 0.8, "g"),
        (lambda v: 9.80665 * (v - 1.65) / 0.8, "m/s2"),
        (lambda v: v / 3.3 * 4096, "counts of 12 bits"),
    ],
)
def test_outputs_in_another_unit_are_one_error_that_names_it(sound, tmp_path, function, unit) -> None:
    findings = injured(sound, tmp_path, volts_changed(function))
    (found,) = [f for f in findings if f.kind == "unit"]
    assert found.level == "error"
    assert f"look like {unit}:" in found.text
    assert not {"gravity", "noise", "mains", "drift"} & {f.kind for f in findings}


@pytest.mark.parametrize(("factor", "unit"), [(0.1, "cm/s"), (0.001, "m/s"), (60.0, "mm/min")])
def test_speeds_in_another_unit_are_one_error_that_names_it(sound, tmp_path, factor, unit) -> None:
    change = labels_changed(speed_mm_s=lambda row: factor * row["speed_mm_s"])
    errors = [f for f in injured(sound, tmp_path, change) if f.level == "error"]
    assert [f.kind for f in errors] == ["speed"]
    assert f"look like {unit}:" in errors[0].text


def test_speeds_that_do_not_cross_the_chamber_are_a_warning(sound, tmp_path: Path) -> None:
    change = labels_changed(speed_mm_s=lambda row: row["speed_mm_s"] / 10, travel_mm=np.nan)
    findings = injured(sound, tmp_path, change)
    assert ["cm/s" in f.text for f in findings if (f.level, f.kind) == ("warning", "speed")] == [True]


def test_every_broken_recording_is_found_in_one_pass(sound, tmp_path: Path, capsys) -> None:
    folder, recordings = sound
    write_folder(tmp_path / "lab", folder.sensor, folder.manifest.iloc[:4], recordings[:4])
    files = [tmp_path / "lab" / "slides" / f"{recording.name}.parquet" for recording in recordings[:3]]
    files[0].unlink()
    files[1].write_bytes(b"PAR1 broken")
    files[2].write_bytes(b"")
    assert softslide.main(["check", str(tmp_path / "lab"), "--json"]) == 2
    report = json.loads(capsys.readouterr().out)
    unreadable = {f["recording"] for f in report["findings"] if f["kind"] == "unreadable"}
    assert unreadable == {file.stem for file in files}
    assert report["recordings"] == 4


@pytest.mark.parametrize("name", ["sensor.toml", "manifest.csv"])
def test_json_is_printed_of_a_folder_that_cannot_be_read(sound, tmp_path: Path, capsys, name: str) -> None:
    folder, recordings = sound
    write_folder(tmp_path / "lab", folder.sensor, folder.manifest.iloc[:1], recordings[:1])
    (tmp_path / "lab" / name).write_bytes(b"\xff\xfe")
    assert softslide.main(["check", str(tmp_path / "lab"), "--json"]) == 2
    out, err = capsys.readouterr()
    assert [f["kind"] for f in json.loads(out)["findings"]] == ["unreadable"]
    assert len(err.splitlines()) == 1
