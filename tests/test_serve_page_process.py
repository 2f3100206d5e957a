"""The page runs beside the stream: whatever happens to it, the stream goes on; and what a viewer can ask for."""

import http.client
import json
import os
import signal
import socket
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect
from small_bundle import write_small_bundle
from streams import a_sensor
from test_serve_page import BOARDS, REST, SLIDE, Serving, browser, cell, opened, serving  # noqa: F401

from features.contact.places import Place
from features.estimate import Contact, Estimate, Reason
from features.stream.tracker import SlideState
from serve.localizer import Localizer
from serve.page.process import Page as Served
from serve.predict import predict


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundles") / "two"
    return write_small_bundle(folder, a_sensor(BOARDS), offset_mm_per_v=50.0)


def page_of(running: Serving) -> int:
    """The process id of the page."""
    children = Path(f"/proc/{running.process.pid}/task/{running.process.pid}/children").read_text().split()
    (page,) = [
        int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]
    return page


def asked(
    running: Serving, path: str, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, bytes]:
    place = urlsplit(running.address)
    with closing(http.client.HTTPConnection("127.0.0.1", place.port or 0, timeout=30)) as connection:
        connection.request(method, path, body, headers)
        with connection.getresponse() as got:
            return got.status, got.read()


def test_a_page_that_stands_still_does_not_delay_the_stream(bundle: Path) -> None:
    """More estimates than may wait for it, and than its pipe holds."""
    with serving(bundle) as running:
        page = page_of(running)
        os.kill(page, signal.SIGSTOP)
        try:
            told = [running.feed(REST)[-1] for _ in range(60)]
        finally:
            os.kill(page, signal.SIGCONT)
        assert told[-1]["time_s"] == pytest.approx(60 * len(REST) / 1000)
        assert running.end()[0] == 0


def test_a_page_that_dies_does_not_end_the_stream(bundle: Path) -> None:
    with serving(bundle) as running:
        os.kill(page_of(running), signal.SIGKILL)
        assert len(running.feed(REST)) == len(REST) // 20
        assert len(running.feed(SLIDE)) == len(SLIDE) // 20
        code, error = running.end()
    assert code == 0
    assert error.splitlines()[0] == "softslide serve: the page has ended; the stream goes on"


def test_a_frame_of_broken_text_is_answered_without_a_word(bundle: Path) -> None:
    """A text frame, masked with zeros, whose content is no UTF-8."""
    with serving(bundle) as running:
        place = urlsplit(running.address)
        with socket.create_connection(("127.0.0.1", place.port), timeout=30) as raw:
            raw.sendall(
                b"GET /stream HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
            )
            assert b" 101 " in raw.recv(4096)
            raw.sendall(b"\x81\x82\0\0\0\0\xff\xfe")
            while raw.recv(4096):
                pass
        assert len(running.feed(REST)) == len(REST) // 20
        code, error = running.end()
    assert code == 0
    assert error.splitlines() == [f"softslide serve: {len(REST) // 20} estimates"]


def test_what_was_estimated_can_be_downloaded(bundle: Path) -> None:
    with serving(bundle) as running:
        told = [*running.feed(REST), *running.feed(SLIDE)]
        for _ in range(200):
            status, table = asked(running, "/estimates.csv")
            header, *rows = table.decode().splitlines()
            if len(rows) == len(told):
                break
        assert status == 200
    names = header.split(",")
    last = dict(zip(names, rows[-1].split(","), strict=True))
    for name in ("time_s", "speed_mm_s", "offset_mm", "direction_lo_deg"):
        assert float(last[name]) == pytest.approx(told[-1][name], rel=1e-5), name
    assert [last[name] for name in ("state", "contact", "reason")] == ["slide", "slide", ""]
    assert last["depth_mm"] == ""
    assert float(last["a1_vx_subtracted_v"]) == pytest.approx(
        SLIDE[-20:, 3].mean() - REST[:, 3].mean(), abs=0.002
    )


def test_a_recording_that_is_sent_is_answered_as_predict_does(bundle: Path, tmp_path: Path) -> None:
    columns = ",".join(["time_s", *Localizer.load(bundle).card.channels])
    volts = np.concatenate([REST, SLIDE])
    table = np.column_stack([np.arange(len(volts)) / 1000, volts])
    np.savetxt(tmp_path / "slide.csv", table, "%.6f", ",", header=columns, comments="")
    (wanted,) = predict(bundle, [tmp_path / "slide.csv"])
    with serving(bundle) as running:
        status, told = asked(running, "/predict", "POST", body=(tmp_path / "slide.csv").read_bytes())
        assert status == 200
        assert (
            json.loads(told).items()
            == {k: v for k, v in wanted.items() if k not in ("recording", "file")}.items()
        )
        assert wanted["valid"]
        for sent in (b"", b"time_s\n1\n2\n", b"\xff" * 100, columns.encode() + b"\n0,nan"):
            status, told = asked(running, "/predict", "POST", body=sent)
            assert status == 422
            assert "recording: " in json.loads(told)["detail"]
            assert "/tmp" not in told.decode()
        status, told = asked(running, "/openapi.json")
        assert status == 200
        assert {"/predict", "/model", "/healthz"} <= set(json.loads(told)["paths"])
        assert len(running.feed(REST)) == len(REST) // 20


def test_the_static_output_is_learnt_anew_on_request(bundle: Path) -> None:
    """Of the page itself alone: another page's request carries its origin."""
    with serving(bundle) as running:
        running.feed(REST)
        assert asked(running, "/zero", "POST", Origin="http://elsewhere.example")[0] == 403
        assert asked(running, "/zero")[0] != 200
        assert running.feed(REST)[-1]["state"] == "rest"
        assert (
            asked(
                running,
                "/zero",
                "POST",
                Origin=running.address.rstrip("/"),
                Host=running.address.split("/")[2],
            )[0]
            == 200
        )
        # The stream begins anew: its time, and then what counts as rest.
        assert any(running.feed(REST[:20])[-1]["time_s"] < 0.5 for _ in range(500))
        raised = REST + 0.05
        states = [estimate["state"] for _ in range(3) for estimate in running.feed(raised)]
        assert set(states[-30:]) == {"rest"}


def test_the_page_says_why_it_abstains_and_shows_no_numbers_then(bundle: Path, browser: Browser) -> None:  # noqa: F811
    with serving(bundle) as running, opened(browser, running.address) as (page, complaints):
        running.feed(REST)
        expect(page.locator("#phase")).to_have_text("rest")
        expect(page.locator("#reason")).to_have_text("nothing touches the skin")
        expect(cell(page, "accelerometers in use")).to_have_text("–")
        (early,) = running.feed(SLIDE[:260])[-1:]
        assert not early["valid"]
        expect(page.locator("#phase")).to_have_text("slide")
        expect(page.locator("#reason")).not_to_have_text("")
        for title in ("direction", "speed", "offset"):
            expect(cell(page, title)).to_have_text("–")
        assert complaints == []


def test_the_page_pauses_replays_and_survives_no_width(bundle: Path, browser: Browser) -> None:  # noqa: F811
    with serving(bundle) as running, opened(browser, running.address) as (page, complaints):
        running.feed(REST)
        expect(page.locator("#phase")).to_have_text("rest")
        page.click("#pause")
        running.feed(SLIDE)
        page.wait_for_timeout(500)
        assert page.locator("#phase").inner_text() == "rest"
        page.click("#pause")
        page.click("#replay")
        expect(page.locator("#phase")).to_have_text("slide", timeout=20_000)
        for width in ("0", "20px"):
            page.evaluate(f"document.querySelector('main').style.width = '{width}'")
            page.wait_for_timeout(200)
        running.feed(np.concatenate([SLIDE[-200:]]))
        page.wait_for_timeout(300)
        assert complaints == []


def test_the_page_shows_where_a_contact_may_be(bundle: Path, browser: Browser) -> None:  # noqa: F811
    """While several places explain the output each is drawn, in place and to scale, and told with its share."""
    card = Localizer.load(bundle).card
    unclear = Estimate(
        1.0,
        SlideState.SLIDE,
        contact=Contact.SLIDE,
        reason=Reason.AMBIGUOUS,
        places=(Place(-20, 10, 0.7), Place(15, -5, 0.25)),
    )
    shown = Served("0", card, "-", bundle)
    try:
        with opened(browser, shown.address) as (page, _):
            shown.show(unclear._replace(time_s=0.5, places=()), np.zeros(len(card.channels)))
            expect(page.locator("#reason")).to_have_text("several places or headings explain the output")
            page.wait_for_timeout(200)
            before = drawn(page)
            shown.show(unclear, np.zeros(len(card.channels)))
            expect(page.locator("#places")).to_have_text(
                "70 % at x −20.0, y 10.0 mm; 25 % at x 15.0, y −5.0 mm"
            )
            page.wait_for_timeout(200)
            rows, columns = np.nonzero((drawn(page) != before).any(axis=2))
    finally:
        shown.close()
    # The two outlines bound what has changed: 6 mm wide, 35 and 15 mm apart.
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx((35 + 6) / (15 + 6), rel=0.05)
    left = columns < columns.mean()
    across, down = columns[left].mean() - columns[~left].mean(), rows[left].mean() - rows[~left].mean()
    assert across / down == pytest.approx(35 / 15, rel=0.1)


def drawn(page: Page) -> np.ndarray:
    """(height, width, 4): the picture of the skin."""
    pixels = page.evaluate(
        """() => {
            const canvas = document.querySelector("#skin");
            const { data, width, height } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
            return [width, height, Array.from(data)];
        }"""
    )
    width, height, values = pixels
    return np.array(values, np.uint8).reshape(height, width, 4)
