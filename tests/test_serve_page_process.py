"""The page runs next to the stream: whatever happens to it, the stream goes on; and what a viewer can ask for."""

import json
import os
import signal
import socket
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import count
from multiprocessing import active_children
from pathlib import Path
from shutil import copytree
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect
from served import REST, SLIDE, Serving, cell, opened, repeated, serving, upgrade
from streams import a_sensor, write_csv

from softslide.features.contact.places import Place
from softslide.features.estimate import Contact, Estimate, Reason
from softslide.features.stream.tracker import SlideState
from softslide.serve.localizer import Localizer
from softslide.serve.page.process import Page as Served
from softslide.serve.predict import predict


def page_of(running: Serving) -> int:
    """The process id of the page."""
    children = Path(f"/proc/{running.process.pid}/task/{running.process.pid}/children").read_text().split()
    (page,) = [child for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]
    return int(page)


def test_a_page_that_stands_still_does_not_delay_the_stream(two_boards: Path) -> None:
    """More estimates than may wait for it, and than its pipe holds."""
    with serving(two_boards) as running:
        page = page_of(running)
        os.kill(page, signal.SIGSTOP)
        try:
            sent = [running.feed(REST)[-1] for _ in range(60)]
        finally:
            os.kill(page, signal.SIGCONT)
        assert sent[-1]["time_s"] == pytest.approx(60 * len(REST) / 1000)
        assert running.end()[0] == 0


def test_a_page_that_dies_does_not_end_the_stream(two_boards: Path) -> None:
    with serving(two_boards) as running:
        os.kill(page_of(running), signal.SIGKILL)
        assert len(running.feed(REST)) == len(REST) // 20
        assert len(running.feed(SLIDE)) == len(SLIDE) // 20
        code, error = running.end()
    assert code == 0
    assert error.splitlines()[0] == "softslide serve: the page has ended; the stream goes on"


def test_a_frame_of_broken_text_is_answered_without_a_word(two_boards: Path) -> None:
    """A text frame, masked with zeros, whose content is no UTF-8."""
    with serving(two_boards) as running:
        place = urlsplit(running.address)
        with socket.create_connection(("127.0.0.1", place.port), timeout=30) as raw:
            raw.sendall(upgrade(Host="localhost"))
            assert b" 101 " in raw.recv(4096)
            raw.sendall(b"\x81\x82\0\0\0\0\xff\xfe")
            while raw.recv(4096):
                pass
        assert len(running.feed(REST)) == len(REST) // 20
        code, error = running.end()
    assert code == 0
    assert error.splitlines() == [f"softslide serve: {len(REST) // 20} estimates"]


@pytest.fixture(scope="module")
def slid(two_boards: Path) -> Iterator[tuple[Serving, list[dict]]]:
    """A stream after a slide, and its estimates."""
    with serving(two_boards) as running:
        yield running, [*running.feed(REST), *running.feed(SLIDE)]


def test_what_was_estimated_can_be_downloaded(slid: tuple[Serving, list[dict]]) -> None:
    running, sent = slid
    for _ in range(200):
        status, _, table = running.ask("/estimates.csv")
        header, *lines = (line.split(",") for line in table.decode().splitlines())
        rows = [dict(zip(header, line, strict=True)) for line in lines]
        estimates = [row for row in rows if row["reason"] != "no_signal"]
        if len(estimates) >= len(sent):
            break
    assert status == 200
    last = estimates[len(sent) - 1]
    for name in ("time_s", "speed_mm_s", "offset_mm", "direction_lo_deg"):
        assert float(last[name]) == pytest.approx(sent[-1][name], rel=1e-5), name
    assert [last[name] for name in ("state", "contact", "reason")] == ["slide", "slide", ""]
    assert last["depth_mm"] == ""
    wanted = SLIDE[-20:, 3].mean() - REST[:, 3].mean()
    assert float(last["a1_vx_subtracted_v"]) == pytest.approx(wanted, abs=0.002)


def test_a_recording_that_is_sent_is_answered_as_predict_does(
    slid: tuple[Serving, list[dict]], two_boards: Path, tmp_path: Path
) -> None:
    path = write_csv(tmp_path / "slide.csv", np.concatenate([REST, SLIDE]), a_sensor(2).channels)
    (wanted,), (running, _) = predict(two_boards, [path]), slid
    status, _, answer = running.ask("/predict", "POST", body=path.read_bytes())
    assert status == 200
    assert json.loads(answer) == {k: v for k, v in wanted.items() if k not in ("recording", "file")}
    assert wanted["valid"]
    header = path.read_bytes().partition(b"\n")[0]
    for sent in (b"", b"time_s\n1\n2\n", b"\xff" * 100, header + b"\n0,nan"):
        status, _, answer = running.ask("/predict", "POST", body=sent)
        assert status == 422
        assert "recording: " in json.loads(answer)["detail"]
        assert "/tmp" not in answer.decode()
    status, _, answer = running.ask("/openapi.json")
    assert status == 200
    assert {"/predict", "/model", "/healthz"} <= set(json.loads(answer)["paths"])
    assert len(running.feed(REST)) == len(REST) // 20


def test_a_bundle_whose_hash_is_gone_answers_only_if_unsigned_ones_are_served(
    two_boards: Path, tmp_path: Path
) -> None:
    """Changed while the page runs, as `softslide predict` would find it."""
    bundle = Path(copytree(two_boards, tmp_path / "b"))
    path = write_csv(tmp_path / "slide.csv", np.concatenate([REST, SLIDE]), a_sensor(2).channels)
    with serving(bundle) as running:
        table = json.loads((bundle / "model.json").read_text())
        del table["card_sha256"]
        (bundle / "model.json").write_text(json.dumps(table))
        status, _, answer = running.ask("/predict", "POST", body=path.read_bytes())
        assert status == 422
        assert "no card_sha256" in json.loads(answer)["detail"]
    with serving(bundle, more=["--unsigned"]) as running:
        assert running.ask("/predict", "POST", body=path.read_bytes())[0] == 200


def test_the_static_output_is_learnt_anew_on_request(two_boards: Path) -> None:
    """Of the page itself alone: another page's request carries its origin."""
    with serving(two_boards) as running:
        running.feed(REST)
        assert running.ask("/zero", "POST", Origin="http://elsewhere.example")[0] == 403
        assert running.ask("/zero")[0] != 200
        assert running.feed(REST)[-1]["state"] == "rest"
        own = {"Origin": running.address.rstrip("/"), "Host": running.address.split("/")[2]}
        assert running.ask("/zero", "POST", **own)[0] == 403
        cookie = running.ask("/")[1]["Set-Cookie"].partition(";")[0]
        assert running.ask("/zero", "POST", **own, Cookie=cookie)[0] == 200
        # What counts as rest is not known at first; the time goes on.
        assert any(running.feed(REST[:20])[-1]["reason"] == "unknown_zero" for _ in range(500))
        raised = REST + 0.05
        states = [estimate["state"] for _ in range(3) for estimate in running.feed(raised)]
        assert set(states[-30:]) == {"rest"}


def test_the_page_pauses_and_replays(two_boards: Path, browser: Browser) -> None:
    with serving(two_boards) as running, opened(browser, running.address) as page:
        running.feed(REST)
        expect(page.locator("#phase")).to_have_text("rest")
        page.click("#pause")
        running.feed(SLIDE)
        page.wait_for_timeout(500)
        assert page.locator("#phase").inner_text() == "rest"
        page.click("#pause")
        page.click("#replay")
        expect(page.locator("#phase")).to_have_text("slide", timeout=20_000)


def test_the_page_shows_where_a_contact_may_be(two_boards: Path, browser: Browser) -> None:
    """While several places explain the output each is drawn, in place and to scale, and named with its share."""
    card = Localizer.load(two_boards).card
    places = (Place(-20, 10, 0.7), Place(15, -5, 0.25))
    slide = Estimate(1.0, SlideState.SLIDE, contact=Contact.SLIDE, reason=Reason.AMBIGUOUS)
    named = "70 % at x −20.0, y 10.0 mm; 25 % at x 15.0, y −5.0 mm"
    shown = Served("0", card, "-", two_boards)
    try:
        with opened(browser, shown.address) as page:
            with going_on(shown, slide):
                expect(page.locator("#reason")).to_have_text("several places or headings explain the output")
                page.wait_for_timeout(200)
                before = drawn(page)
            with going_on(shown, slide._replace(time_s=1000.0, places=places)):
                expect(page.locator("#places")).to_have_text(named)
                page.wait_for_timeout(200)
                rows, columns = np.nonzero((drawn(page) != before).any(axis=2))
    finally:
        shown.close()
    # The two outlines bound what has changed: 6 mm wide, 35 and 15 mm apart.
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx((35 + 6) / (15 + 6), rel=0.05)
    left = columns < columns.mean()
    across, down = columns[left].mean() - columns[~left].mean(), rows[left].mean() - rows[~left].mean()
    assert across / down == pytest.approx(35 / 15, rel=0.1)


@contextmanager
def going_on(shown: Served, estimate: Estimate) -> Iterator[None]:
    """The same estimate 20 times a second, each 20 ms later than the last."""
    times = count(estimate.time_s, 0.02)
    with repeated(lambda: shown.show(estimate._replace(time_s=next(times)), np.zeros(6))):
        yield


@pytest.mark.parametrize("end", ["silent", "ended", "lost"])
def test_the_page_takes_back_what_is_not_estimated_any_more(
    two_boards: Path, browser: Browser, end: str
) -> None:
    """A stream that stands still, has ended, or whose page has died: the last estimate is not valid any more."""
    others = set(active_children())
    shown = Served("0", Localizer.load(two_boards).card, "-", two_boards)
    slide = Estimate(
        1.0, SlideState.SLIDE, valid=True, contact=Contact.SLIDE, direction_deg=30.0, speed_mm_s=2.0
    )
    try:
        with opened(browser, shown.address, lost=True) as page:
            state = page.locator("#state")
            with going_on(shown, slide):
                expect(state).to_have_text("slide valid")
                expect(cell(page, "direction")).to_have_text("30.0 deg")
                if end == "ended":
                    shown.close()
                if end == "lost":
                    (served,) = set(active_children()) - others
                    served.kill()
                    expect(state).to_have_text("slide abstains")
            expect(state).to_have_text("slide abstains")
            expect(page.locator("#reason")).to_have_text("no samples come")
            for unknown in ("direction", "speed"):
                expect(cell(page, unknown)).to_have_text("–")
    finally:
        shown.close()


def drawn(page: Page) -> np.ndarray:
    """(height, width, 4): the picture of the skin."""
    url = page.evaluate('() => document.querySelector("#skin").toDataURL()')
    return np.array(Image.open(BytesIO(b64decode(url.partition(",")[2]))))
