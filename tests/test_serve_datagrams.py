"""Samples over UDP: what is lost is counted, and time does not run short of it."""

import socket
import sys
import time
from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest
from sender import free_port

from softslide.serve.stream import datagrams
from softslide.serve.stream.datagrams import Datagrams


@pytest.fixture
def mouth() -> Iterator[socket.socket]:
    with socket.socket(type=socket.SOCK_DGRAM) as speaking:
        yield speaking


def listening() -> tuple[Datagrams, tuple[str, int]]:
    place = ("127.0.0.1", free_port())
    return Datagrams("udp://here", *place, wait_s=0.2), place


def heard(ear: Datagrams, capsys: pytest.CaptureFixture) -> tuple[np.ndarray, str]:
    """All samples until nothing comes, and what is said in the end."""
    chunks, pieces = ear.chunks("csv", 3), []
    while chunk := next(chunks):
        pieces.append(chunk[0])
    chunks.close()  # type: ignore[attr-defined]
    return np.concatenate(pieces), capsys.readouterr().err


@pytest.mark.parametrize(("numbers", "lost"), [((7, 8, 9), 0), ((7, 10, 11), 2), ((7, 8, 3, 4), 0)])
def test_a_gap_in_the_numbers_is_empty_samples(
    mouth: socket.socket, capsys: pytest.CaptureFixture, numbers: tuple[int, ...], lost: int
) -> None:
    """A number that runs back is a sender that began anew."""
    ear, place = listening()
    for number in numbers:
        mouth.sendto(f"#{number}\n1,2,3\n{number},2,3\n".encode(), place)
    volts, said = heard(ear, capsys)
    assert ear.lost == lost
    assert len(volts) == 2 * (len(numbers) + lost)
    assert np.isnan(volts).all(axis=1).sum() == 2 * lost
    assert [v for v in volts[:, 0] if v > 1] == list(numbers)
    assert (f"{lost} datagrams were lost" in said) == (lost > 0)


STAMPED = (1, 5), b"0.1,1,2,3\n", 2
LONG_GAP = (1, 90_000), b"1,2,3\n" * 400, 800 + datagrams.MOST_EMPTY


@pytest.mark.parametrize(("numbers", "rows", "samples"), [STAMPED, LONG_GAP])
def test_stamped_samples_need_nothing_made_up_and_a_long_gap_costs_little(
    mouth: socket.socket, capsys: pytest.CaptureFixture, numbers: tuple[int, int], rows: bytes, samples: int
) -> None:
    ear, place = listening()
    for number in numbers:
        mouth.sendto(f"#{number}\n".encode() + rows, place)
    volts, _ = heard(ear, capsys)
    assert ear.lost == numbers[1] - numbers[0] - 1
    assert len(volts) == samples


@pytest.mark.skipif(sys.platform != "linux", reason="Linux alone counts what it drops")
def test_what_overruns_the_buffer_is_counted(
    mouth: socket.socket, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(datagrams, "BUFFER_BYTES", 1 << 14)
    ear, place = listening()
    for _ in range(400):
        mouth.sendto(b"1,2,3\n" * 20, place)
    chunks = ear.chunks("csv", 3)
    came = 0
    while chunk := next(chunks):
        came += int(np.isfinite(chunk[0]).all(axis=1).sum())
    mouth.sendto(b"1,2,3\n" * 20, place)
    made_up, last = next(chunks), next(chunks)
    chunks.close()  # type: ignore[attr-defined]
    assert 0 < ear.lost < 400
    assert came == 20 * (400 - ear.lost)
    assert np.isnan(made_up[0]).all()
    assert (len(made_up[0]), len(last[0])) == (20 * ear.lost, 20)
    assert f"{ear.lost} datagrams were lost" in capsys.readouterr().err


def test_one_sender_is_heard_at_a_time(
    mouth: socket.socket, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another takes its place once it is silent, as a new stream."""
    monkeypatch.setattr(datagrams, "SILENT_S", 0.5)
    ear, place = listening()
    chunks = ear.chunks("csv", 3)
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        for _ in range(5):
            mouth.sendto(b"1,2,3\n", place)
            other.sendto(b"9,9,9\n", place)
        pieces = [chunk[0] for chunk in islice(chunks, 10) if chunk]
        assert len(pieces) == 5
        assert not next(chunks)
        assert (np.concatenate(pieces) == [1, 2, 3]).all()
        time.sleep(0.5)
        other.sendto(b"9,9,9\n", place)
        (empty, _), (volts, _) = next(chunks), next(chunks)
    chunks.close()  # type: ignore[attr-defined]
    assert np.isnan(empty).all()
    assert (volts == [9, 9, 9]).all()
    assert "5 datagrams of other senders were left out" in capsys.readouterr().err
