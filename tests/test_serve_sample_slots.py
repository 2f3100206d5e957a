"""The sample clock: slots tell the stamps' time, whatever a clock does, and however the stream is cut."""

import numpy as np
import pytest

from serve.sample_slots import SampleClock

RATE_HZ = 1000.0
# Samples by which a slot may be told late (a lost sample is only sure then) and early (jitter of what comes in time).
LATE, EARLY = 0.5, 2.0


def placed(time_s: np.ndarray, longest: int = 140, chunk: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """The samples' numbers in slots, NaN where one was lost, and the time that each sample's slot tells."""
    clock = SampleClock(RATE_HZ, longest)
    slots: list[float] = []
    told = np.full(len(time_s), np.nan)
    numbers = np.arange(len(time_s), dtype=float)[:, None]
    for begin in range(0, len(time_s), chunk):
        for piece in clock.place(numbers[begin : begin + chunk], time_s[begin : begin + chunk]):
            for number in piece[:, 0]:
                if np.isfinite(number):
                    told[int(number)] = clock.start_s + len(slots) / RATE_HZ
                slots.append(float(number))
    return np.array(slots), told


@pytest.mark.parametrize("percent", [-0.5, -0.05, 0.0, 0.05, 0.5])
def test_slots_keep_the_time_of_a_clock_that_runs_fast_or_slow(percent: float) -> None:
    time_s = 70.0 + np.arange(20_000) / RATE_HZ / (1 + percent / 100)
    slots, told = placed(time_s)
    early = (told - time_s) * RATE_HZ
    assert early.max() < EARLY + 0.01
    assert early.min() > -LATE - 0.01
    # A slow clock's samples are further apart than slots: now and then one stays empty. None is thrown away.
    assert np.isfinite(slots).sum() == len(time_s)
    assert np.isnan(slots).sum() == pytest.approx(max(0.0, -percent / 100) * len(time_s), abs=2)


def test_lost_samples_leave_their_slots_empty() -> None:
    kept = np.sort(np.random.default_rng(0).permutation(5000)[:4700])
    slots, told = placed(kept / RATE_HZ)
    assert told == pytest.approx(kept / RATE_HZ, abs=1e-9)
    assert np.isnan(slots).sum() == kept[-1] - kept[0] + 1 - len(kept)


@pytest.mark.parametrize("jump_s", [3.0, -3.0])
def test_a_long_gap_and_a_clock_set_back_break_the_stream(jump_s: float) -> None:
    time_s = np.arange(2000) / RATE_HZ
    time_s[900:] += jump_s
    slots, told = placed(time_s)
    assert np.isnan(slots[900 : 900 + 140]).all()
    assert len(slots) == 2000 + 140
    assert told == pytest.approx(time_s, abs=1e-9)
