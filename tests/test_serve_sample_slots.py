"""The sample clock: slots keep the stamps' time, whatever a clock does, and however the stream is cut."""

import numpy as np
import pytest

from softslide.serve.sample_slots import SampleClock

RATE_HZ = 1000.0
# Samples by which a slot may be late (a lost sample is only sure then) and early (jitter of what comes in time).
LATE, EARLY = 0.5, 2.0


def placed(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The samples' numbers in slots, NaN where one was lost, and the time of each sample's slot."""
    clock = SampleClock(RATE_HZ, 140)
    slots: list[float] = []
    slot_s = np.full(len(time_s), np.nan)
    numbers = np.arange(len(time_s), dtype=float)[:, None]
    for begin in range(0, len(time_s), 25):
        for piece in clock.place(numbers[begin : begin + 25], time_s[begin : begin + 25]):
            for number in piece[:, 0]:
                if np.isfinite(number):
                    slot_s[int(number)] = clock.start_s + len(slots) / RATE_HZ
                slots.append(float(number))
    return np.array(slots), slot_s


@pytest.mark.parametrize("percent", [-20.0, -10.0, -0.5, -0.05, 0.0, 0.05, 0.5, 10.0, 100.0])
def test_slots_keep_the_time_of_a_clock_that_runs_fast_or_slow(percent: float) -> None:
    time_s = 70.0 + np.arange(20_000) / RATE_HZ / (1 + percent / 100)
    slots, slot_s = placed(time_s)
    used = np.isfinite(slot_s)
    early = (slot_s - time_s)[used] * RATE_HZ
    assert early.max() < EARLY + 0.01
    assert early.min() > -LATE - 0.01
    # A slow clock's samples are further apart than slots: now and then one stays empty. A fast clock's are closer, and
    # one is left out.
    wanted = (time_s[-1] - time_s[0]) * RATE_HZ
    surplus = len(time_s) - wanted
    assert (~used).sum() == pytest.approx(max(0.0, surplus), abs=4)
    assert np.isnan(slots).sum() == pytest.approx(max(0.0, -surplus), abs=4)
    assert len(slots) == pytest.approx(wanted, abs=4)


@pytest.mark.parametrize("bad_s", [1e306, -1e306, 1e20])
def test_a_time_beyond_all_bounds_breaks_the_stream_and_no_more(bad_s: float) -> None:
    time_s = np.arange(2000) / RATE_HZ
    time_s[900] = bad_s
    slots, slot_s = placed(time_s)
    assert len(slots) == 2000 + 2 * 140
    assert slot_s[901:] == pytest.approx(time_s[901:], abs=1e-9)


@pytest.mark.parametrize("rate_hz", [900.0, 1000.0, 1100.0])
@pytest.mark.parametrize(("packet", "late_s", "jitter_s"), [(1, 0.0, 0.005), (50, 0.0, 0.0), (50, 0.02, 0.0)])
def test_uneven_stamps_give_even_slots_at_the_true_rate(
    packet: int, late_s: float, jitter_s: float, rate_hz: float
) -> None:
    """Jitter of 5 ms, where stamps run back; one stamp a packet, of its last sample; packets up to 20 ms late."""
    samples = 20_000
    number, true_s = np.arange(samples) // packet, np.arange(samples) / rate_hz
    time_s = (number + 1) * packet / rate_hz + np.random.default_rng(1).uniform(0.0, late_s, samples)[number]
    slots, slot_s = placed(time_s + np.random.default_rng(0).normal(0.0, jitter_s, samples))
    settled = np.isfinite(slot_s) & (np.arange(samples) > 1000)
    # A slot is later or earlier than the truth by the same all along: a packet's wait, or the largest jitter.
    error = (slot_s - true_s)[settled]
    assert np.ptp(error) < 0.035
    rate = np.polyfit(true_s[settled], slot_s[settled], 1)[0]
    assert rate == pytest.approx(1.0, abs=0.001)
    # At the nominal rate hardly a slot stays empty, or a sample is left out.
    spare = abs(1.0 - rate_hz / RATE_HZ) * samples
    assert np.isnan(slots).sum() + np.isnan(slot_s).sum() < spare + 0.02 * samples


def test_samples_lost_from_packets_are_found() -> None:
    kept = np.delete(np.arange(10_000), slice(5010, 5040))
    slots, slot_s = placed(((kept // 50) + 1) * 50 / RATE_HZ)
    assert np.isnan(slots).sum() == pytest.approx(30, abs=EARLY)
    after = kept > 5400
    before = slot_s[2000] - kept[2000] / RATE_HZ
    assert slot_s[after] - kept[after] / RATE_HZ == pytest.approx(before, abs=EARLY / RATE_HZ)
