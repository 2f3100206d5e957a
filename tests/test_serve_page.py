"""The live page: frames and viewers, which never delay the stream, and the page in a browser."""

import json
import re
import signal
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from served import BOARDS, REST, SLIDE, VOLTS, cell, opened, serving, viewer
from small_bundle import write_small_bundle
from streams import a_sensor, pass_over, stream, write_csv
from tracked_map import INFLATION, TWO_BOARDS, noisy_map, pressed
from websockets.exceptions import ConnectionClosedOK
from websockets.sync.client import ClientConnection

import softslide
from softslide.models.response_map.card import contact_calibration
from softslide.pipeline.sensor import Accelerometer
from softslide.serve.localizer import Localizer

# A slide that takes longer than the page is looked at.
SLOW = stream(pass_over(30.0), accelerometers=BOARDS)


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


def test_a_frame_holds_the_estimate_and_the_subtracted_output(two_boards: Path) -> None:
    with serving(two_boards) as running, viewer(running.address) as view:
        about = json.loads(view.recv(timeout=30))
        assert about["sensor"]["chamber_mm"] == [50.0, 50.0]
        sent = [*running.feed(REST), *running.feed(SLIDE)][-1]
        seen = (decoded(frame, about) for frame in frames(view))
        last = next(frame for frame in seen if frame["time_s"] >= sent["time_s"])
    assert last["state"] == sent["state"] == "slide"
    for name in ("time_s", "direction_deg", "speed_hi_mm_s", "offset_mm", "x_mm", "zero_shift_v"):
        assert last[name] == pytest.approx(sent[name], rel=1e-5), name
    assert last["valid"] == sent["valid"] == 1
    assert np.isnan(last["depth_mm"])
    assert sent["depth_mm"] is None
    wanted = SLIDE[-20:].mean(axis=0) - REST.mean(axis=0)
    assert last["subtracted_v"] == pytest.approx(wanted, abs=0.002)
    assert np.abs(wanted).max() > 0.05


def test_the_subtracted_output_is_nan_until_the_static_output_is_known(two_boards: Path) -> None:
    localizer = Localizer.load(two_boards)
    localizer.push(VOLTS[:40])
    assert np.isnan(localizer.subtracted).all()
    localizer.push(VOLTS[40:600])
    assert np.abs(localizer.subtracted).max() < 0.005


def test_frames_come_at_forty_hertz_at_most_and_in_order(two_boards: Path) -> None:
    with serving(two_boards) as running, viewer(running.address) as view:
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


def test_a_viewer_that_does_not_read_delays_nobody(two_boards: Path, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", VOLTS, a_sensor(BOARDS).channels)
    with serving(two_boards, source=str(path), unread=True) as running:
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


def test_a_signal_ends_the_stream_with_viewers_connected(two_boards: Path) -> None:
    with serving(two_boards) as running, viewer(running.address) as silent, viewer(running.address) as keen:
        assert silent.recv(timeout=30)
        running.feed(REST)
        keen.send("")
        running.process.send_signal(signal.SIGINT)
        code, error = running.end()
    assert code == 0
    assert error.strip().splitlines() == [f"softslide serve: {len(REST) // 20} estimates"]


def test_a_bad_address_or_a_taken_port_is_an_error_of_one_line(
    bundle: Path, capsys: pytest.CaptureFixture
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = str(other.getsockname()[1])
        wrong = ("x", "127.0.0.1", "70000", ".:0", "a..b:0", "no-such-host.invalid:0", "203.0.113.1:0")
        for place in (*wrong, taken):
            assert softslide.main(["serve", "--model", str(bundle), "--source", "-", "--page", place]) == 2
            _, said = capsys.readouterr().err.splitlines()
            assert said.startswith(f"softslide serve: --page {place}: ")


@pytest.fixture(scope="module")
def sliding(two_boards: Path, browser: Browser) -> Iterator[Page]:
    """A page that shows a slide."""
    with serving(two_boards) as running, opened(browser, running.address) as page:
        running.feed(REST)
        running.feed(SLIDE)
        expect(page.locator("#phase")).to_have_text("slide")
        yield page


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


def test_the_page_shows_a_slide_and_why_it_abstains_before(two_boards: Path, browser: Browser) -> None:
    with serving(two_boards) as running, opened(browser, running.address, lost=True) as page:
        # Which of the two depends on whether a heartbeat has come.
        expect(page.locator("#connection")).to_have_text(re.compile("^no samples (yet|come)$"))
        state, zones, reason = (page.locator(f"#{name}") for name in ("state", "zones", "reason"))
        running.feed(REST)
        with running.fed(np.tile(REST, (20, 1))):
            expect(state).to_have_text("rest no estimate")
            expect(zones).to_have_text("")
            expect(reason).to_have_text("nothing touches the skin")
            for unknown in ("speed", "accelerometers in use"):
                expect(cell(page, unknown)).to_have_text("–")
        assert not running.feed(SLOW[:2000])[-1]["valid"]
        expect(page.locator("#phase")).to_have_text("slide")
        expect(reason).not_to_have_text("")
        for unknown in ("direction", "speed", "offset"):
            expect(cell(page, unknown)).to_have_text("–")
        before = running.feed(SLOW[2000:17_000])
        with running.fed(SLOW[17_000:]) as sent:
            expect(state).to_have_text("slide valid")
            expect(zones).to_have_text("zone: a0 4, a1 4")
            expect(cell(page, "offset")).to_have_text(re.compile(r"^\d\.\d\d mm$"))
            offset = page.wait_for_function(VALID_OFFSET).json_value()
            expect(cell(page, "direction")).to_have_text("30.0 deg")
            expect(cell(page, "speed")).to_have_text("2.00 mm/s")
            expect(cell(page, "depth")).to_have_text("–")
            expect(cell(page, "accelerometers in use")).to_have_text("2")
            expect(cell(page, "zero shift")).to_have_text(re.compile(r" mV$"))
            interval = page.get_by_role("row", name="direction").get_by_role("cell").nth(1)
            expect(interval).to_have_text("28.0 … 32.0")
            expect(page.get_by_role("img")).to_have_count(1 + BOARDS)
            figure = page.locator("#traces figcaption").first
            expect(figure).to_have_text(re.compile(r"^a0 at \(0\.0, 0\.0\) mm"))
            expect_drawing(page, "#skin")
            expect_drawing(page, "#traces canvas")
        assert offset in {f"{estimate['offset_mm']:.2f} mm" for estimate in [*before, *sent]}
        assert sent[-1]["valid"]
        # The samples have stopped.
        expect(state).to_have_text("slide abstains")
        expect(reason).to_have_text("no samples come")
        expect(page.locator("#connection")).to_have_text("no samples come")
        expect(zones).to_have_text("")
        for unknown in ("direction", "speed", "offset"):
            expect(cell(page, unknown)).to_have_text("–")
        assert running.end()[0] == 0
        expect(page.locator("#connection")).to_have_text("the stream has ended; waiting for the next")
        expect(cell(page, "speed")).to_have_text("–")


VALID_OFFSET = """() => {
  const row = [...document.querySelectorAll("#estimates tr")].find(({ cells }) => cells[0].textContent === "offset");
  return document.querySelector("#trust").textContent === "valid" && row.cells[1].textContent;
}"""


def test_the_page_shows_a_press_without_a_direction(browser: Browser, tmp_path: Path) -> None:
    response = noisy_map(places=TWO_BOARDS)
    level = pressed(response, (12.0, 9.0))
    grown = np.zeros((12_000, 3 * BOARDS))
    grown[:, [0, 1, 3, 4]] = np.clip(np.arange(12_000)[:, None] / 1500.0, 0.0, 1.0) * level
    volts = stream(np.zeros((15_000, 3)), accelerometers=BOARDS)
    volts[3000:] += grown
    contact = contact_calibration(response, INFLATION)
    bundle = write_small_bundle(tmp_path / "b", a_sensor(BOARDS), contact=contact)
    with serving(bundle) as running, opened(browser, running.address) as page:
        running.feed(volts[:6000])
        with running.fed(volts[6000:]):
            expect(page.locator("#state")).to_have_text("press valid")
            expect(cell(page, "speed")).to_have_text("0.00 mm/s")
            expect(cell(page, "x")).to_have_text(re.compile(r"^1[12]\.\d mm$"))
            for unknown in ("direction", "offset", "depth", "force"):
                expect(cell(page, unknown)).to_have_text("–")
            expect_drawing(page, "#skin")


def test_the_page_shows_another_kinds_outputs_in_their_unit(browser: Browser, tmp_path: Path) -> None:
    boards = (Accelerometer("a0", 0.0, 0.0, kind="magnetometer", unit="uT"),)
    bundle = write_small_bundle(tmp_path / "b", replace(a_sensor(), adc_step_v=0.25, accelerometers=boards))
    with serving(bundle) as running, opened(browser, running.address) as page:
        running.feed(np.array([40.0, -20.0, 7000.0]) + VOLTS[:1400, :3])
        expect(page.locator("#phase")).to_have_text("slide")
        expect(page.locator("#element")).to_have_text("magnetometer")
        expect(page.locator("#zones")).to_have_text("")
        expect(cell(page, "magnetometers in use")).to_have_text("1")
        expect(cell(page, "zero shift")).to_have_text(re.compile(r"^.?\d+\.\d uT$"))
        expect(page.locator("#traces figcaption")).to_have_text(re.compile(r"x −?\d+\.\d uT"))
        expect_drawing(page, "#traces canvas")


ZONES = """async (tilts) => {
  const { Zones } = await import("./zones.js");
  const zones = new Zones([{ name: "a0", x_mm: 0, y_mm: 0 }]);
  return tilts.map(([state, x, y]) => { zones.push({ state, subtracted_v: [x, y, 0] }); return zones.text(); });
}"""


def test_zones_are_the_article_s(sliding: Page) -> None:
    """Quadrants by the signs; a sign holds while its output is within a tenth of the largest; at rest: no zone."""
    tilts = [
        *[("rest", -0.1, -0.1), ("slide", -0.1, -0.1), ("slide", 0.005, -0.1), ("slide", 0.05, -0.1)],
        *[("slide", -0.05, 0.1), ("slide", 0.05, 0.1), ("rest", 0.05, 0.1), ("slide", 0.001, 0.001)],
    ]
    wanted = ["", *(f"zone: a0 {zone}" for zone in (1, 1, 2, 3, 4)), "", ""]
    assert sliding.evaluate(ZONES, tilts) == wanted


EXTREMES = """async (rows) => {
  const { extremes } = await import("./traces.js");
  const shown = rows.map(([state, x, y], n) => ({ time_s: n, state, shown: [x, y, 0] }));
  return extremes(shown, 0, 100).map(({ row, axis, sign }) => [row.time_s, axis, sign]);
}"""


def test_extremes_of_each_slide_are_marked_once_they_are_passed(sliding: Page) -> None:
    first = [("slide", x, y) for x, y in ((0, 0), (-60, 1), (0, 2), (70, 1), (0, 0))]
    second = [("slide", x, 0) for x in (0, -50, -40, 20, 90)]  # still rising
    rows = [("rest", 99, 99), *first, ("rest", 0, 0), *second]
    assert sliding.evaluate(EXTREMES, rows) == [[4, 0, 1], [2, 0, -1], [8, 0, -1]]


def test_a_page_that_starts_without_width_draws_once_it_has_some(two_boards: Path, browser: Browser) -> None:
    with serving(two_boards) as running, opened(browser, "about:blank") as page:
        narrow = "document.querySelector('main').style.width = '0'"
        page.add_init_script(f"addEventListener('DOMContentLoaded', () => {{ {narrow}; }})")
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


def test_the_page_reconnects_by_itself(two_boards: Path, browser: Browser) -> None:
    with serving(two_boards) as running, opened(browser, running.address, lost=True) as page:
        running.feed(REST)
        expect(page.locator("#phase")).to_have_text("rest")
        running.process.kill()
        expect(page.locator("#connection")).to_have_text("no connection; trying again")
        with serving(two_boards, running.address.split(":")[-1].strip("/")) as again:
            again.feed(REST)
            again.feed(SLIDE)
            expect(page.locator("#phase")).to_have_text("slide", timeout=15_000)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [340, 400, 700, 1200, 1600])
def test_the_page_fits_and_is_legible(sliding: Page, scheme: Literal["light", "dark"], width: int) -> None:
    """No scrolling sideways, nothing wider than its box, and WCAG's contrast of text, 4.5 to 1."""
    sliding.emulate_media(color_scheme=scheme)
    sliding.set_viewport_size({"width": width, "height": 600})
    assert sliding.evaluate("document.documentElement.scrollWidth") <= width
    cut = sliding.evaluate(
        "[...document.querySelectorAll('section, figure, td, th, p')]"
        ".filter(e => e.scrollWidth > e.clientWidth + 1).map(e => e.outerHTML.slice(0, 80))"
    )
    assert cut == []
    assert sliding.evaluate(LEAST_CONTRAST) >= 4.5


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
