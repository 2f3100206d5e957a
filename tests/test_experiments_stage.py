"""`softslide record --stage`: a printer moves the ball as planned, and stops when something is wrong."""

import io
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from printer import ORIGIN, Printer
from sender import PLAN, free_port
from streams import a_sensor

import softslide
from softslide.experiments.acquisition import approach
from softslide.experiments.acquisition import record as recording
from softslide.experiments.acquisition import stage as module
from softslide.experiments.acquisition.capture import clock_line
from softslide.experiments.acquisition.driven import drive_in_the_air
from softslide.experiments.acquisition.gcode import CLEAR_MM
from softslide.experiments.acquisition.record import read_plan
from softslide.experiments.acquisition.stage import Stage, check_slides, numbered
from softslide.experiments.acquisition.waypoints import STEP_S, of_path, read_waypoints, write_waypoints
from softslide.features.errors import CheckFailed, InputError
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, read_atlas
from softslide.pipeline.recordings.folder import read_folder
from softslide.pipeline.sensor import write_sensor
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.paths.draw import KINDS
from softslide.pipeline.synthesis.synthesize import path_plan

REST_S = 0.6
ARRIVES_S = 10.0  # what was sent, on a busy machine
TIMES = {"rest_s": REST_S, "start_s": 0.2}
SLIDES = "one,calibration,0,39,-5,-29,-5,58,0.5\ntwo,test,90,39,0,0,-29,58,0.4\n"


@pytest.fixture(autouse=True)
def awake(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAKE_S", 0.05)
    monkeypatch.setattr(module, "DOWN_MM_S", 20.0)


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    write_sensor(tmp_path / "sensor.toml", a_sensor())
    (tmp_path / "plan.csv").write_text(PLAN + SLIDES)
    return tmp_path


@contextmanager
def skin(printer: Printer, touched_v: float = 0.1, late_s: float = 0.0, still: bool = False) -> Iterator[str]:
    """Sends what a sensor would, 1 kHz, that is pressed while the ball is below its height and moves, or is still.

    V_z is when it was sent, by the monotonic clock, a tenth of a volt a second.
    """
    port, ended = free_port(), threading.Event()
    pressed = deque([0.0], maxlen=round(late_s / 0.02) + 1)
    noise = np.random.default_rng(0)

    def send() -> None:
        begun_s, n = time.monotonic(), 0
        with socket.socket(type=socket.SOCK_DGRAM) as mouth:
            while not ended.is_set():
                x, y, z = printer.place - np.array(ORIGIN)
                pressed.append(
                    touched_v * (z < 0 and (printer.moving or still) and max(abs(x), abs(y)) < 28.9)
                )
                on = pressed[0]
                volts = np.array([1.65 + on, 1.65 - on, 2.0]) + noise.normal(0, 1e-3, (20, 3))
                volts[:, 2] = 2.0 + 0.1 * ((begun_s + (n + np.arange(20)) / 1000) % 10.0)
                rows = (
                    f"{(n + k) / 1000:.3f}," + ",".join(f"{v:.4f}" for v in row)
                    for k, row in enumerate(volts)
                )
                n += 20
                time.sleep(max(0.0, begun_s + n / 1000 - time.monotonic()))
                mouth.sendto(("\n".join(rows) + "\n").encode(), ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield f"udp://:{port}"
    finally:
        ended.set()
        thread.join()


def recorded(lab: Path, source: str, printer: Printer, **more: object) -> int:
    """How many slides are left."""
    options = (
        {"sensor": lab / "sensor.toml", "yes": True, "stage": printer.url, "origin_mm": ORIGIN} | TIMES | more
    )
    return softslide.record(source, lab / "plan.csv", lab / "out", **options)[1]


@pytest.mark.parametrize("firmware", ["marlin", "grbl"])
def test_a_plan_is_recorded_with_nobody_there(lab: Path, firmware: str) -> None:
    """Damaged lines are sent again; the motion of each recording begins as its rest ends."""
    with Printer(firmware, damaged=(4, 9)) as printer, skin(printer) as source:
        assert recorded(lab, source, printer) == 0
    assert not printer.stopped.is_set()
    folder = read_folder(lab / "out")
    assert list(folder.manifest.index) == ["one", "two"]
    slides = [move for move in printer.moves if move[0][2] == move[1][2] < ORIGIN[2]]
    for (begin, end, speed), row in zip(slides, folder.manifest.itertuples(), strict=True):
        assert begin - ORIGIN == pytest.approx([row.start_x_mm, row.start_y_mm, -row.depth_mm])
        way = (end - begin)[:2]
        assert np.hypot(*way) == pytest.approx(row.travel_mm, abs=2e-3)
        assert np.degrees(np.arctan2(way[1], way[0])) == pytest.approx(row.direction_deg)
        assert speed == pytest.approx(row.speed_mm_s)
        recording = folder.load(row.Index)
        pressed_s = recording.time_s[recording.volts[:, 0] > 1.7]
        assert row.motion_start_s == pytest.approx(pressed_s[0], abs=BUSY_S)
        assert row.motion_end_s == pytest.approx(pressed_s[-1], abs=BUSY_S)
        assert pressed_s[0] == pytest.approx(REST_S, abs=0.3)
        assert np.ptp(pressed_s) == pytest.approx(row.travel_mm / row.speed_mm_s / printer.haste, abs=0.1)
    # Above the skin between slides, and at the end.
    assert all(
        begin[2] >= ORIGIN[2] + CLEAR_MM
        for begin, end, _ in printer.moves[1:]
        if (begin != end)[:2].any() and begin[2] > ORIGIN[2]
    )
    assert printer.place[2] == ORIGIN[2] + CLEAR_MM


def test_a_dry_run_touches_nothing_and_records_nothing(lab: Path) -> None:
    with Printer(haste=20.0) as printer, skin(printer) as source:
        assert recorded(lab, source, printer, dry_run=True) == 2
    assert min(end[2] for _, end, _ in printer.moves) >= ORIGIN[2] + CLEAR_MM
    assert len(printer.moves) >= 2
    assert not list((lab / "out").glob("slides/*"))


def test_a_dry_run_of_a_press_stays_over_its_place() -> None:
    with Printer(haste=100.0) as printer, Stage(printer.url, ORIGIN) as mover:
        drive_in_the_air(mover, np.array(WAYS["presses"], float))
    assert printer.place == pytest.approx(np.add(ORIGIN, [3.0, 0.0, CLEAR_MM]))
    assert min(end[2] for _, end, _ in printer.moves) >= ORIGIN[2] + CLEAR_MM


BUSY_S = 0.15  # that a thread may wait on a busy machine; 20 ms on an idle one
WAYS = {
    "bends": [(0, -29, 0, 0.5), (1, -5, 3, 0.5), (1.6, 5, 12, 0.2), (2.4, 5, 28.9, 0.5)],
    "rests": [(0, -29, 0, 0.5), (1, 0, 0, 0.5), (1.4, 0, 0, 0.5), (2.4, 0, 28.9, 0.5)],
    "presses": [(0, 3, 0, -8), (0.5, 3, 0, 0.4), (0.9, 3, 0, 0.4), (1.5, 3, 0, -8)],
    "ramps": [(0, -30, 0, 0.5), (2, -16, 0, 0.5), (3, -16, 0, 0.5), (5, -16, 14, 0.5)],
}
# GRBL's machines begin with 10 mm/s2: ramps of 2.5 mm at 7 mm/s.
SLOW = {"haste": 1.0, "acceleration": 10.0}


@pytest.mark.parametrize("firmware", ["marlin", "grbl"])
@pytest.mark.parametrize("way", WAYS)
def test_the_truth_of_a_path_is_where_the_stage_was(lab: Path, firmware: str, way: str) -> None:
    """At each moment, to the way within a packet and a wait, though the stage goes faster than planned, or slowly gains
    its speed."""
    (lab / "sensor.toml").write_bytes(DEFAULT_SENSOR.read_bytes())  # its atlas is at hand
    write_waypoints(lab / "way.csv", np.array(WAYS[way], float))
    (lab / "plan.csv").write_text("recording,split,waypoints\nw,track-way,way.csv\n")
    with (
        Printer(firmware, **(SLOW if way == "ramps" else {"haste": 3.0})) as printer,
        skin(printer) as source,
    ):
        assert recorded(lab, source, printer) == 0
    folder = read_folder(lab / "out")
    recording, row = folder.load("w"), folder.manifest.loc["w"]
    truth = recording.truth
    assert truth is not None
    sent_s = np.unwrap(10 * (recording.volts[:, 2] - 2.0), period=10.0)
    at_s = np.interp(truth["time_s"], recording.time_s, sent_s)
    # V_z leaves out whole tens of seconds.
    at_s += 10 * np.round((printer.log[-1][0] - at_s[-1]) / 10)
    truth, at_s = truth[5:], at_s[5:]  # a packet that was on its way as the ball arrived
    wanted = printer.place_at(at_s) - ORIGIN
    found = truth[["x_mm", "y_mm", "depth_mm"]].to_numpy() * [1, 1, -1]
    fastest = np.abs(np.diff(wanted, axis=0)).max() / 0.01
    assert np.abs(found - wanted).max() < 0.1 + BUSY_S * fastest
    assert np.abs(found - wanted).mean() < 0.1 + 0.2 * BUSY_S * fastest
    inside = np.abs(found[:, :2]).max(axis=1) < 20
    assert truth["contact"].to_numpy()[inside & (found[:, 2] < 0)].all()
    assert not truth["contact"].to_numpy()[np.abs(found[:, :2]).max(axis=1) > 28.5].any()
    moving = truth["time_s"][np.abs(np.diff(found, axis=0, prepend=found[:1])).max(axis=1) > 1e-6]
    assert moving.iloc[0] == pytest.approx(row["motion_start_s"], abs=0.02)
    assert moving.iloc[-1] == pytest.approx(row["motion_end_s"], abs=0.02)


@pytest.mark.parametrize("rate", [1.0, 6.0])
def test_the_clock_of_samples_is_found_through_the_waits_of_a_busy_machine(rate: float) -> None:
    """Polls each 50 ms of packets each 20 ms; for a third of the time the process waits, up to 2 s."""
    random = np.random.default_rng(1)
    for _ in range(20):
        polls = 7e4 + np.cumsum(0.05 + 0.01 * random.random(400))
        waits = (random.random(400) < 0.05) * random.uniform(0, 2, 400)
        newest = np.floor((polls - waits) / 0.02) * 0.02
        newest = np.maximum.accumulate(newest) - 0.001
        line = clock_line(polls, rate * (newest - 7e4))
        assert np.abs(np.polyval(line, polls) - rate * (polls - 7e4)).max() < 0.01 * rate


def test_a_path_without_a_stage_and_broken_waypoints_are_refused(lab: Path) -> None:
    (lab / "plan.csv").write_text("recording,split,waypoints\nw,track-way,way.csv\n")
    good = np.array(WAYS["rests"], float)
    for rows, says in (
        (good, "takes a stage"),
        (good[:1], "at least two"),
        (good + np.array([1, 0, 0, 0]), "the first at time_s 0"),
        (good[[0, 2, 1]], "row 3, time_s does not go on"),
        (good * [1, np.nan, 1, 1], "row 1, a cell is not a finite number"),
    ):
        write_waypoints(lab / "way.csv", rows)
        with pytest.raises(InputError, match=says):
            softslide.record("udp://:1", lab / "plan.csv", lab / "out", sensor=lab / "sensor.toml", yes=True)
    (lab / "way.csv").unlink()
    with pytest.raises(InputError, match="name the file of waypoints"):
        read_plan(lab / "plan.csv", a_sensor())
    for change, says in (
        ((1, 0, 0, 2), "depth 2.5 mm"),
        ((1, 0, 0, -25), "goes up by more than 20 mm"),
        ((1, 50, 0, 0), "leaves the 90 x 90 mm"),
        ((0.01, 0, 0, 0), "a stage is driven at most at 40"),
    ):
        changed = good * np.array([change[0], 1, 1, 1]) + np.array([0, *change[1:]])
        write_waypoints(lab / "way.csv", changed)
        with pytest.raises(InputError, match=says):
            check_slides(read_plan(lab / "plan.csv", a_sensor()), a_sensor())


def test_a_planned_path_goes_through_the_drawn_one(tmp_path: Path) -> None:
    """At every moment to what a ramp or a kink between two waypoints leaves; rests to the moment."""
    distribution, atlas = Distribution(), read_atlas()
    for number in range(len(KINDS)):
        path = path_plan(number, 1, atlas, a_sensor(), distribution)
        write_waypoints(tmp_path / "way.csv", of_path(path))
        way = read_waypoints(tmp_path / "way.csv")
        at_s = np.linspace(0, way[-1, 0], 1000)
        moments = path.at(at_s + path.motion_start_s)
        place = np.column_stack([np.interp(at_s, way[:, 0], column) for column in way[:, 1:].T])
        true = np.column_stack([moments.place_mm, moments.depth_mm])
        off = np.abs(place - true)
        assert off.max() < 0.1 * path.quickest_mm_s * STEP_S + 0.2, path.kind
        assert off.mean() < 0.02, path.kind
        assert way[-1, 0] == pytest.approx(path.motion_end_s - path.motion_start_s, abs=1e-3)


@pytest.mark.parametrize(
    ("printer", "touched_v", "says"),
    [
        (Printer(fails="G28"), 0.1, "'G28' with 'Error:Homing failed'"),
        (Printer("grbl", fails="$H"), 0.1, "'ALARM:9'"),
        (Printer(highest_mm=100.0), 0.1, "see the stage's own limits"),
        (Printer(pulled=6), 0.1, "no answer to"),
        (Printer(), 0.9, "off its rest, more than 0.60 V: the stage was stopped"),
    ],
    ids=["homing", "alarm", "limits", "pulled", "force"],
)
def test_what_goes_wrong_stops_the_stage(
    lab: Path, monkeypatch: pytest.MonkeyPatch, printer: Printer, touched_v: float, says: str
) -> None:
    monkeypatch.setattr(module, "REPLY_S", 0.5)
    monkeypatch.setattr(module, "MOTION_S", 2.0)
    with printer, skin(printer, touched_v) as source:
        with pytest.raises(InputError, match=says):
            recorded(lab, source, printer)
        assert printer.stopped.wait(ARRIVES_S)
        time.sleep(0.2)
        assert not printer.after
    assert not list((lab / "out").glob("slides/*"))


@pytest.mark.parametrize("firmware", ["marlin", "grbl"])
def test_nothing_is_sent_after_a_stop_in_the_middle_of_a_path(lab: Path, firmware: str) -> None:
    """At any moment: the thread that drives ends, too."""
    way = np.column_stack(
        [np.linspace(0, 20, 401), np.linspace(-20, 20, 401), np.zeros(401), np.full(401, 0.5)]
    )
    for after_s in (0.02, 0.11, 0.23):
        with Printer(firmware, haste=1.0) as printer:
            with Stage(printer.url, ORIGIN) as stage:
                stage.place((-20.0, 0.0), 0.5)
                with ThreadPoolExecutor(1) as driver:
                    motion = driver.submit(stage.follow, way)
                    time.sleep(after_s)
                    stage.stop()
                with pytest.raises(InputError, match="the stage was stopped"):
                    motion.result()
                with pytest.raises(InputError, match="the stage was stopped"):
                    stage.send("G1 X0")
            assert printer.stopped.wait(ARRIVES_S)
            time.sleep(0.2)
            assert not printer.after
            assert len(printer.moves) < 100


@pytest.mark.parametrize(
    ("haste", "late_s", "says"),
    [(5.0, 3.0, "its samples come late"), (0.5, 0.0, r"the stage took 1\.[4-9] s longer than planned")],
)
def test_a_slide_whose_samples_or_stage_come_late_is_not_kept(
    lab: Path, monkeypatch: pytest.MonkeyPatch, haste: float, late_s: float, says: str
) -> None:
    """Its contact would lie in the next recording; a stage that limits its own speed gives another slide's labels."""
    monkeypatch.setattr(recording, "ATTEMPTS", 1)
    with Printer(haste=haste) as printer, skin(printer, late_s=late_s) as source:
        with pytest.raises(CheckFailed, match=says):
            recorded(lab, source, printer)
        assert printer.place[2] == ORIGIN[2] + CLEAR_MM
    assert not list((lab / "out").glob("slides/*"))


def test_a_slow_approach_finds_the_height(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\nq\n"))
    above_mm = 0.42
    with Printer() as printer, skin(printer, still=True) as source:
        too_high = (*ORIGIN[:2], ORIGIN[2] + above_mm)
        assert recorded(lab, source, printer, yes=False, origin_mm=too_high, approach_mm=2.0) == 2
        lowest = min(end[2] for _, end, _ in printer.moves[1:])
        assert -2 * approach.STEP_MM < lowest - ORIGIN[2] < 0.0
        assert printer.place[2] - lowest == pytest.approx(CLEAR_MM, abs=1e-6)


def test_an_approach_that_finds_nothing_ends_and_goes_no_deeper(
    lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n"))
    with Printer() as printer, skin(printer) as source:
        high = (*ORIGIN[:2], ORIGIN[2] + 3.0)
        with pytest.raises(InputError, match="no output changes"):
            recorded(lab, source, printer, yes=False, origin_mm=high, approach_mm=0.2)
        assert min(end[2] for _, end, _ in printer.moves[1:]) == pytest.approx(high[2] - 0.2)
        assert printer.stopped.wait(ARRIVES_S)
    wrong = (
        ({"yes": True}, "needs an origin"),
        ({"origin_mm": None}, "needs an origin"),
        ({"approach_mm": 9.0}, "at most 5"),
    )
    for given, says in wrong:
        with pytest.raises(InputError, match=says):
            recorded(lab, "udp://:1", printer, **({"yes": False, "approach_mm": 1.0} | given))


@pytest.mark.parametrize("answers", ["q\n", ""])
def test_an_operator_may_stop_before_anything_moves(
    lab: Path, monkeypatch: pytest.MonkeyPatch, answers: str
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(answers))
    with Printer() as printer, skin(printer) as source:
        assert recorded(lab, source, printer, yes=False, origin_mm=None) == 2
    assert not printer.lines
    assert not printer.stopped.is_set()


def test_what_must_not_be_driven_is_refused(lab: Path) -> None:
    sensor = a_sensor()
    slides = read_plan(lab / "plan.csv", sensor)
    check_slides(slides, sensor)
    for changes, says in (
        ({"depth_mm": 2.1}, "depth 2.1 mm"),
        ({"depth_mm": np.nan}, "depth nan mm"),
        ({"travel_mm": 90.0}, "leaves the 90 x 90 mm"),
        ({"speed_mm_s": 41.0}, "41 mm/s"),
    ):
        with pytest.raises(InputError, match=says):
            check_slides(slides.assign(**changes), sensor)
    for more, says in (
        ({"stage": "udp://:9"}, "write serial:///dev"),
        ({"stage": "serial:///dev/null?firmware=reprap"}, "write serial:///dev"),
        ({"stage": "serial:///dev/no-such"}, "no-such"),
        ({"origin_mm": None, "stage": "serial:///dev/no-such"}, "is needed where nobody is there"),
        ({"stage": None}, "is for a stage"),
        ({"stage": None, "origin_mm": None, "dry_run": True}, "is for a stage"),
    ):
        options = {"sensor": lab / "sensor.toml", "yes": True, "origin_mm": ORIGIN} | more
        with pytest.raises(InputError, match=says):
            softslide.record(f"udp://:{free_port()}", lab / "plan.csv", lab / "out", **options)


def test_a_line_carries_its_number_and_checksum() -> None:
    """Example of Marlin's documentation of its serial protocol (marlinfw.org, "N0 M110")."""
    assert numbered("T0", 3) == "N3 T0*57\n"
    assert numbered("G92 E0", 4) == "N4 G92 E0*67\n"
