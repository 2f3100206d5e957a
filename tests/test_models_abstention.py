"""The default model says when it does not know, and goes on when one of two accelerometers dies.

A network trained on a small skin with two accelerometers, its bundle on the device's runtime. Every case is
tried with both accelerometers and with the second one dead, where the first is alone.
"""

import math

import numpy as np
import pytest
from bump_slides import (
    HALF_MM,
    RATE_HZ,
    REST_S,
    answer,
    as_recorded,
    at_rest,
    bump_folder,
    bump_sensor,
    lines,
    slide_volts,
)
from streams import pushed

from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState
from softslide.models.cnn.fit import CnnConfig, fit_cnn
from softslide.models.cnn.training import TrainingConfig
from softslide.models.export.bundle import write_bundle
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.serve.localizer import Localizer

# Training and export take a minute or two.
pytestmark = pytest.mark.long
SENSOR = bump_sensor(2)
LARGEST_OFFSET_MM = 9.0
CONFIG = CnnConfig(training=TrainingConfig(steps=2000, batch=128, average=0.99))
DEAD_V = 1.2
both_and_one = pytest.mark.parametrize("dead", [False, True], ids=["both", "one dead"])


@pytest.fixture(scope="module")
def localizer(tmp_path_factory: pytest.TempPathFactory) -> Localizer:
    root = tmp_path_factory.mktemp("abstention")
    calibrated = lines((0, 45, 90, 180, 225, 270), (-9, -6, -3, 0, 3, 6, LARGEST_OFFSET_MM), (5, 9, 15))
    folder = bump_folder(root / "lab", SENSOR, {"calibration": calibrated})
    fitted = fit_cnn(folder, CONFIG)
    windows = labelled_windows(folder, fitted.conditioning)
    write_bundle(fitted, SENSOR, windows, {}, root / "bundle")
    return Localizer.load(root / "bundle")


def estimates_of(localizer: Localizer, volts: np.ndarray, dead: bool = False) -> list[Estimate]:
    """Every estimate of a fresh stream; dead: the second accelerometer's channels stand still."""
    if dead:
        volts = volts.copy()
        volts[:, 3:] = DEAD_V
    return pushed(localizer, volts)


def shares_valid(localizer: Localizer, signals: list[np.ndarray], dead: bool, **noise: float) -> list[float]:
    """Of each subtracted signal (n, C) V, between rests, the share of estimates that are valid."""
    rest = at_rest(SENSOR, 1.5)
    shares = []
    for seed, signal in enumerate(signals):
        volts = as_recorded(SENSOR, np.concatenate([rest, signal, rest]), seed, **noise)
        shares.append(float(np.mean([estimate.valid for estimate in estimates_of(localizer, volts, dead)])))
    return shares


def errors(localizer: Localizer, dead: bool) -> np.ndarray:
    """Direction deg, speed %, offset mm (n, 3) at the end of slides on lines not calibrated; NaN where not valid."""
    slides = lines((20, 70, 110, 200, 250, 340), (-6.5, -1.5, 4.5), (12, 20))
    rows = []
    for seed, (direction, offset, speed) in enumerate(slides):
        last = estimates_of(localizer, slide_volts(SENSOR, direction, offset, speed, 1000 + seed), dead)[-1]
        assert last.accelerometers == (1 if dead else 2)
        _, turn = off_the_line(last, direction, offset, speed)
        row = [turn, 100 * abs(last.speed_mm_s / speed - 1), abs(last.offset_mm - offset)]
        rows.append(row if last.valid else [math.nan] * 3)
    return np.array(rows)


def test_an_estimate_survives_a_dead_accelerometer(localizer: Localizer) -> None:
    found = {dead: errors(localizer, dead) for dead in (False, True)}
    assert np.isfinite(found[False]).all()
    assert np.isfinite(found[True][:, 0]).mean() > 0.75
    assert (np.nanmean(found[False], axis=0) < [0.5, 1.0, 0.15]).all()
    assert (np.nanmean(found[True], axis=0) < [1.5, 3.0, 0.4]).all()


def at_scale(localizer: Localizer, scale: float) -> list[tuple[float, Estimate, Estimate]]:
    """Of slides on lines not calibrated: the offset, and the last estimate as it is and of outputs times `scale`."""
    found = []
    for seed, (direction, offset, speed) in enumerate(lines((20, 110, 250, 340), (-5.5, 3.5), (12,))):
        volts = slide_volts(SENSOR, direction, offset, speed, 2000 + seed)
        rest = volts[: round(0.5 * RATE_HZ)].mean(axis=0)
        usual, last = (estimates_of(localizer, rest + by * (volts - rest))[-1] for by in (1.0, scale))
        found.append((offset, usual, last))
    return found


@pytest.mark.parametrize("scale", [0.6, 0.8, 1.25, 1.6])
def test_slides_that_show_more_or_less_than_the_calibrations_have_wider_intervals(
    localizer: Localizer, scale: float
) -> None:
    """Another object, depth or pressure: what is believed holds, and is said to be less sure than ordinary slides."""
    found = [each for each in at_scale(localizer, scale) if each[2].valid]
    assert all(last.offset_lo_mm <= offset <= last.offset_hi_mm for offset, _, last in found)
    widths = [[e.offset_hi_mm - e.offset_lo_mm for e in (usual, last)] for _, usual, last in found]
    assert np.median([last / usual for usual, last in widths]) > 2.0


def test_an_accelerometer_that_dies_in_a_slide_is_left_out(localizer: Localizer) -> None:
    volts = slide_volts(SENSOR, 30.0, 2.0, 6.0, seed=1)
    volts[round(4.0 * RATE_HZ) :, 3:] = DEAD_V
    last = estimates_of(localizer, volts)[-1]
    assert (last.valid, last.accelerometers) == (True, 1)
    assert last.direction_deg == pytest.approx(30.0, abs=3.0)
    assert last.offset_mm == pytest.approx(2.0, abs=1.0)


@both_and_one
def test_no_contact_is_no_estimate(localizer: Localizer, dead: bool) -> None:
    assert shares_valid(localizer, [at_rest(SENSOR, 30.0)], dead) == [0.0]


@both_and_one
@pytest.mark.parametrize("noise_v", [0.02, 0.08, 0.3])
def test_noise_is_no_slide(localizer: Localizer, dead: bool, noise_v: float) -> None:
    """White noise, from a few times the usual to most of the supply."""
    assert max(shares_valid(localizer, [at_rest(SENSOR, 5.0)] * 2, dead, noise_v=noise_v)) == 0.0


@pytest.mark.parametrize("cycle_s", [0.3, 3.0, 20.0])
def test_wandering_noise_is_no_slide(localizer: Localizer, cycle_s: float) -> None:
    """Noise as slow as a slide, of a slide's size, each channel its own: two accelerometers contradict each other."""
    signals = [random_wave(12.0, cycle_s, 0.06, seed) for seed in range(3)]
    assert max(shares_valid(localizer, signals, dead=False)) == 0.0


@both_and_one
@pytest.mark.parametrize(("ramp_s", "most"), [(0.03, 0.0), (0.2, 0.0), (1.0, 0.02)])
def test_a_static_press_is_no_slide(localizer: Localizer, dead: bool, ramp_s: float, most: float) -> None:
    """Pressed in, held and let go, all over the skin. A press that takes a second begins like a faint, slow slide: at
    some places a few estimates still pass, a fiftieth of the stream on average."""
    places = [(x, y) for x in (-9.0, 7.0) for y in (-8.0, -1.0, 5.0)]
    push = np.clip(np.arange(round(5.0 * RATE_HZ)) / RATE_HZ / ramp_s, 0.0, 1.0)
    push = np.minimum(push, push[::-1])[:, None]
    signals = [push * answer(SENSOR, np.array([x]), np.array([y])) for x, y in places]
    assert max(np.abs(signal).max() for signal in signals) > 0.05
    assert np.mean(shares_valid(localizer, signals, dead)) <= most


@both_and_one
def test_another_sensor_s_signal_is_no_slide(localizer: Localizer, dead: bool) -> None:
    """A stick swept to and fro over wood by hand: strokes below 1 Hz, jerks, and the grain's rattle; no gravity."""
    assert max(shares_valid(localizer, [swept(12.0, seed) for seed in range(4)], dead)) == 0.0


@both_and_one
@pytest.mark.parametrize("offset_mm", [-12.0, 12.0])
def test_a_line_beyond_the_calibrated_offsets_is_tracked_with_intervals_that_hold(
    localizer: Localizer, dead: bool, offset_mm: float
) -> None:
    """No recording vouches for a straight slide there, but others cross the places: the contact is tracked."""
    speed_mm_s, held = 8.0, []
    for direction_deg in (0.0, 90.0, 180.0):
        volts = slide_volts(SENSOR, direction_deg, offset_mm, speed_mm_s, seed=5)
        estimates = estimates_of(localizer, volts, dead)
        assert SlideState.SLIDE in {estimate.state for estimate in estimates}
        for estimate in estimates:
            if not (estimate.valid and estimate.state is SlideState.SLIDE):
                continue
            off_mm, off_deg = off_the_line(estimate, direction_deg, offset_mm, speed_mm_s)
            assert off_mm < 5.0
            held.append(off_deg <= (estimate.direction_hi_deg - estimate.direction_lo_deg) / 2)
    assert len(held) > 100
    assert np.mean(held) >= 0.9


def off_the_line(
    estimate: Estimate, direction_deg: float, offset_mm: float, speed_mm_s: float
) -> tuple[float, float]:
    """How far an estimate of a slide of `slide_volts` is off its place (mm) and its direction (deg)."""
    along_mm = speed_mm_s * (estimate.time_s - REST_S) - HALF_MM
    cos, sin = math.cos(math.radians(direction_deg)), math.sin(math.radians(direction_deg))
    x_mm, y_mm = along_mm * cos - offset_mm * sin, along_mm * sin + offset_mm * cos
    turn_deg = abs((estimate.direction_deg - direction_deg + 180) % 360 - 180)
    return math.hypot(estimate.x_mm - x_mm, estimate.y_mm - y_mm), turn_deg


def random_wave(seconds: float, cycle_s: float, size_v: float, seed: int) -> np.ndarray:
    """(n, C) V: each channel a sum of eight sines about one cycle, begun at zero."""
    random = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    channels = len(SENSOR.channels)
    hertz = random.uniform(0.5, 1.5, (8, 1, channels)) / cycle_s
    phase = random.uniform(0, 2 * math.pi, (8, 1, channels))
    waves = np.sin(2 * math.pi * hertz * time_s[:, None] + phase).sum(axis=0)
    return size_v / 2.0 * (waves - waves[0])


def swept(seconds: float, seed: int) -> np.ndarray:
    """(n, C) V: the same hand on every accelerometer, 0.05 g of strokes and 0.01 g of rattle, gravity taken off."""
    random = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    stroke = 2 * math.pi * np.cumsum(0.6 + 0.15 * np.sin(0.9 * time_s + seed)) / RATE_HZ
    axes = random.uniform(0.4, 1.0, 3) * np.array([1.0, 0.9, 0.5])
    strokes = np.stack([np.cos(stroke + p) + 0.3 * np.cos(2 * stroke + 2 * p) for p in (0, 1, 2)], axis=1)
    rattle = 0.2 * np.abs(np.sin(stroke))[:, None] * random.normal(0.0, 1.0, (len(time_s), 3))
    signal = 0.8 * 0.07 * axes * (strokes + rattle)
    signal[:, 2] -= 0.8
    return np.tile(signal, (1, len(SENSOR.accelerometers)))
