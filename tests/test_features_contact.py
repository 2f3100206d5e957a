"""The contact tracker: the map on the device, the filters' derivatives, tracks along known paths."""

from dataclasses import asdict

import numpy as np
import pytest
from tracked_map import (
    BLOCK_S,
    TWO_BOARDS,
    bank_of,
    followed,
    in_row,
    line,
    noisy_map,
    tracker,
    tracks_of,
    volts_along,
)

from softslide.features.contact.block_noise import BlockNoise
from softslide.features.contact.calibration import ContactCalibration
from softslide.features.contact.hypotheses import (
    FRICTION_X,
    FRICTION_Y,
    GAIN,
    HEADING,
    SPEED,
    MotionNoise,
    X,
    Y,
    expected,
    predict,
)
from softslide.features.contact.manoeuvres import HALF, Manoeuvres, branched
from softslide.features.contact.packed import packed
from softslide.features.contact.smooth_signal import SmoothSignal
from softslide.features.contact.track import Track
from softslide.features.contact.tracking_config import TrackingConfig
from softslide.features.stream.tracker import SlideState
from softslide.features.track_estimate import MISFIT, TrackLimits, judged
from softslide.models.response_map.card import contact_calibration


def test_the_surface_on_the_device_is_the_map() -> None:
    response = noisy_map()
    generator = np.random.default_rng(1)
    x, y = generator.uniform(-29, 29, (2, 200))
    value = contact_calibration(response).surface().at(x, y)[:, 0]
    for direction in (0.0, 1.0, 4.0):
        mixed = value[:, 0] + np.cos(direction) * value[:, 1] + np.sin(direction) * value[:, 2]
        wanted = response.response(x, y, direction)
        # Half precision keeps a coefficient to 1 in 2000.
        assert np.abs(mixed - wanted).max() < 1e-3 * np.abs(wanted).max()


def test_slopes_are_those_of_the_expected_output() -> None:
    """Central differences of the expected output by each number of the state."""
    response = noisy_map()
    surface = contact_calibration(response).surface()
    bank = bank_of(response)
    _, slopes = expected(bank, surface)
    for n in range(bank.state.shape[1]):
        step, sides = 1e-5, []
        for sign in (1, -1):
            moved = bank.take(slice(None))
            moved.state[:, n] += sign * step
            sides.append(expected(moved, surface)[0])
        assert slopes[:, :, n] == pytest.approx((sides[0] - sides[1]) / (2 * step), abs=1e-6)


def test_the_covariance_grows_by_the_slopes_of_the_motion() -> None:
    """Without noise, a small change of the state moves on as the prediction moves its covariance."""
    still = MotionNoise(**dict.fromkeys(MotionNoise.__dataclass_fields__, 0.0))
    bank = bank_of(noisy_map())
    bank.state[:, FRICTION_X : FRICTION_Y + 1] *= 0.5
    step = 1e-4
    for n in (X, Y, HEADING, GAIN, FRICTION_X, FRICTION_Y):
        moved = bank.take(slice(None))
        moved.state[:, n] += step
        moved.covariance[:] = 0.0
        moved.covariance[:, n, n] = step**2
        ahead = bank.take(slice(None))
        for each in (moved, ahead):
            predict(each, 0.04, 0.0, 0.0, still)
        gap = moved.state - ahead.state
        outer = gap[:, :, None] * gap[:, None]
        assert moved.covariance == pytest.approx(outer, abs=1e-3 * step**2), n


def test_a_place_known_badly_is_split_along_its_longest_axis() -> None:
    """The two halves have the mean and the covariance of the whole."""
    whole = bank_of(noisy_map(), count=1)
    whole.covariance[0, :2, :2] = [[0.9, 0.6], [0.6, 0.9]]
    whole.covariance[0, X, SPEED] = whole.covariance[0, SPEED, X] = 0.1
    whole.covariance[0, SPEED, SPEED] = 0.2
    bank = branched(whole, 3, 5.0, 0.02, Manoeuvres())
    halves = bank.take(np.flatnonzero(np.isclose(bank.log_weight, np.log(HALF)))[-2:])
    apart = halves.state[1] - halves.state[0]
    assert apart[:2] == pytest.approx(1.6 * np.sqrt(1.5) * np.array([0.5, 0.5]) ** 0.5 * np.sign(apart[0]))
    assert halves.state.mean(0) == pytest.approx(whole.state[0])
    joint = halves.covariance[0] + np.outer(apart, apart) / 4
    assert joint == pytest.approx(whole.covariance[0], abs=1e-9)
    sharp = bank_of(noisy_map(), count=1)
    assert len(branched(sharp, 3, 5.0, 0.02, Manoeuvres())) == len(bank) - 2


def test_prediction_moves_along_an_arc() -> None:
    bank = bank_of(noisy_map())
    bank.state[:, 4], bank.state[:, 5] = 0.0, 0.05
    before = bank.state.copy()
    for _ in range(50):
        predict(bank, 0.04, 1e-3, 0.0, MotionNoise())
    radius, turned = 1 / 0.05, 2.0 * before[:, SPEED] * 0.05
    left = np.stack([-np.sin(before[:, HEADING]), np.cos(before[:, HEADING])], axis=1)
    centre = before[:, :2] + radius * left
    assert bank.state[:, HEADING] == pytest.approx(before[:, HEADING] + turned)
    assert np.hypot(*(bank.state[:, :2] - centre).T) == pytest.approx(np.full(len(bank), radius), rel=1e-3)


@pytest.mark.parametrize("speed_mm_s", [1.0, 4.0, 11.0])
def test_a_straight_slide_is_followed_by_a_small_bank_until_its_release(speed_mm_s: float) -> None:
    path = np.concatenate([line(speed_mm_s), np.tile([[60.0, 6.0]], (60, 1))])
    tracks = followed(noisy_map(), path)
    late = [(tracks[n], place) for n, place in enumerate(path) if -5 < place[0] < 12]
    gaps = [np.hypot(*(t.mean[:2] - place)) for t, place in late if t is not None]
    speeds = np.array([np.hypot(*t.mean[2:]) for t, _ in late if t is not None])
    assert len(gaps) == len(late)
    assert np.median(gaps) < 0.3
    assert np.median(np.abs(speeds / speed_mm_s - 1)) < 0.05
    children = 7 + 12 + 2  # manoeuvres of one parent, restarts of a slow one
    most = TrackingConfig().most + TrackingConfig().parents * children
    assert max(t.hypotheses for t, _ in late if t is not None) <= most
    assert tracks[-1] is None


BOTH = np.ones(2, dtype=bool)  # channels
OUT_MM = np.arange(-29.0, 6.0, 0.06)
TURN_RAD = np.arange(0.0, 2 * np.pi, 3.0 * BLOCK_S / 8.0)  # 3 mm/s along a radius of 8 mm
ROUND_MM = 8.0 * np.stack([np.sin(TURN_RAD), 1 - np.cos(TURN_RAD)], axis=1) - [0.0, 4.0]


N = len(OUT_MM)
BACK = in_row(np.concatenate([OUT_MM, OUT_MM[::-1]]), 7.0), range(N + 60, N + 121), -3.0
STOP = in_row(np.concatenate([OUT_MM, np.full(100, OUT_MM[-1])])), range(N, N + 100), 0.0
CIRCLE = np.concatenate([in_row(OUT_MM[OUT_MM < 0], -4.0), ROUND_MM]), range(-630, -1), 3.0


@pytest.mark.parametrize(("path", "late", "speed_x"), [BACK, STOP, CIRCLE], ids=["back", "stop", "circle"])
def test_a_contact_that_manoeuvres_is_followed(path: np.ndarray, late: range, speed_x: float) -> None:
    """Back along its line, to a stop, and once around a circle."""
    tracks = followed(noisy_map(), path)
    found = [(t, path[n]) for n in late if (t := tracks[n]) is not None]
    assert len(found) == len(late)
    assert np.median([np.hypot(*(t.mean[:2] - place)) for t, place in found]) < 0.5
    track, place = found[-1]
    assert track.mean[2:] == pytest.approx([speed_x, 0.0], abs=0.5 if speed_x else 0.1)
    assert track.mean[:2] == pytest.approx(place, abs=0.5)


def test_a_contact_that_is_lifted_from_rest_stays_in_its_place() -> None:
    """Its output falls along one direction, as that of a slide over the skin's fold can."""
    out = np.arange(-29.0, 6.0, 0.08)
    path = in_row(np.concatenate([out, np.full(110, out[-1])]))
    volts = volts_along(noisy_map(), path)
    volts[-60:] *= np.linspace(1.0, 0.05, 60)[:, None]
    tracks = [t for t in tracks_of(noisy_map(), volts)[-40:-15] if t is not None]
    assert len(tracks) == 25
    places = np.array([t.mean[:2] for t in tracks if t.partial > 0.5])
    assert len(places) > 12
    assert np.hypot(*(places - path[-1]).T).max() < 1.0


def test_noise_alone_starts_nothing() -> None:
    still = tracker(noisy_map())
    assert all(
        still.push(v, False, BOTH) is None for v in np.random.default_rng(2).normal(0.0, 1e-3, (500, 2))
    )


def test_two_accelerometers_are_sharper_than_one_and_do_without_one() -> None:
    places = ((5.0, 0.0), (-8.0, 3.0))
    path = line(3.0)
    both = noisy_map(places=places)
    inside = np.flatnonzero(np.abs(path[:, 0]) < 15)

    def error(tracks: list[Track | None]) -> float:
        return float(np.median([np.hypot(*(tracks[n].mean[:2] - path[n])) for n in inside]))  # type: ignore[union-attr]

    assert error(followed(both, path)) < error(followed(noisy_map(), path))
    volts, halved = volts_along(both, path), tracker(both)
    usable = np.array([True, True, False, False])
    tracks = [halved.push(v * usable, bool(np.abs(v[:2]).max() > 0.008), usable) for v in volts]
    assert error(tracks) < 1.0


@pytest.mark.parametrize("times", [1.0, 5.0])
def test_the_noise_of_blocks_is_estimated_next_to_a_motion(times: float) -> None:
    """One channel is as noisy as at rest, the other by `times`; both go up and down, as those of a slide do."""
    rest_v = np.array([1e-3, 2e-3])
    slide = 0.1 * np.sin(2 * np.pi * 0.5 * BLOCK_S * np.arange(4000))[:, None]
    blocks = slide + np.random.default_rng(5).normal(0.0, rest_v * [1.0, times], (4000, 2))
    noise, seen = BlockNoise(rest_v, BLOCK_S), []
    for end in range(3, len(blocks)):
        noise.push(blocks[end - 3 : end])
        seen.append(noise.vibration_v2)
    assert np.mean(np.array(seen)[:, 0] > 0.0) < 0.01
    wanted = (times**2 - 1) * rest_v[1] ** 2
    assert np.mean(seen[50:], axis=0)[1] == pytest.approx(wanted, rel=0.1, abs=0.02 * rest_v[1] ** 2)
    noise.reset()
    assert not noise.vibration_v2.any()


@pytest.mark.parametrize("seed", range(3))
def test_a_contact_is_followed_over_a_skin_that_vibrates(seed: int) -> None:
    """Eight times the noise at rest, from the touch on: the track is not lost, and what it says of itself holds."""
    response, path = noisy_map(places=TWO_BOARDS), line(3.0)
    ringing = np.random.default_rng(seed).normal(0.0, 8e-3, (len(path), response.channels))
    volts = volts_along(response, path, seed)
    volts += ringing * (np.abs(volts).max(axis=1, keepdims=True) > 0.01)
    tracks = tracks_of(response, volts)
    found = [(t, path[n]) for n, t in enumerate(tracks) if abs(path[n, 0]) < 15 and t is not None]
    assert len(found) == int((np.abs(path[:, 0]) < 15).sum())
    within = [t.misfit < MISFIT and np.hypot(*(t.mean[:2] - place)) < 1.0 for t, place in found]
    assert np.mean(within) > 0.9


DAMAGED, OTHER_SIZE = "numbers of a map are damaged", "does not hold the 5832 numbers"
REFUSED = [
    ({"knots": 3}, "knots 3: out of range"),
    ({"scale_v": 0.0}, "0.0 is no number above 0"),
    ({"half_mm": float("nan")}, "nan is no number above 0"),
    ({"noise_v": (1e-3,)}, "does not hold the 2916 numbers"),
    ({"coefficients": packed(np.zeros(5, "<f2"))}, OTHER_SIZE),
    ({"coefficients": packed(np.zeros(10**6, "<f2"))}, OTHER_SIZE),
    ({"coefficients": "not base85"}, "bad base85"),
    ({"coefficients": "0" * 20}, DAMAGED),
    ({"coefficients": "9" * 20}, DAMAGED),
    ({"inflation_v_per_mm": (0.01, 0.02, 0.03)}, "3 inflation_v_per_mm, not 2"),
    ({"inflation_v_per_mm": (0.01, float("nan"))}, "inflation_v_per_mm nan: out of range"),
]


@pytest.mark.parametrize(("change", "words"), REFUSED)
def test_a_calibration_that_does_not_fit_is_refused(change: dict[str, object], words: str) -> None:
    whole = asdict(contact_calibration(noisy_map()))
    with pytest.raises(ValueError, match=words):
        ContactCalibration(**{**whole, **change})


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_lift_is_not_a_turn(seed: int) -> None:
    """What a contact shows that is lifted while it goes straight on fits a bent path too: no turn may be seen then."""
    response, speed = noisy_map(), 2.0
    path = line(speed, half_mm=29.0)[: round(38.0 / speed / BLOCK_S)]
    noise = np.random.default_rng(seed).normal(0.0, response.noise_v, (len(path), response.channels))
    gain = np.clip(1.0 - path[:, 0] / 9.0, 0.0, 1.0)[:, None]
    volts = noise + gain * (volts_along(response, path, seed) - noise)
    tracks = tracks_of(response, volts)
    late = [t for t, x_mm in zip(tracks, path[:, 0], strict=True) if x_mm > 0.0 and t is not None]
    means = [t.mean for t in late if t.partial < 0.3 and t.certain > 0.97]
    turns = [abs(np.degrees(np.arctan2(mean[3], mean[2]))) for mean in means]
    assert np.mean(np.array([*turns, 0.0]) > 20.0) < 0.1


@pytest.mark.parametrize("channels", [2, 4])
def test_a_wave_of_four_channels_keeps_its_direction_and_a_slide_does_not(channels: int) -> None:
    """Of two channels a slide over the board may come back along the direction that it came on."""
    response = noisy_map(places=TWO_BOARDS[: channels // 2])
    noise, random = np.full(channels, 1e-3), np.random.default_rng(7)
    along = np.array([0.1, 0.05, -0.08, 0.02])[:channels]
    wave = np.sin(2 * np.pi * 0.2 * BLOCK_S * np.arange(800))[:, None] * along
    smooth, still = SmoothSignal(noise, BLOCK_S), np.zeros(channels)
    smooth.reset(0.1 * along, np.zeros(channels))
    for volts in wave + random.normal(0.0, noise, wave.shape):
        smooth.push(volts, still)
    assert smooth.one_way is (channels == 4)
    # Along the line through the boards, and midway between them: where the fewest channels answer.
    for path in (line(3.0, y_mm=0.0), line(3.0, y_mm=0.0)[:, ::-1]):
        slide = volts_along(response, path)
        felt = int((np.abs(slide).max(axis=1) > 0.01).argmax())
        smooth.reset(slide[felt], np.zeros(channels))
        for volts in slide[felt:]:
            smooth.push(volts, still)
        assert not smooth.one_way


def test_a_slide_is_valid_and_a_wave_seldom() -> None:
    """A wave along one direction may be a press that comes and goes, or a slide forth and back over the board."""
    response, limits = noisy_map(), TrackLimits()

    def share_valid(tracks: list[Track | None]) -> float:
        found = [judged(t, 0.0, SlideState.SLIDE, (0.0, 0.0), 0.5, limits) for t in tracks if t is not None]
        return float(np.mean([j.valid for j in found]))

    waves = []
    for frequency_hz, along_y in ((0.1, 0.5), (0.2, 0.5), (0.2, -0.3), (0.4, 1.0)):
        phase = 2 * np.pi * frequency_hz * BLOCK_S * np.arange(800)
        wave = 0.15 * np.stack([np.sin(phase), along_y * np.sin(phase)], axis=1)
        wave = wave + np.random.default_rng(3).normal(0.0, 1e-3, wave.shape)
        tracked = tracker(response)
        waves.append(share_valid([tracked.push(v, n > 10, BOTH) for n, v in enumerate(wave)]))
    slide = followed(response, line(3.0))
    assert np.median([t.evidence.log_odds for t in slide if t is not None]) > 2.0
    assert share_valid(slide) > 0.6
    assert np.mean(waves) < 0.1


@pytest.mark.parametrize("seed", range(2))
def test_no_signal_makes_the_tracker_fail(seed: int) -> None:
    """Jumps, walks and steps far beyond any contact: every track is finite."""
    generator = np.random.default_rng(seed)
    tracked = tracker(noisy_map())
    walk = np.cumsum(generator.normal(0.0, 0.05, (400, 2)), axis=0)
    for volts in walk + (generator.random((400, 1)) < 0.02) * 2.0:
        track = tracked.push(volts, True, BOTH)
        assert track is None or np.isfinite(track.mean).all()
