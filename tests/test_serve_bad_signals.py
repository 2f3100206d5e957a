"""Signals that are not what a stream should be: clocks that run fast, packets, lost samples, a contact at the start."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from streams import RATE_HZ, ZERO_V, pass_over, pushed, still, stream, write_csv

from softslide.features.errors import InputError
from softslide.features.estimate import Estimate, Reason
from softslide.serve.localizer import Localizer
from softslide.serve.predict import predict

SLIDE = stream(still(1.0), pass_over(3.0), still(0.8))


def share(estimates: list[Estimate]) -> float:
    return sum(estimate.valid for estimate in estimates) / len(estimates)


@pytest.mark.parametrize(("packet", "jitter_s"), [(1, 0.0), (50, 0.0), (1, 0.005)])
@pytest.mark.parametrize("rate_hz", [900.0, 1000.0, 1100.0])
def test_a_slide_lasts_as_long_as_its_stamps_say(
    localizer: Localizer, packet: int, jitter_s: float, rate_hz: float
) -> None:
    """A clock off by 10 % used to leave the speed off by as much; packets and jitter were never valid."""
    time_s = (np.arange(len(SLIDE)) // packet + 1) * packet / rate_hz
    time_s += np.random.default_rng(3).normal(0.0, jitter_s, len(SLIDE))
    plain = pushed(localizer, SLIDE)
    usual = localizer.window()
    found = pushed(localizer, SLIDE, time_s)
    window = localizer.window()
    assert window is not None
    assert usual is not None
    assert share(found) > 0.9 * share(plain)
    # A slide is cut at blocks of 20 ms.
    assert window.elapsed_s == pytest.approx(usual.elapsed_s * RATE_HZ / rate_hz, abs=0.1)
    assert found[-1].valid
    assert found[-1].offset_mm == pytest.approx(plain[-1].offset_mm, abs=0.2)


@pytest.mark.parametrize("value", [0.0, 3.3])
def test_samples_at_the_ends_of_the_supply_are_lost_ones(localizer: Localizer, value: float) -> None:
    """Bursts of zeros, or of full scale, are what a converter writes for nothing; they used to enter the means."""
    lost, marked = SLIDE.copy(), SLIDE.copy()
    for begin in np.random.default_rng(0).permutation(len(SLIDE) // 30)[:8] * 30:
        lost[begin : begin + 30] = value
        marked[begin : begin + 30] = np.nan
    assert list(map(repr, pushed(localizer, lost))) == list(map(repr, pushed(localizer, marked)))


@pytest.mark.parametrize("limit_v", [0.03, 0.06, 0.1])
def test_a_clipped_slide_is_given_up_and_the_next_one_is_read(localizer: Localizer, limit_v: float) -> None:
    """What a clipped channel shows passed for another contact, up to 10 mm away."""
    volts = stream(still(1.0), pass_over(3.0), still(2.0), pass_over(3.0, 0.02), still(0.8))
    at_rest = volts[:1000].mean(axis=0)
    clipped = volts.copy()
    clipped[:, :2] = np.clip(volts[:, :2], at_rest[:2] - limit_v, at_rest[:2] + limit_v)
    found = pushed(localizer, clipped)
    beyond = np.abs(volts[:, :2] - at_rest[:2]).max(axis=1).reshape(-1, 20).min(axis=1) > limit_v
    first, last = np.flatnonzero(beyond)[[0, -1]]
    # It is seen once 40 % of two blocks lie at the limit.
    assert not any(e.valid for e in found[first + 5 : 300])
    assert np.mean([e.reason is Reason.DEAD_CHANNEL for e in found[first + 5 : last - 5]]) > 0.9
    assert found[-1].valid


@pytest.mark.parametrize("part", np.linspace(0.1, 0.75, 6).round(3).tolist())
@pytest.mark.parametrize("seconds", [1.0, 3.0, 8.0])
def test_a_stream_that_begins_in_mid_contact_says_nothing_of_it(
    localizer: Localizer, part: float, seconds: float
) -> None:
    """The static output is not known while something moves; after rest the next slide is valid."""
    begun = pass_over(seconds)[round(part * seconds * RATE_HZ) :]
    found = pushed(localizer, stream(begun, still(2.5), pass_over(2.0), still(0.6)))
    first = len(begun) // 20
    assert share(found[: first + 60]) == 0.0
    assert found[-1].valid


def test_a_slide_after_half_a_second_of_rest_is_not_a_beginning_in_mid_contact(localizer: Localizer) -> None:
    for seed in range(12):
        assert pushed(localizer, stream(still(0.5), pass_over(1.5), still(0.6), seed=seed))[-1].valid


@pytest.mark.parametrize(
    ("function", "unit"),
    [(lambda v: 1000 * v, "mV"), (lambda v: (v - ZERO_V) / 0.8 * 9.80665, "m/s2"), (lambda v: v - 0.5, "")],
)
def test_recordings_in_another_unit_are_refused(
    bundle: Path, tmp_path: Path, function: Callable[[np.ndarray], np.ndarray], unit: str
) -> None:
    """By `predict`, whose error names the unit; a zero that is off is not another unit."""
    volts = function(stream(still(0.6), pass_over(1.0), still(0.4)))
    path = write_csv(tmp_path / "a.csv", volts)
    if not unit:
        assert len(list(predict(bundle, path))) == 1
        return
    with pytest.raises(InputError, match=f"a.csv: a0: .* they look like {unit}:"):
        list(predict(bundle, path))
