"""The live page: frames and viewers, which never delay the stream, and the page in a browser."""

import json
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, expect, sync_playwright
from small_bundle import write_small_bundle
from streams import a_sensor, pass_over, still, stream
from tracked_map import INFLATION, TWO_BOARDS, noisy_map, pressed
from websockets.exceptions import ConnectionClosedOK, InvalidStatus
from websockets.sync.client import ClientConnection, connect

import softslide
from models.response_map.card import contact_calibration
from pipeline.sensor import Accelerometer
from serve.localizer import Localizer

CHROMIUM = shutil.which("chromium")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
)
BOARDS = 2
VOLTS = stream(still(0.6), pass_over(1.0), still(0.4), accelerometers=BOARDS)
REST, SLIDE = VOLTS[:600], VOLTS[600:1400]


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundles") / "two"
    return write_small_bundle(folder, a_sensor(BOARDS), offset_mm_per_v=50.0)


class Serving:
    """`softslide serve` in a process of its own, fed through standard input.

    Its estimates wait in a pipe, unless `unread`: a full pipe stops the stream.
    """

    def __init__(
        self, bundle: Path, place: str = "0", *more: str, source: str = "-", unread: bool = False
    ) -> None:
        command = ["serve", "--model", str(bundle), "--source", source, "--format", "f32", "--page", place]
        self.process = subprocess.Popen(
            [sys.executable, str(Path(softslide.__file__)), *command, *more],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL if unread else subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        assert self.process.stderr is not None
        said = b""
        while not (found := re.search(rb"http://\S+", said)):
            line = self.process.stderr.readline()
            assert line, said
            said += line
        self.address = found[0].decode()

    def feed(self, volts: np.ndarray) -> list[dict]:
        """Sends samples, and waits for the estimates of their whole blocks on standard output."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(volts.astype("<f4").tobytes())
        self.process.stdin.flush()
        return [json.loads(self.process.stdout.readline()) for _ in range(len(volts) // 20)]

    def end(self) -> tuple[int, str]:
        """Ends the stream. The exit status and what was said on standard error."""
        _, error = self.process.communicate(timeout=30)
        return self.process.returncode, error.decode()


@contextmanager
def serving(
    bundle: Path, place: str = "0", *more: str, source: str = "-", unread: bool = False
) -> Iterator[Serving]:
    running = Serving(bundle, place, *more, source=source, unread=unread)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.kill()
        running.process.communicate()


def viewer(address: str, **options: object) -> ClientConnection:
    return connect(f"{address.replace('http', 'ws')}stream", proxy=None, **options)  # type: ignore[arg-type]


def frames(view: ClientConnection) -> Iterator[bytes]:
    """Asks for frames until the server says goodbye."""
    try:
        while True:
            view.send("")
            yield view.recv(timeout=30)  # type: ignore[misc]
    except ConnectionClosedOK:
        return


def decoded(frame: bytes, about: dict) -> dict:
    """A frame as the page reads it."""
    numbers = np.frombuffer(frame, "<f4", offset=8)
    names = about["numbers"]
    return {
        "time_s": struct.unpack_from("<d", frame)[0],
        "state": about["states"][int(numbers[0])],
        **dict(zip(names, numbers[1:].tolist(), strict=False)),
        "subtracted_v": numbers[1 + len(names) :],
    }


def test_a_frame_holds_the_estimate_and_the_subtracted_output(bundle: Path) -> None:
    with serving(bundle) as running, viewer(running.address) as view:
        about = json.loads(view.recv(timeout=30))
        assert about["sensor"]["chamber_mm"] == [50.0, 50.0]
        told = [*running.feed(REST), *running.feed(SLIDE)][-1]
        seen = (decoded(frame, about) for frame in frames(view))
        last = next(frame for frame in seen if frame["time_s"] >= told["time_s"])
    assert last["state"] == told["state"] == "slide"
    for name in ("time_s", "direction_deg", "speed_hi_mm_s", "offset_mm", "x_mm", "zero_shift_v"):
        assert last[name] == pytest.approx(told[name], rel=1e-5), name
    assert last["valid"] == told["valid"] == 1
    assert np.isnan(last["depth_mm"])
    assert told["depth_mm"] is None
    wanted = SLIDE[-20:].mean(axis=0) - REST.mean(axis=0)
    assert last["subtracted_v"] == pytest.approx(wanted, abs=0.002)
    assert np.abs(wanted).max() > 0.05


def test_the_subtracted_output_is_nan_until_the_static_output_is_known(bundle: Path) -> None:
    localizer = Localizer.load(bundle)
    localizer.push(VOLTS[:40])
    assert np.isnan(localizer.subtracted).all()
    localizer.push(VOLTS[40:600])
    assert np.abs(localizer.subtracted).max() < 0.005


def test_frames_come_at_forty_hertz_at_most_and_in_order(bundle: Path) -> None:
    with serving(bundle) as running, viewer(running.address) as view:
        about = json.loads(view.recv(timeout=30))
        begun = time.monotonic()
        view.send("")
        times: list[float] = []
        while len(times) < 30:
            assert time.monotonic() < begun + 60
            running.feed(VOLTS[:20])
            with suppress(TimeoutError):
                times.append(decoded(view.recv(timeout=0.02), about)["time_s"])  # type: ignore[arg-type]
                view.send("")
        took_s = time.monotonic() - begun
    assert times == sorted(set(times))
    # From before the first was asked for until after the last came: a busy machine can only make it longer.
    assert (len(times) - 1) / took_s <= 41


def test_a_viewer_that_does_not_read_delays_nobody(bundle: Path, tmp_path: Path) -> None:
    header = "time_s," + ",".join(f"a{n}_{axis}" for n in range(BOARDS) for axis in ("vx", "vy", "vz"))
    rows = np.column_stack([np.arange(len(VOLTS)) / 1000.0, VOLTS])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=header, comments="", fmt="%.6f")
    with serving(bundle, source=str(tmp_path / "a.csv"), unread=True) as running:
        with viewer(running.address) as dull, viewer(running.address) as keen:
            assert isinstance(dull.recv(timeout=30), str)
            about = json.loads(keen.recv(timeout=30))
            seen = [decoded(frame, about)["time_s"] for frame in frames(keen) if frame]
            code, error = running.end()
        assert code == 0, error
        assert f"{len(VOLTS) // 20} estimates" in error
    assert seen[-1] == pytest.approx(len(VOLTS) / 1000.0)
    # 40 frames a second of 50 estimates; half of them leaves a busy machine its pauses.
    assert len(set(seen)) > 0.4 * (seen[-1] - seen[0]) * 50


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_stream_with_viewers_connected(bundle: Path, number: signal.Signals) -> None:
    with serving(bundle) as running, viewer(running.address) as silent, viewer(running.address) as keen:
        assert silent.recv(timeout=30)
        running.feed(REST)
        keen.send("")
        running.process.send_signal(number)
        code, error = running.end()
    assert code == 0
    assert error.strip().splitlines() == [f"softslide serve: {len(REST) // 20} estimates"]


def test_a_page_of_another_origin_is_refused(bundle: Path) -> None:
    with serving(bundle) as running:
        with viewer(running.address, origin=running.address.rstrip("/")) as view:
            assert view.recv(timeout=30)
        with pytest.raises(InvalidStatus), viewer(running.address, origin="http://elsewhere.example"):
            pass


@pytest.mark.parametrize("place", ["x", "127.0.0.1", "70000", "no-such-host.invalid:0", "203.0.113.1:0"])
def test_a_bad_address_is_an_error_of_one_line(
    bundle: Path, place: str, capsys: pytest.CaptureFixture
) -> None:
    assert softslide.main(["serve", "--model", str(bundle), "--source", "-", "--page", place]) == 2
    assert capsys.readouterr().err.splitlines()[1:][0].startswith(f"softslide serve: --page {place}: ")


def test_a_taken_port_is_an_error_of_one_line(bundle: Path, capsys: pytest.CaptureFixture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        assert softslide.main(["serve", "--model", str(bundle), "--source", "-", "--page", port]) == 2
    assert "cannot listen there (Address already in use)" in capsys.readouterr().err


@pytest.mark.parametrize("missing", ["fastapi", "websockets"])
def test_a_missing_extra_is_named(
    bundle: Path, missing: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    assert softslide.main(["serve", "--model", str(bundle), "--source", "-", "--page", "0"]) == 2
    assert "softslide[live]" in capsys.readouterr().err


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no chromium here; install Debian's package 'chromium'")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield started
        started.close()


@contextmanager
def opened(browser: Browser, address: str, **options: object) -> Iterator[tuple[Page, list[str]]]:
    """The page, and what it complains of on the console."""
    page = browser.new_page(**options)  # type: ignore[arg-type]
    complaints: list[str] = []

    def note(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            complaints.append(message.text)

    page.on("console", note)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("requestfailed", lambda request: complaints.append(f"{request.url} failed"))
    page.goto(address)
    yield page, complaints
    page.close()


def expect_drawing(page: Page, canvas: str) -> None:
    """Waits until a canvas has more than ten colours; an empty one has one."""
    page.wait_for_function(
        """selector => {
            const canvas = document.querySelector(selector);
            if (!canvas.width || !canvas.height) return false;
            const drawn = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
            return new Set(new Uint32Array(drawn.data.buffer)).size > 10;
        }""",
        arg=canvas,
    )


def cell(page: Page, title: str) -> Locator:
    """The cell of a number. The page draws after the estimate came: expect its text, do not read it once."""
    return page.get_by_role("row", name=title).get_by_role("cell").first


def test_the_page_shows_a_slide(bundle: Path, browser: Browser) -> None:
    with serving(bundle) as running, opened(browser, running.address) as (page, complaints):
        expect(page.locator("#connection")).to_have_text("no samples yet")
        running.feed(REST)
        state = page.locator("#state")
        expect(state).to_have_text("rest no estimate")
        expect(page.locator("#zones")).to_have_text("")
        expect(cell(page, "speed")).to_have_text("–")
        assert page.title() == "softslide"
        (told,) = running.feed(SLIDE)[-1:]
        expect(state).to_have_text("slide valid")
        expect(page.locator("#zones")).to_have_text("zone: a0 4, a1 4")
        expect(cell(page, "offset")).to_have_text(f"{told['offset_mm']:.2f} mm")
        expect(cell(page, "direction")).to_have_text("30.0 deg")
        expect(cell(page, "speed")).to_have_text("2.00 mm/s")
        expect(cell(page, "depth")).to_have_text("–")
        expect(cell(page, "accelerometers in use")).to_have_text("2")
        expect(cell(page, "zero shift")).to_have_text(re.compile(r" mV$"))
        interval = page.get_by_role("row", name="direction").get_by_role("cell").nth(1)
        expect(interval).to_have_text("28.0 … 32.0")
        expect(page.get_by_role("img")).to_have_count(1 + BOARDS)
        expect(page.locator("#traces figcaption").first).to_have_text(re.compile(r"^a0 at \(0\.0, 0\.0\) mm"))
        expect_drawing(page, "#skin")
        expect_drawing(page, "#traces canvas")
        expect(page.locator("#connection")).to_have_text("no samples come", timeout=10_000)
        assert complaints == []
        assert running.end()[0] == 0
        expect(page.locator("#connection")).to_have_text("the stream has ended; waiting for the next")
        expect(cell(page, "speed")).to_have_text("2.00 mm/s")


def test_the_page_shows_a_press_without_a_direction(browser: Browser, tmp_path: Path) -> None:
    response = noisy_map(places=TWO_BOARDS)
    level = pressed(response, (12.0, 9.0))
    grown = np.zeros((4000, 3 * BOARDS))
    grown[:, [0, 1, 3, 4]] = np.clip(np.arange(4000)[:, None] / 1500.0, 0.0, 1.0) * level
    volts = stream(np.zeros((7000, 3)), accelerometers=BOARDS)
    volts[3000:] += grown
    contact = contact_calibration(response, INFLATION)
    bundle = write_small_bundle(tmp_path / "b", a_sensor(BOARDS), contact=contact)
    with serving(bundle) as running, opened(browser, running.address) as (page, complaints):
        running.feed(volts)
        expect(page.locator("#state")).to_have_text("press valid")
        expect(cell(page, "speed")).to_have_text("0.00 mm/s")
        expect(cell(page, "x")).to_have_text(re.compile(r"^1[12]\.\d mm$"))
        for unknown in ("direction", "offset", "depth", "force"):
            expect(cell(page, unknown)).to_have_text("–")
        expect_drawing(page, "#skin")
        assert complaints == []


def test_the_page_shows_another_kinds_outputs_in_their_unit(browser: Browser, tmp_path: Path) -> None:
    boards = (Accelerometer("a0", 0.0, 0.0, kind="magnetometer", unit="uT"),)
    bundle = write_small_bundle(tmp_path / "b", replace(a_sensor(), adc_step_v=0.25, accelerometers=boards))
    with serving(bundle) as running, opened(browser, running.address) as (page, complaints):
        running.feed(np.array([40.0, -20.0, 7000.0]) + VOLTS[:1400, :3])
        expect(page.locator("#phase")).to_have_text("slide")
        expect(page.locator("#element")).to_have_text("magnetometer")
        expect(page.locator("#zones")).to_have_text("")
        expect(cell(page, "magnetometers in use")).to_have_text("1")
        expect(cell(page, "zero shift")).to_have_text(re.compile(r"^.?\d+\.\d uT$"))
        expect(page.locator("#traces figcaption")).to_have_text(re.compile(r"x −?\d+\.\d uT"))
        expect_drawing(page, "#traces canvas")
        assert complaints == []


ZONES = """async (tilts) => {
  const { Zones } = await import("./zones.js");
  const zones = new Zones([{ name: "a0", x_mm: 0, y_mm: 0 }]);
  return tilts.map(([state, x, y]) => { zones.push({ state, subtracted_v: [x, y, 0] }); return zones.text(); });
}"""


def test_zones_are_the_article_s(bundle: Path, browser: Browser) -> None:
    """Quadrants by the signs; a sign holds while its output is within a tenth of the largest; at rest there is none."""
    tilts = [
        *[("rest", -0.1, -0.1), ("slide", -0.1, -0.1), ("slide", 0.005, -0.1), ("slide", 0.05, -0.1)],
        *[("slide", -0.05, 0.1), ("slide", 0.05, 0.1), ("rest", 0.05, 0.1), ("slide", 0.001, 0.001)],
    ]
    with serving(bundle) as running, opened(browser, running.address) as (page, complaints):
        told = page.evaluate(ZONES, tilts)
        assert complaints == []
    assert told == ["", *(f"zone: a0 {zone}" for zone in (1, 1, 2, 3, 4)), "", ""]


EXTREMES = """async (rows) => {
  const { extremes } = await import("./traces.js");
  const shown = rows.map(([state, x, y], n) => ({ time_s: n, state, shown: [x, y, 0] }));
  return extremes(shown, 0, 100).map(({ row, axis, sign }) => [row.time_s, axis, sign]);
}"""


def test_extremes_of_each_slide_are_marked_once_they_are_passed(bundle: Path, browser: Browser) -> None:
    first = [("slide", x, y) for x, y in ((0, 0), (-60, 1), (0, 2), (70, 1), (0, 0))]
    second = [("slide", x, 0) for x in (0, -50, -40, 20, 90)]  # still rising
    rows = [("rest", 99, 99), *first, ("rest", 0, 0), *second]
    with serving(bundle) as running, opened(browser, running.address) as (page, complaints):
        assert page.evaluate(EXTREMES, rows) == [[4, 0, 1], [2, 0, -1], [8, 0, -1]]
        assert complaints == []


def test_a_page_that_starts_without_width_draws_once_it_has_some(bundle: Path, browser: Browser) -> None:
    with serving(bundle) as running, opened(browser, "about:blank") as (page, complaints):
        page.add_init_script(
            "addEventListener('DOMContentLoaded', () => { document.querySelector('main').style.width = '0'; })"
        )
        page.goto(running.address)
        running.feed(REST)
        running.feed(SLIDE)
        expect(page.locator("#phase")).to_have_text("slide")
        page.evaluate("for (const c of document.querySelectorAll('canvas')) c.style.width = '0'")
        page.wait_for_function("[...document.querySelectorAll('canvas')].every(c => c.clientWidth === 0)")
        page.evaluate("for (const c of document.querySelectorAll('canvas')) c.style.width = ''")
        page.evaluate("document.querySelector('main').style.width = ''")
        expect_drawing(page, "#skin")
        expect_drawing(page, "#traces canvas")
        assert complaints == []


def test_the_page_reconnects_by_itself(bundle: Path, browser: Browser) -> None:
    with serving(bundle) as running, opened(browser, running.address) as (page, _):
        running.feed(REST)
        expect(page.locator("#phase")).to_have_text("rest")
        running.process.kill()
        expect(page.locator("#connection")).to_have_text("no connection; trying again")
        with serving(bundle, running.address.split(":")[-1].strip("/")) as again:
            again.feed(REST)
            again.feed(SLIDE)
            expect(page.locator("#phase")).to_have_text("slide", timeout=15_000)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [340, 400, 700, 1200, 1600])
def test_the_page_fits_and_is_legible(bundle: Path, browser: Browser, scheme: str, width: int) -> None:
    """No scrolling sideways, nothing wider than its box, and WCAG's contrast of text, 4.5 to 1."""
    size = {"width": width, "height": 600}
    with (
        serving(bundle) as running,
        opened(browser, running.address, viewport=size, color_scheme=scheme) as (page, complaints),
    ):
        running.feed(REST)
        running.feed(SLIDE)
        expect(page.locator("#phase")).to_have_text("slide")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        cut = page.evaluate(
            "[...document.querySelectorAll('section, figure, td, th, p')]"
            ".filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.outerHTML.slice(0, 80))"
        )
        assert cut == []
        assert page.evaluate(LEAST_CONTRAST) >= 4.5
        assert complaints == []


# The least contrast of any text on its background.
LEAST_CONTRAST = """() => {
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const luminance = (text) => {
    const [r, g, b] = rgb(text).map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (element) => {
    const colour = getComputedStyle(element).backgroundColor;
    return rgb(colour)[3] === 0 ? behind(element.parentElement) : colour;
  };
  const texts = [...document.querySelectorAll("body *")].filter((e) =>
    [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim()) && e.checkVisibility());
  return Math.min(...texts.map((e) => {
    const [a, b] = [luminance(getComputedStyle(e).color), luminance(behind(e))].sort((p, q) => q - p);
    return (a + 0.05) / (b + 0.05);
  }));
}"""
