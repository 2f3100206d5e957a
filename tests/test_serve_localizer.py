"""The runtime on good and bad signals: independent of chunks to the last bit, not valid where it cannot be right."""

import math
import resource
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from small_bundle import write_small_bundle
from streams import GRAVITY_V, RATE_HZ, ZERO_V, a_sensor, pass_over, pushed, still, stream

from softslide.features.card import Validity
from softslide.features.errors import InputError
from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState
from softslide.serve.localizer import Localizer

TWO_SLIDES = stream(still(0.6), pass_over(1.2), still(0.8), pass_over(0.7), still(0.5))
ONE_SLIDE = stream(still(0.6), pass_over(1.2), still(0.6))


@pytest.fixture(scope="module")
def pair(two_boards: Path) -> Localizer:
    return Localizer.load(two_boards)


def answers(
    localizer: Localizer, volts: np.ndarray, cuts: list[int], time_s: np.ndarray | None = None
) -> list[tuple]:
    """Every estimate of a fresh stream that comes in the pieces between the cuts, as tuples of texts."""
    localizer.reset()
    estimates: list[Estimate] = []
    for begin, end in pairwise([0, *sorted(cuts), len(volts)]):
        estimates += localizer.push(volts[begin:end], None if time_s is None else time_s[begin:end])
    return [tuple(map(repr, estimate)) for estimate in estimates]


def valid(estimates: list[Estimate]) -> np.ndarray:
    return np.array([estimate.valid for estimate in estimates])


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_estimates_do_not_depend_on_the_chunks(localizer: Localizer, data: st.DataObject) -> None:
    volts = TWO_SLIDES.copy()
    time_s = None
    if data.draw(st.booleans(), label="damaged"):
        generator = np.random.default_rng(data.draw(st.integers(0, 99)))
        volts[generator.random(volts.shape) < 0.02] = np.nan
        volts[1500:1580, 0] = 9.0
    if data.draw(st.booleans(), label="with a clock"):
        jitter_s = data.draw(st.sampled_from([4e-4, 5e-3]), label="jitter")
        generator = np.random.default_rng(data.draw(st.integers(0, 99)))
        time_s = np.arange(len(volts)) / RATE_HZ * 1.0005 + generator.uniform(0, jitter_s, len(volts)) + 100.0
        time_s[2500:] += data.draw(st.sampled_from([0.0, 0.003, 0.05, 4.0, -1.0]))
    cuts = data.draw(st.lists(st.integers(0, len(volts)), max_size=12))
    assert answers(localizer, volts, cuts, time_s) == answers(localizer, volts, [], time_s)


def test_a_slides_drift_is_of_the_accelerometers_it_is_read_from(pair: Localizer) -> None:
    """A tilted accelerometer is lost as the slide begins and returns before it ends, on any block."""
    rest, slide = still(0.6), pass_over(1.0)
    for blocks in range(50):
        lead = still(0.02 * blocks)
        volts = stream(lead, rest, slide, still(0.6), accelerometers=2)
        volts[:, 4] += 0.1
        begin = len(lead) + len(rest)
        volts[begin - 150 : begin + 200, 3:] = np.nan
        ended = [e for e in pushed(pair, volts) if e.state is SlideState.ENDED]
        assert ended[0].accelerometers == 1
        assert ended[0].turn_deg < 1.0


def test_single_samples_other_memory_layouts_and_feed_give_the_same_estimates(localizer: Localizer) -> None:
    whole = answers(localizer, TWO_SLIDES, [])
    assert answers(localizer, TWO_SLIDES, list(range(1, len(TWO_SLIDES)))) == whole
    assert answers(localizer, np.asfortranarray(TWO_SLIDES), [777]) == whole
    localizer.reset()
    localizer.feed(TWO_SLIDES[:1234])
    localizer.feed(TWO_SLIDES[1234:])
    assert tuple(map(repr, localizer.read())) == whole[-1]


def test_two_slides_give_two_estimates(localizer: Localizer) -> None:
    estimates = pushed(localizer, TWO_SLIDES)
    states = [estimate.state for estimate in estimates]
    changes = [a for a, b in zip(states, [None, *states], strict=False) if a is not b]
    assert changes == [SlideState.REST, *[SlideState.SLIDE, SlideState.ENDED] * 2]
    assert estimates[-1].valid
    assert estimates[-1].accelerometers == 1
    assert [e.time_s for e in estimates] == pytest.approx(0.02 * (1 + np.arange(len(estimates))))


def test_an_object_beyond_the_rim_is_held_where_it_left(tmp_path: Path) -> None:
    """A place 40 mm along a line of 30 deg, of a chamber of 50 mm: the line crosses the side at x = 25."""
    far = write_small_bundle(tmp_path / "far", a_sensor(), along_mm=40.0)
    estimates = [e for e in Localizer.load(far).push(TWO_SLIDES[:1800]) if e.valid]
    assert {(e.state, e.contact) for e in estimates} == {(SlideState.ENDED, "slide")}
    assert [e.x_mm for e in estimates] == pytest.approx(np.full(len(estimates), 25.0))
    assert [e.offset_mm for e in estimates] == pytest.approx(np.full(len(estimates), 5.0))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 3.4, -0.1, 1e308])
def test_few_lost_samples_are_left_out_and_a_long_loss_is_not_valid(localizer: Localizer, bad: float) -> None:
    few, many = ONE_SLIDE.copy(), ONE_SLIDE.copy()
    few[np.random.default_rng(1).random(len(few)) < 0.05] = bad
    last = pushed(localizer, few)[-1]
    assert last.valid
    assert last.offset_mm == pytest.approx(pushed(localizer, ONE_SLIDE)[-1].offset_mm, abs=0.1)
    many[1000:1400, 1] = bad
    assert not valid(pushed(localizer, many))[50:].any()
    assert localizer.push(stream(still(0.6), pass_over(1.2), still(0.6), seed=2))[-1].valid


def test_after_a_short_loss_estimates_are_valid_once_it_is_a_small_share(localizer: Localizer) -> None:
    volts = stream(still(0.6), pass_over(2.0), still(0.6))
    volts[1600:1660] = math.nan
    shown = valid(pushed(localizer, volts))
    assert shown[75]
    assert not shown[80:83].any()
    assert shown[-1]


def test_a_frozen_channel_or_stream_is_not_valid_until_it_works_again(localizer: Localizer) -> None:
    volts = stream(still(1.2), pass_over(1.2), still(0.6))
    volts[:, 1] = volts[0, 1]
    assert not valid(pushed(localizer, volts)).any()
    assert localizer.push(stream(still(0.6), pass_over(1.2), still(0.6), seed=3))[-1].valid
    assert not valid(pushed(localizer, np.full((5000, 3), 1.7))).any()


@pytest.mark.parametrize("level_v", [1.2, 0.0, 3.3, math.nan])
def test_a_dead_accelerometer_is_left_out(pair: Localizer, level_v: float) -> None:
    volts = stream(still(1.2), pass_over(1.2), still(0.6), accelerometers=2)
    assert pushed(pair, volts)[-1].accelerometers == 2
    volts[:, 3:] = level_v
    last = pushed(pair, volts)[-1]
    assert last.valid
    assert last.accelerometers == 1
    volts[:, 3:] = volts[:, :3] * 0.5
    assert pushed(pair, volts)[-1].accelerometers == 2


def test_an_accelerometer_that_fails_in_a_slide_is_left_out(pair: Localizer) -> None:
    volts = stream(still(0.6), pass_over(2.0), still(1.0), pass_over(1.2), still(0.6), accelerometers=2)
    volts[1200:3300, 3:] = math.nan
    estimates = pushed(pair, volts)
    assert [estimates[n].accelerometers for n in (55, 90, 160, -1)] == [2, 1, 1, 2]
    assert estimates[-1].valid


@pytest.mark.parametrize("level_v", [[0.12, 0.05, 0.0], [0.05, -0.02, 0.0]])
def test_a_touch_is_not_a_slide(localizer: Localizer, level_v: list[float]) -> None:
    """Something is set down, rests, and is lifted off."""
    level = np.array(level_v)
    down = np.linspace(0, 1, 80)[:, None] * level
    estimates = pushed(localizer, stream(still(0.6), down, still(1.5, level), down[::-1], still(0.8)))
    assert not valid(estimates).any()
    assert SlideState.ENDED not in {estimate.state for estimate in estimates}


def test_lifting_after_a_stop_holds_the_estimate(localizer: Localizer) -> None:
    slide = pass_over(1.6)[:900]
    lift = np.linspace(1, 0, 120)[:, None] * slide[-1]
    estimates = pushed(localizer, stream(still(0.6), slide, still(1.0, slide[-1]), lift, still(1.0)))
    assert estimates[-1].valid
    assert len({e.offset_mm for e in estimates if e.state is SlideState.ENDED}) == 1


def test_a_jump_of_the_zero_is_followed(localizer: Localizer) -> None:
    jump = np.array([0.05, -0.05, 0.02])
    shifted = stream(still(0.6), still(1.5, jump), pass_over(1.2) + jump, still(0.6, jump))
    estimates = pushed(localizer, shifted)
    assert not valid(estimates)[:100].any()
    assert estimates[-1].valid
    assert estimates[-1].zero_shift_v == pytest.approx(0.05, abs=0.003)
    clean = pushed(localizer, stream(still(2.1), pass_over(1.2), still(0.6)))[-1]
    assert estimates[-1].offset_mm == pytest.approx(clean.offset_mm, abs=0.1)


def test_gain_and_tilt_are_read_from_gravity(localizer: Localizer) -> None:
    turn = math.radians(5.0)
    gravity = 1.05 * 0.8 * np.array([math.sin(turn), 0.0, math.cos(turn)]) - [0.0, 0.0, 0.8]
    last = pushed(localizer, stream(still(2.0, gravity)))[-1]
    assert last.gain == pytest.approx(1.05, abs=0.002)
    assert last.turn_deg == pytest.approx(5.0, abs=0.1)


def test_nothing_is_valid_in_another_attitude(localizer: Localizer) -> None:
    """The same slide, turned over by 60 degrees and back: what gravity shows while nothing touches decides."""
    level = stream(still(0.6), pass_over(1.0), still(0.4))
    cos, sin = math.cos(math.radians(60.0)), math.sin(math.radians(60.0))
    turned = ZERO_V + (level - ZERO_V) @ np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]).T
    assert valid(pushed(localizer, level)).any()
    estimates = pushed(localizer, turned)
    assert not valid(estimates).any()
    assert {"attitude"} == {e.reason for e in estimates if e.state is SlideState.SLIDE}


def test_a_new_zero_leaves_the_time(localizer: Localizer) -> None:
    before = pushed(localizer, stream(still(0.6)))[-1]
    localizer.zero()
    assert not localizer.push(stream(still(0.02)))[-1].valid
    assert localizer.read().time_s == pytest.approx(before.time_s + 0.02)
    assert localizer.read().reason == "unknown_zero"


def test_a_slide_must_keep_the_length_of_gravity(localizer: Localizer) -> None:
    """Accelerometers that only tilt measure 1 g throughout; other signals need not."""
    slide = pass_over(1.2)
    assert valid(pushed(localizer, stream(still(0.6), slide, still(0.6)))).any()
    slide[:, 2] -= GRAVITY_V
    assert not valid(pushed(localizer, stream(still(0.6), slide, still(0.6)))).any()


def test_a_long_gap_in_time_restarts_the_stream_and_lost_samples_do_not(localizer: Localizer) -> None:
    time_s = 50.0 + np.arange(len(ONE_SLIDE)) / RATE_HZ
    kept = np.random.default_rng(0).random(len(ONE_SLIDE)) > 0.05
    whole = pushed(localizer, ONE_SLIDE, time_s)[-1]
    holes = pushed(localizer, ONE_SLIDE[kept], time_s[kept])[-1]
    assert holes.valid
    assert holes.time_s == pytest.approx(whole.time_s, abs=0.03) == pytest.approx(52.4, abs=0.03)
    assert holes.offset_mm == pytest.approx(whole.offset_mm, abs=0.1)
    for jump_s in (5.0, -5.0):
        jumped_s = time_s + jump_s * (np.arange(len(time_s)) >= 1200)
        estimates = pushed(localizer, ONE_SLIDE, jumped_s)
        assert not valid(estimates)[62:].any()
        assert estimates[-1].time_s == pytest.approx(52.4 + jump_s, abs=0.03)


SHAPES = (np.zeros(3), np.zeros((2, 4)), np.zeros((1, 2, 3)), [[1.0, 2.0, 3.0], [1.0]], None)
TYPES = (np.zeros((2, 3), complex), np.zeros((2, 3), bool), np.array([["1", "2", "3"]]))


@pytest.mark.parametrize("chunk", [*SHAPES, *TYPES], ids=str)
def test_a_malformed_chunk_is_refused_and_changes_nothing(localizer: Localizer, chunk: object) -> None:
    localizer.reset()
    localizer.feed(TWO_SLIDES[:1000])
    before = repr(localizer.read())
    with pytest.raises(InputError, match="push"):
        localizer.push(chunk)  # type: ignore[arg-type]
    for times in (np.zeros(4), np.full(5, math.nan), ["a"] * 5):
        with pytest.raises(InputError, match="time_s"):
            localizer.push(TWO_SLIDES[:5], times)  # type: ignore[arg-type]
    assert repr(localizer.read()) == before


def fuzzed(localizer: Localizer, chunks: int, seed: int) -> int:
    """Slides in chunks of any size, for a while clean, then spoilt in some way: no crash, nothing called valid that
    cannot be. Returns how many estimates were valid."""
    generator = np.random.default_rng(seed)
    odd = [math.nan, math.inf, -math.inf, 1e308, -1e308, 0.0, 3.3, 5e-324]
    count, place, now_s = 0, 0, 0.0
    for n in range(chunks):
        if n % 300 == 0:
            noise_v = generator.choice([0.0, 0.0, 0.01, 0.3, 10.0])
            hit = generator.choice([0.0, 0.0, 0.01, 0.1, 0.9])
            timed = generator.random() < 0.5
        size = int(generator.integers(0, 60))
        place = (place + size) % (len(TWO_SLIDES) - 60)
        chunk = TWO_SLIDES[place : place + size].copy()
        if noise_v:
            chunk += generator.normal(0.0, noise_v, chunk.shape)
        if hit:
            struck = generator.random(chunk.shape) < hit
            chunk[struck] = generator.choice(odd, int(struck.sum()))
        time_s = None
        if timed:
            steps = generator.choice([0.001, 0.0, 0.007, 5.0, -3.0], size, p=[0.998, 5e-4, 1e-3, 3e-4, 2e-4])
            time_s = now_s + np.cumsum(steps)
            now_s += float(steps.sum())
        for estimate in localizer.push(chunk, time_s):
            assert math.isfinite(estimate.time_s)
            assert not estimate.valid or sound(estimate, localizer.card.validity)
            count += estimate.valid
    return count


def sound(estimate: Estimate, limits: Validity) -> bool:
    """Whether an estimate is one that may be called valid: all numbers there, in their ranges and intervals."""
    e = estimate
    return (
        e.state is not SlideState.REST
        and e.accelerometers > 0
        and 0 <= e.direction_deg < 360
        and e.direction_lo_deg <= e.direction_deg <= e.direction_hi_deg < math.inf
        and limits.speed_mm_s[0] <= e.speed_mm_s <= limits.speed_mm_s[1]
        and 0 < e.speed_lo_mm_s <= e.speed_mm_s <= e.speed_hi_mm_s < math.inf
        and abs(e.offset_mm) <= limits.offset_mm
        and -math.inf < e.offset_lo_mm <= e.offset_mm <= e.offset_hi_mm < math.inf
        and math.isfinite(e.x_mm)
        and math.isfinite(e.y_mm)
    )


@pytest.mark.parametrize("chunks", [2000, pytest.param(1_000_000, marks=pytest.mark.long)])
def test_fuzzed_chunks_never_crash(localizer: Localizer, chunks: int) -> None:
    localizer.reset()
    assert fuzzed(localizer, chunks, 0 if chunks == 2000 else 1) > (100 if chunks == 2000 else 100_000)


def minute(number: int) -> np.ndarray:
    """(60000, 3) V of a day: rest with a zero that wanders, a slide, and now and then a touch or lost samples."""
    generator = np.random.default_rng(number)
    zero = 0.01 * np.sin(2 * np.pi * (number + np.arange(60_000)[:, None] / 60_000) / [200.0, 310.0, 450.0])
    signal = np.zeros((60_000, 3))
    slide = pass_over(generator.uniform(0.6, 6.0), generator.uniform(0.05, 0.25))
    begin = int(generator.integers(2_000, 30_000))
    signal[begin : begin + len(slide)] = slide
    if number % 5 == 0:
        signal[45_000:46_500] += [0.06, 0.03, 0.0]
    noise = generator.normal(0.0, 0.005, signal.shape)
    static = np.array([ZERO_V, ZERO_V, ZERO_V + GRAVITY_V])
    volts = np.round((static + zero + signal + noise) / 5e-4) * 5e-4
    if number % 7 == 0:
        volts[generator.random(len(volts)) < 0.01] = math.nan
    return volts


def replayed(bundle: Path, minutes: int) -> tuple[int, int]:
    """The same minutes to two localizers, by the second and in odd pieces: every answer is the same.

    Returns the slides found, and how many bytes of memory grew from the end of the first hour to the end.
    """
    regular, odd = Localizer.load(bundle), Localizer.load(bundle)
    generator = np.random.default_rng(0)
    slides, last = 0, math.nan
    kept = []
    for number in range(minutes):
        volts = minute(number)
        by_second = [e for second in np.split(volts, 60) for e in regular.push(second)]
        cuts = np.sort(generator.integers(0, len(volts), generator.integers(1, 200)))
        in_pieces = [e for piece in np.split(volts, cuts) for e in odd.push(piece)]
        assert len(by_second) == len(in_pieces) == 3000
        for a, b in zip(by_second, in_pieces, strict=True):
            assert a == b or repr(a) == repr(b)
        for estimate in by_second:
            if estimate.state is SlideState.ENDED and estimate.valid:
                slides += estimate.offset_mm != last
                last = estimate.offset_mm
        kept.append(resident_bytes())
    # The first hour fills what is kept for good: buffers, free lists. Of ten minutes the least, since a whole
    # minute's arrays are given back to the system at one time and not at another.
    return slides, min(kept[-10:]) - min(kept[50:60])


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from Linux's /proc")
def test_a_day_in_any_chunks_is_the_same_and_memory_does_not_grow(bundle: Path) -> None:
    slides, grown = replayed(bundle, 24 * 60)
    assert slides == 24 * 60
    assert grown < 1_000_000
