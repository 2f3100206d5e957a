"""docs/hardware.md: the firmware compiles and its lines are samples; so are those of the NI script."""

import runpy
import shutil
import socket
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from softslide.serve.stream.framing import framing_of

HARDWARE = Path(__file__).parents[1] / "docs" / "hardware"
# What the firmware uses of a board: a clock that each call moves on, a converter of 12 bits whose inputs hold a
# voltage each, a port that is standard output. Declarations follow the Arduino reference.
BOARD = """
#include <cstdint>
#include <cstdio>
#include <cstring>
const int A0 = 14, A1 = 15, A2 = 16;
static uint32_t now_us = 4294000000U;  // overflows after a second
static int bits = 10;
unsigned long micros() { return now_us += 3; }
void analogReadResolution(int wanted) { bits = wanted; }
int analogRead(int pin) { now_us += LATE_US; return (int)((pin - 13) * 0.75 / 3.3 * (1 << bits)); }
struct {
  void begin(unsigned long) {}
  void println(const char *line) { std::puts(line); }
  void write(const uint8_t *data, size_t size) { std::fwrite(data, 1, size, stdout); }
} Serial;
#include "stream.ino"
int main() {
  setup();
  for (long n = 0; n < 2000000 && sample < 3000; n++) loop();
  std::fprintf(stderr, "%lu", (unsigned long)(now_us - begun_us));
}
"""


def run_firmware(folder: Path, late_us: int, form: str = "csv", clock: str = "1.0") -> tuple[bytes, int]:
    """Its output over three seconds of a board whose converter takes `late_us`, and how long that was by its clock, us.

    clock: true seconds in a second of it.
    """
    (folder / "board.cpp").write_text(BOARD)
    sketch = (HARDWARE / "stream.ino").read_text()
    for name, value in (
        ("FRAMES = false", f"FRAMES = {str(form == 'cobs').lower()}"),
        ("CLOCK = 1.0", f"CLOCK = {clock}"),
    ):
        assert name in sketch
        sketch = sketch.replace(name, value)
    (folder / "stream.ino").write_text(sketch)
    compiler = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", f"-DLATE_US={late_us}"]
    subprocess.run([*compiler, "-o", str(folder / "board"), str(folder / "board.cpp")], check=True)
    ran = subprocess.run([str(folder / "board")], capture_output=True, check=True, timeout=60)
    return ran.stdout, int(ran.stderr)


@pytest.mark.skipif(shutil.which("g++") is None, reason="no compiler for the host")
@pytest.mark.parametrize("form", ["csv", "cobs"])
def test_the_firmware_sends_samples_at_its_rate(tmp_path: Path, form: str) -> None:
    sent, _ = run_firmware(tmp_path, 10, form)
    chunks = list(framing_of(form, 3).read(sent))
    volts = np.concatenate([volts for volts, _ in chunks])
    time_s = np.concatenate([time_s for _, time_s in chunks if time_s is not None])
    assert len(volts) == len(time_s) == 3000
    assert np.allclose(np.diff(time_s), 1e-3, atol=1e-9)
    assert np.allclose(volts, [0.75, 1.5, 2.25], atol=3.3 / 4096)


@pytest.mark.skipif(shutil.which("g++") is None, reason="no compiler for the host")
def test_samples_that_the_firmware_could_not_take_leave_gaps_in_its_times(tmp_path: Path) -> None:
    # 24 readings of 100 us take 2.4 ms of each 1 ms.
    sent, _ = run_firmware(tmp_path, late_us=100)
    chunks = list(framing_of("csv", 3).read(sent))
    time_s = np.concatenate([time_s for _, time_s in chunks if time_s is not None])
    assert np.diff(time_s).max() >= 2e-3
    assert time_s[-1] == pytest.approx(3.0, abs=0.01)


@pytest.mark.skipif(shutil.which("g++") is None, reason="no compiler for the host")
@pytest.mark.parametrize("clock", [0.99, 1.0, 1.01])
def test_a_clock_that_is_off_is_corrected(tmp_path: Path, clock: float) -> None:
    """A board whose second lasts 1.01 s counts 2.97 of them in the three seconds of its 3000 samples."""
    sent, elapsed_us = run_firmware(tmp_path, 10, clock=f"{clock}")
    (time_s,) = (t[-1:] for _, t in list(framing_of("csv", 3).read(sent))[-1:] if t is not None)
    assert time_s[0] == pytest.approx(2.999)
    assert elapsed_us * 1e-6 == pytest.approx(3.0 / clock, abs=0.002)


def test_the_ni_script_sends_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """The driver runs on a computer with the device alone; here its calls are declared and give a known signal."""
    calls: list[str] = []

    class Task:
        def __enter__(self) -> "Task":
            self.ai_channels = self.timing = self
            return self

        def __exit__(self, *error: object) -> None: ...

        def add_ai_voltage_chan(
            self, name: str, terminal_config: str, min_val: float, max_val: float
        ) -> None:
            calls.append(name)

        def cfg_samp_clk_timing(self, rate: float, sample_mode: str, samps_per_chan: int) -> None:
            calls.append(f"{rate}")

        def read(self, number_of_samples_per_channel: int) -> list[list[float]]:
            if len(calls) > 5:
                raise KeyboardInterrupt
            calls.append("read")
            return [[volts] * number_of_samples_per_channel for volts in (1.6, 1.7, 2.4)]

    nidaqmx, constants = types.ModuleType("nidaqmx"), types.ModuleType("nidaqmx.constants")
    vars(nidaqmx)["Task"] = Task
    vars(constants).update(
        AcquisitionType=types.SimpleNamespace(CONTINUOUS=0),
        TerminalConfiguration=types.SimpleNamespace(RSE=0),
    )
    monkeypatch.setitem(sys.modules, "nidaqmx", nidaqmx)
    monkeypatch.setitem(sys.modules, "nidaqmx.constants", constants)
    with socket.socket(type=socket.SOCK_DGRAM) as ear:
        try:
            ear.bind(("127.0.0.1", 9000))
        except OSError:
            pytest.skip("port 9000 is in use")
        ear.settimeout(10)
        with pytest.raises(KeyboardInterrupt):
            runpy.run_path(str(HARDWARE / "nidaq.py"))
        data = b"".join(ear.recv(1 << 16) for _ in range(4))
    chunks = list(framing_of("csv", 3).read(data))
    time_s = np.concatenate([time_s for _, time_s in chunks if time_s is not None])
    assert calls[:2] == ["Dev1/ai0:2", "1000"]
    assert np.allclose(time_s, np.arange(80) / 1000)
    assert np.allclose(np.concatenate([volts for volts, _ in chunks]), [1.6, 1.7, 2.4])
