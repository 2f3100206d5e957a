"""`softslide record`: a second process sends; cables are pulled; the folder is whole at any time."""

import io
import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sender import PLAN, SENDER, TIMES, UDP, free_port, sending
from streams import a_sensor

import softslide
from softslide.experiments.acquisition.capture import Level, Listener, Lost, Phases, capture, remarks
from softslide.experiments.acquisition.record import read_plan
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Recording, read_folder
from softslide.pipeline.recordings.growing_folder import add_recording, open_growing
from softslide.pipeline.sensor import Base, write_sensor
from softslide.serve.stream.framing import Chunk

RATE_HZ = 1000.0


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A sensor.toml and a plan of three short slides."""
    write_sensor(tmp_path / "sensor.toml", a_sensor())
    (tmp_path / "plan.csv").write_text(
        f"{PLAN}"
        "one,calibration,0,40,-5,-29,-5,8,0.5\n"
        "two,calibration,90,40,0,0,-29,8,0.5\n"
        "three,test,180,40,-5,29,5,8,0.5\n"
    )
    return tmp_path


def words(lab: Path, source: str, *more: str) -> list[str]:
    files = {"--plan": "plan.csv", "--sensor": "sensor.toml", "--out": "out"}
    options = [word for name, file in files.items() for word in (name, str(lab / file))]
    return ["record", "--source", source, *options, *TIMES, *more]


def started(lab: Path, source: str, *more: str, **options: Any) -> subprocess.Popen[str]:
    command, pipe = [sys.executable, "-m", "softslide", *words(lab, source, *more)], subprocess.PIPE
    return subprocess.Popen(command, stderr=pipe, stdout=pipe, text=True, **options)


def until(running: subprocess.Popen[str], text: str) -> list[str]:
    """Reads what it says up to a line with this text."""
    assert running.stderr is not None
    said: list[str] = []
    while not said or text not in said[-1]:
        said.append(running.stderr.readline())
        assert said[-1], said
    return said


def test_a_second_process_sends_and_the_folder_passes_the_check(
    lab: Path, capsys: pytest.CaptureFixture
) -> None:
    port = free_port()
    with sending(port):
        assert softslide.main(words(lab, f"udp://:{port}", "--yes")) == 0
    assert capsys.readouterr().out == f"{lab / 'out'}: 3 recordings\n"
    folder = read_folder(lab / "out")
    assert list(folder.manifest.index) == ["one", "two", "three"]
    assert list(folder.manifest["split"]) == ["calibration", "calibration", "test"]
    assert folder.manifest["motion_start_s"].isna().all()
    for name in folder.manifest.index:
        recording = folder.load(name)
        # Rest twice, the time to start in, way over speed, and the ramps.
        assert recording.time_s[-1] == pytest.approx(0.6 + 0.2 + 0.2 + 1.0 + 0.6 - 1 / RATE_HZ, abs=1e-9)
        assert recording.time_s[0] == 0.0
    # The play is no skin: what is asked here is that the folder itself is in order.
    assert softslide.main(["check", str(lab / "out"), "--json"]) == 0
    assert '"errors": 0' in capsys.readouterr().out


def test_answers_skip_repeat_and_stop_and_a_second_run_goes_on(
    lab: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    port = free_port()
    with sending(port):
        answers = "\na\n\n\ns\nq\n"  # one: record, again, record, keep; two: skip; three: stop
        monkeypatch.setattr(sys, "stdin", io.StringIO(answers))
        assert softslide.main(words(lab, f"udp://:{port}")) == 0
        first = capsys.readouterr()
        assert first.out == f"{lab / 'out'}: 1 recordings, 2 of the plan are left\n"
        assert first.err.count("Keep it?") == 2
        kept = (lab / "out" / "slides" / "one.parquet").read_bytes()
        assert softslide.main(words(lab, f"udp://:{port}", "--yes")) == 0
    assert "1 of 3 slides are recorded" in capsys.readouterr().err
    assert list(read_folder(lab / "out").manifest.index) == ["one", "two", "three"]
    assert (lab / "out" / "slides" / "one.parquet").read_bytes() == kept


def test_a_source_that_falls_silent_in_a_slide_is_waited_for(lab: Path) -> None:
    port = free_port()
    with started(lab, f"udp://:{port}", "--yes") as running:
        with sending(port):
            until(running, "[2/3]")
            until(running, "rest: hands off")
        until(running, "two is not kept: nothing has come for 0.5 s")
        until(running, "waiting for")
        assert list(read_folder(lab / "out").manifest.index) == ["one"]
        with sending(port, seed=1):
            out, _ = running.communicate(timeout=240)
    assert running.returncode == 0
    assert "3 recordings" in out
    assert len(read_folder(lab / "out")) == 3


def test_a_source_that_stays_away_is_an_error_and_what_is_recorded_stays(lab: Path) -> None:
    port = free_port()
    with started(lab, f"udp://:{port}", "--yes", "--wait", "1") as running:
        with sending(port):
            until(running, "[2/3]")
        _, error = running.communicate(timeout=240)
    assert running.returncode == 2
    assert "run the same command to go on" in error.splitlines()[-1]
    assert list(read_folder(lab / "out").manifest.index) == ["one"]


class Cable:
    """A pseudo-terminal behind a link, as a serial adapter behind /dev/serial/by-id; sends until it is pulled."""

    def __init__(self, link: Path, seed: int) -> None:
        self._link, self._seed = link, seed
        self._ours, self._theirs = pty.openpty()
        os.set_blocking(self._ours, False)
        link.symlink_to(os.ttyname(self._theirs))
        self._halt = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        space: dict = {}
        exec(SENDER, space)
        # A port is joined in the middle of a line.
        os.write(self._ours, b".65,2.45\n")
        for data in space["lines"](seed=self._seed):
            if self._halt.is_set():
                return
            # What nobody reads is lost, as on a wire.
            with suppress(BlockingIOError):
                os.write(self._ours, data)

    def pull(self) -> None:
        self._halt.set()
        self._thread.join()
        self._link.unlink()
        os.close(self._theirs)
        os.close(self._ours)


def test_a_serial_cable_pulled_in_mid_slide_costs_that_slide_alone(lab: Path) -> None:
    pytest.importorskip("serial")
    link = lab / "port"
    cable = Cable(link, seed=0)
    with started(lab, f"serial://{link}?115200", "--yes") as running:
        try:
            until(running, "[2/3]")
            until(running, "rest: hands off")
        finally:
            cable.pull()
        said = until(running, "waiting for")
        time.sleep(0.7)
        cable = Cable(link, seed=1)
        try:
            out, _ = running.communicate(timeout=240)
        finally:
            cable.pull()
    assert any("two is not kept" in line for line in said)
    assert running.returncode == 0
    assert "3 recordings" in out
    assert len(read_folder(lab / "out")) == 3


def test_an_interrupted_run_leaves_a_whole_folder(lab: Path) -> None:
    port = free_port()
    # What is started in the background is deaf to Ctrl-C, and hands that on.
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with sending(port), started(lab, f"udp://:{port}", "--yes", preexec_fn=heard) as running:
        until(running, "[2/3]")
        running.send_signal(signal.SIGINT)
        assert running.wait(120) == 130
    assert list(read_folder(lab / "out").manifest.index) == ["one"]
    assert not list((lab / "out").rglob("*.partial"))


def test_lost_samples_are_found_by_the_rate(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port = free_port()
    # At this rate without times three samples of ten are missing.
    slow = UDP.replace("lines(seed", "lines(rate_hz=700, seed").replace('f"{n / rate_hz:.4f}," + ', "")
    with subprocess.Popen([sys.executable, "-c", slow, str(port), "0", "3"]) as sender:
        status = softslide.main(words(lab, f"udp://:{port}", "--yes"))
        sender.kill()
    assert status == 1
    error = capsys.readouterr().err
    assert "failed 3 times" in error.splitlines()[-1]
    assert "1000 Hz" in error
    assert not (lab / "out" / "manifest.csv").exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--source", "slide.csv"],
        ["--source", "-"],
        ["--source", "udp://:9", "--rest", "0"],
        ["--source", "udp://:9", "--wait", "-1"],
    ],
    ids=str,
)
def test_bad_usage_is_an_error_of_one_line(
    lab: Path, options: list[str], capsys: pytest.CaptureFixture
) -> None:
    given = ["--plan", str(lab / "plan.csv"), "--sensor", str(lab / "sensor.toml"), "--out", str(lab / "out")]
    assert softslide.main(["record", *options, *given]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"softslide record: {options[-2]}")


def test_a_plan_says_what_a_stage_needs(lab: Path) -> None:
    plan, head = lab / "plan.csv", "direction_deg,speed_mm_s,start_x_mm,start_y_mm,travel_mm\n"
    plan.write_text(f"{head}0,2,-29,0,58\n90,2,0,-29,58\n")
    read = read_plan(plan, a_sensor())
    assert list(read.index) == ["p01", "p02"]
    assert set(read["split"]) == {"calibration"}
    for rows, says in (
        ("0,2,-29,0,58\n90,,0,-29,58\n", r"row 2 \(p02\), speed_mm_s is empty"),
        ("400,2,-29,0,58\n", r"row 1 \(p01\), direction_deg"),
    ):
        plan.write_text(head + rows)
        with pytest.raises(InputError, match=says):
            read_plan(plan, a_sensor())


def a_recording(name: str, seconds: float = 2.0) -> Recording:
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    volts = np.random.default_rng(len(name)).normal(1.65, 0.005, (len(time_s), 3))
    return Recording(name, time_s, volts)


def test_a_folder_grows_by_whole_recordings(tmp_path: Path) -> None:
    folder = open_growing(tmp_path / "f", a_sensor())
    assert len(folder) == 0
    folder = add_recording(folder, a_recording("a"), {"split": "calibration", "direction_deg": 90.0})
    folder = add_recording(folder, a_recording("bb"), {"split": "test"})
    again = open_growing(tmp_path / "f", None)
    assert list(again.manifest.index) == ["a", "bb"]
    assert again.manifest.at["a", "direction_deg"] == 90.0
    assert np.array_equal(again.load("bb").volts, a_recording("bb").volts)
    # A name that is there already, or a label that cannot be, changes nothing.
    before = {path: path.read_bytes() for path in (tmp_path / "f").rglob("*") if path.is_file()}
    for name, labels in (("a", {"split": "test"}), ("c", {"split": "test", "direction_deg": 400.0})):
        with pytest.raises(InputError):
            add_recording(again, a_recording(name), labels)
    assert {path: path.read_bytes() for path in (tmp_path / "f").rglob("*") if path.is_file()} == before


def test_a_folder_of_another_sensor_is_not_gone_on_with(tmp_path: Path) -> None:
    folder = open_growing(tmp_path / "f", a_sensor())
    with pytest.raises(InputError, match="another sensor"):
        open_growing(tmp_path / "f", a_sensor(2))
    add_recording(folder, a_recording("a"), {"split": "test"})
    with pytest.raises(InputError, match="another sensor"):
        open_growing(tmp_path / "f", a_sensor(2))
    with pytest.raises(InputError, match="sensor give the"):
        open_growing(tmp_path / "new", None)


def test_the_operator_is_shown_what_looks_wrong() -> None:
    phases = Phases(0.5, 0.2, 0.8)
    time_s = np.arange(2000) / RATE_HZ
    noise = np.random.default_rng(3).normal(0.0, 0.002, (2000, 3))
    bump = np.where((time_s > 0.8) & (time_s < 1.3), 0.1, 0.0)[:, None]

    def shown(volts: np.ndarray) -> str:
        return "\n".join(remarks(Recording("x", time_s, volts), a_sensor(), phases)[1:])

    assert shown(1.65 + bump + noise) == ""
    assert "no contact" in shown(1.65 + noise)
    assert "does not come back" in shown(1.65 + noise + np.where(time_s > 0.8, 0.1, 0.0)[:, None])
    dead = 1.65 + bump + noise
    dead[:, 1] = 1.65
    assert "a0_vy does not change" in shown(dead)
    assert "a0_vx is clipped" in shown(np.minimum(1.65 + bump + noise, [1.7, 9.0, 9.0]))


def test_a_sample_that_is_no_number_costs_the_slide_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As lost packets leave it; the level goes on without it."""

    def chunks(name: str, columns: int, form: str) -> Iterator[Chunk]:
        for n in range(1000):
            time.sleep(0.02)
            yield np.full((20, columns), 1.65 if n < 20 else np.nan), 0.02 * n + np.arange(20) / 1000

    monkeypatch.setattr("softslide.experiments.acquisition.capture.open_live", chunks)
    shown = list[float]()
    listening = closing(Listener("udp://:1", a_sensor(), "csv", 0.5))
    with listening as listener, pytest.raises(Lost, match="no finite number"):
        capture(listener, "one", Phases(0.2, 0.2, 2.0), lambda recorded_s, level_v: shown.append(level_v))
    assert shown
    assert np.isfinite(shown).all()
    level, good = Level(20), (np.full((20, 3), 1.65), None)
    assert level.of([good, (np.full((20, 3), np.nan), None)]) == 0.0
    assert level.of([(np.full((20, 3), 1.75), None)]) == pytest.approx(0.1)


def test_a_robot_that_moves_is_a_row_of_the_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the split `base`: no label is needed, and nobody is asked whether anything touches."""
    sensor = replace(a_sensor(), base=Base())
    write_sensor(tmp_path / "sensor.toml", sensor)
    (tmp_path / "plan.csv").write_text(f"{PLAN}one,calibration,0,40,-5,-29,-5,8,0.5\nmoves,base,,40,,,,8,\n")
    port = free_port()
    with sending(port, columns=6):
        assert softslide.main(words(tmp_path, f"udp://:{port}", "--yes")) == 0
    said = capsys.readouterr().err
    assert "moves: lean the robot over in all directions for 1.2 s, nothing touches" in said
    folder = read_folder(tmp_path / "out")
    assert list(folder.manifest["split"]) == ["calibration", "base"]
    for name in folder.manifest.index:
        recording = folder.load(name)
        assert recording.volts.shape[1] == 3
        assert recording.base_v is not None
        assert recording.base_v[:, 2].mean() == pytest.approx(2.45, abs=0.01)


def test_a_plan_for_a_base_that_the_sensor_has_not_is_refused(tmp_path: Path) -> None:
    (tmp_path / "plan.csv").write_text(f"{PLAN}moves,base,,,,,,,\n")
    with pytest.raises(InputError, match=r"moves is of the split 'base', and sensor\.toml has no \[base\]"):
        read_plan(tmp_path / "plan.csv", a_sensor())
    plan = read_plan(tmp_path / "plan.csv", replace(a_sensor(), base=Base()))
    assert list(plan.index) == ["moves"]
