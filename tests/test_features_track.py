"""The tracker: batch equals stream, memory is bounded, and only slides count as slides."""

import tracemalloc

import numpy as np
import pytest
from streams import RATE_HZ, pass_over, still, stream

from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.features.stream.faults import SignalWatch
from softslide.features.stream.static_output import StaticOutput
from softslide.features.stream.tracker import SlideState, SlideTracker, track

CONDITIONING = Conditioning()


def blocks(*parts: np.ndarray, accelerometers: int = 1, seed: int = 0) -> np.ndarray:
    volts = stream(*parts, accelerometers=accelerometers, seed=seed)
    return block_means(volts, Conditioning(), RATE_HZ)


def run(tracker: SlideTracker, means: np.ndarray, healthy: np.ndarray | None = None) -> list[SlideState]:
    states = []
    for mean in means:
        tracker.push(mean, healthy)
        states.append(tracker.state)
    return states


@pytest.mark.parametrize(
    "conditioning", [CONDITIONING, Conditioning(delayed=0.2)], ids=["plain", "lag undone"]
)
def test_the_batch_form_is_the_stream(conditioning: Conditioning) -> None:
    means = blocks(still(0.6), pass_over(2.0), still(0.6))
    tracker = SlideTracker(conditioning, 3)
    for count, window in enumerate(track(means, conditioning, np.arange(1, len(means) + 1)), 1):
        tracker.push(means[count - 1])
        streamed = tracker.window()
        assert (window is None) == (streamed is None)
        if window is not None and streamed is not None:
            assert window.elapsed_s == streamed.elapsed_s
            assert (window.volts == streamed.volts).all()


@pytest.mark.parametrize("seconds", [1.0, 6.0, 40.0])
def test_a_window_holds_the_slides_mean(seconds: float) -> None:
    """Whatever the duration: no sample is thrown away."""
    means = blocks(still(0.6), pass_over(seconds)[: round(900 * seconds)])
    tracker = SlideTracker(CONDITIONING, 3)
    run(tracker, means)
    window = tracker.window()
    assert window is not None
    taken = round(window.elapsed_s / CONDITIONING.block_s)
    wanted = (means[-taken:] - tracker.static).mean(axis=0)
    assert window.volts.mean(axis=1) == pytest.approx(wanted, abs=1e-6)


def test_a_slide_after_a_slide_is_as_the_first_and_still_stands_after_a_touch() -> None:
    slide = blocks(still(0.6), pass_over(1.5), still(0.8))
    alone, after = SlideTracker(CONDITIONING, 3), SlideTracker(CONDITIONING, 3)
    run(alone, slide)
    run(after, np.concatenate([slide] * 3))
    final = after.final
    assert alone.final is not None
    assert final is not None
    assert final.elapsed_s == pytest.approx(alone.final.elapsed_s, abs=0.041)
    assert final.volts == pytest.approx(alone.final.volts, abs=0.012)
    down = np.linspace(0, 1, 60)[:, None] * np.array([0.1, 0.06, 0.0])
    states = run(after, blocks(down, still(1.5, down[-1]), down[::-1], still(0.6), seed=1))
    assert states[-1] is SlideState.ENDED
    assert after.final is final


def turning(turn_deg: float, amplitude_v: float = 0.15) -> np.ndarray:
    """(n, 3) V: a pulse of 2 s whose (V_x, V_y) keeps its direction for 0.5 s, and then turns by `turn_deg`."""
    time_s = np.arange(2000) / 1000
    angle = np.deg2rad(35.0 + turn_deg * np.clip((time_s - 0.5) / 0.5, 0.0, 1.0))
    strength = amplitude_v * np.sin(np.pi * time_s / 2) ** 2
    return strength[:, None] * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])


@pytest.mark.parametrize("amplitude_v", [0.08, 0.15, 0.3])
@pytest.mark.parametrize("turn_deg", [-30.0, -8.0, 8.0, 15.0])
def test_a_slide_may_change_its_signal_by_little(turn_deg: float, amplitude_v: float) -> None:
    """Far from the accelerometer V_x and V_y rise and fall nearly together; a seventh of the peak is motion enough."""
    tracker = SlideTracker(CONDITIONING, 3)
    states = run(tracker, blocks(still(0.6), turning(turn_deg, amplitude_v), still(0.8)))
    assert states[-1] is SlideState.ENDED
    assert tracker.final is not None
    assert tracker.final.elapsed_s == pytest.approx(2.0, abs=0.45)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("amplitude_v", [0.08, 0.15, 0.3])
def test_what_changes_in_strength_alone_is_not_a_slide(amplitude_v: float, seed: int) -> None:
    """Pressing and lifting at one place."""
    tracker = SlideTracker(CONDITIONING, 3)
    states = run(tracker, blocks(still(0.6), turning(0.0, amplitude_v), still(0.8), seed=seed))
    assert SlideState.SLIDE in states
    assert tracker.final is None


def test_what_slides_on_from_where_it_was_pressed_leaves_the_zero_as_it_is() -> None:
    """It is near its level from its first block on, as the blocks after a jump of the zero are."""
    tracker = SlideTracker(CONDITIONING, 3)
    run(tracker, blocks(still(1.0)))
    static = tracker.static.copy()
    slid = 1 + 0.12 * np.clip(np.arange(3000) / 1500, 0.0, 1.0)
    share = np.concatenate([np.linspace(0, 1, 600), np.ones(1200), slid])
    pressed = share[:, None] * np.array([0.03, 0.08, 0.0])
    states = run(tracker, blocks(still(1.0), pressed)[len(blocks(still(1.0))) :])
    assert states.count(SlideState.SLIDE) > 50
    assert tracker.known.all()
    assert tracker.static == pytest.approx(static, abs=1e-3)


@pytest.mark.parametrize("press_s", [0.15, 0.5, 2.0, 4.0])
def test_a_press_of_any_length_leaves_the_zero_as_it_is(press_s: float) -> None:
    """A jump of the zero is over within a block; a slow press is not, however little its first blocks show."""
    tracker = SlideTracker(CONDITIONING, 3)
    share = np.concatenate([np.linspace(0, 1, round(press_s * RATE_HZ)) ** 1.3, np.ones(1500)])
    means = blocks(still(1.0), share[:, None] * np.array([-0.12, 0.25, 0.0]))
    static = means[:40].mean(axis=0)
    assert SlideState.SLIDE in run(tracker, means)
    assert tracker.known.all()
    assert tracker.static == pytest.approx(static, abs=3e-3)


def test_a_slide_without_an_end_is_given_up() -> None:
    """A weak output that never returns is a shifted zero, not a slide."""
    short = Conditioning(longest_blocks=400)
    tracker = SlideTracker(short, 3)
    states = run(tracker, blocks(still(0.6), still(12.0, np.array([0.012, 0.0, 0.0]))))
    assert SlideState.SLIDE in states
    assert states[-1] is SlideState.REST
    assert tracker.static[0] == pytest.approx(1.65 + 0.012, abs=0.002)


def test_after_a_loss_nothing_begins_until_rest_is_found() -> None:
    tracker = SlideTracker(CONDITIONING, 3)
    means = blocks(still(0.6), pass_over(2.0), still(0.8))
    run(tracker, means[:60])
    run(tracker, means[60:70], np.array([False]))
    states = run(tracker, means[70:])
    assert set(states) == {SlideState.REST}
    assert tracker.window() is None
    assert run(tracker, blocks(pass_over(1.5), still(0.6), seed=2))[-1] is SlideState.ENDED


def watching(judged: int) -> SignalWatch:
    """Over three channels of 0 to 3.3 V, of which the first ones are judged."""
    return SignalWatch(np.zeros(3), np.full(3, 3.3), np.arange(3) < judged)


def test_a_channel_is_clipped_where_two_blocks_end_alike() -> None:
    """Some samples at one value may be chance, or a coarse converter; many, twice, at the end of the block are not."""
    random = np.random.default_rng(4)

    def noisy(level_v: float, limit_v: float = 9.0, step_v: float = 5e-4) -> np.ndarray:
        samples = level_v + random.normal(0.0, 0.005, (20, 3))
        samples[:, 0] = np.minimum(samples[:, 0], limit_v)
        return np.round(samples / step_v) * step_v

    watch = watching(2)
    assert watch.push(noisy(1.65)).healthy.all()
    # Most of the samples, then all.
    assert [watch.push(noisy(1.703, 1.7)).healthy.all() for _ in range(4)] == [True, True, False, False]
    assert not watch.push(noisy(1.8, 1.7)).healthy.any()
    assert watch.push(noisy(1.65)).healthy.all()
    # At the end of the range samples are lost, and are bridged for a while.
    for _ in range(3):
        judged = watch.push(noisy(1.65, 1.65) * [0.0, 1.0, 1.0])
        assert judged.healthy.all()
        assert judged.bridged.all()
    # A converter whose steps are the noise's size says the same often.
    coarse = watching(3)
    for _ in range(500):
        assert coarse.push(noisy(1.65, step_v=0.01)).healthy.all()


@pytest.mark.parametrize("steps", [3.0, 10.0])
def test_noise_is_never_taken_for_clipping(steps: float) -> None:
    """steps: standard deviation of the noise in steps of the converter."""
    watch = watching(3)
    random = np.random.default_rng(5)
    for _ in range(20):
        noise = np.round(random.normal(0.0, steps, (1000, 20, 3))) * 5e-4
        assert all(watch.push(block).healthy.all() for block in 1.65 + noise)


def test_memory_does_not_grow() -> None:
    tracker = SlideTracker(CONDITIONING, 3)
    means = blocks(still(0.6), pass_over(3.0), still(0.8))
    run(tracker, means)
    tracemalloc.start()
    try:
        run(tracker, np.tile(means, (5, 1)))
        before = tracemalloc.get_traced_memory()[0]
        run(tracker, np.tile(means, (20, 1)))
        assert tracemalloc.get_traced_memory()[0] - before < 20_000
    finally:
        tracemalloc.stop()


class Counting(StaticOutput):
    """Never takes the short way of a stream that has rested for long."""

    def follow_quiet(self, level_v: np.ndarray, oldest: np.ndarray) -> bool:
        return False


def test_the_short_way_of_a_long_rest_gives_the_same_numbers() -> None:
    conditioning = Conditioning(rest_blocks=60)
    rest = still(9.0, np.linspace(0.0, 0.006, 9000)[:, None])
    slides = (pass_over(1.5) + 0.006, still(4.0, 0.006), pass_over(1.2), still(4.0))
    means = blocks(rest, *slides, accelerometers=2)
    healthy = np.ones((len(means), 2), bool)
    healthy[300:320, 1] = healthy[760:770] = False
    short, counting = SlideTracker(conditioning, 6), SlideTracker(conditioning, 6)
    counting.static_output = Counting(conditioning, 6)
    states = []
    for mean, fine in zip(means, healthy, strict=True):
        short.push(mean, fine)
        counting.push(mean, fine)
        states.append(short.state)
        assert short.state is counting.state
        assert short.static.tobytes() == counting.static.tobytes()
        assert (short.known == counting.known).all()
    assert {*states} == {SlideState.REST, SlideState.SLIDE, SlideState.ENDED}
    # What it skips is the counting, so that is how it shows.
    assert short.static_output._averaged.max() < counting.static_output._averaged.max()


@pytest.mark.parametrize(
    "wrong",
    [{"delayed": 1.0}, {"delayed": -0.1}, {"tau_s": 0.0}, {"block_s": float("nan")}, {"release_v": 0.006}],
)
def test_inconsistent_constants_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Conditioning(**wrong)
