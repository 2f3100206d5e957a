"""Frames with marks between them: joined anywhere, read in any pieces, and never a wrong sample from a damaged one."""

from itertools import pairwise

import numpy as np
import pytest
from frames import frame
from hypothesis import given
from hypothesis import strategies as st

from softslide.features.errors import InputError
from softslide.serve.stream.framing import framing_of

SAMPLE = st.tuples(
    st.floats(0.0, 1e6), *3 * [st.floats(-10.0, 10.0, width=32) | st.just(0.0) | st.just(float("nan"))]
)


def read(pieces: list[bytes]) -> list[tuple[float, ...]]:
    framing = framing_of("cobs", 3)
    chunks = [chunk for piece in pieces for chunk in framing.read(piece)] + list(framing.end())
    return [(t, *v) for volts, time_s in chunks for t, v in zip(time_s.tolist(), volts.tolist(), strict=True)]


@given(st.lists(SAMPLE, min_size=1, max_size=20), st.lists(st.integers(0, 600), max_size=6))
def test_in_any_pieces(samples: list[tuple[float, ...]], cuts: list[int]) -> None:
    data = b"".join(map(frame, samples))
    ends = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    found = read([data[a:b] for a, b in pairwise(ends)])
    np.testing.assert_array_equal(found, samples)


@given(st.lists(SAMPLE, min_size=2, max_size=9), st.integers(0, 10**6), st.integers(1, 255))
def test_joined_late_or_damaged_it_loses_samples_and_makes_none(
    samples: list[tuple[float, ...]], place: int, change: int
) -> None:
    data = b"".join(map(frame, samples))
    sent = np.array(samples).tobytes()
    late = read([data[place % len(data) :]])
    damaged = bytearray(data)
    damaged[place % len(data)] ^= change
    hurt = read([bytes(damaged)])
    for found in (late, hurt):
        assert all(np.array(one).tobytes() in sent for one in found)
    assert len(late) >= len(samples) - 1 - place % len(data) // 24
    assert len(hurt) >= len(samples) - 2


def test_a_stream_of_something_else_is_an_error() -> None:
    framing = framing_of("cobs", 3)
    with pytest.raises(InputError, match="a frame does not end"):
        list(framing.read(b"1.65,1.65,2.45\n" * 9000))
