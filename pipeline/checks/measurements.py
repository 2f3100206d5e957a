"""Measurements of one recording: clock, span, noise, tones, rest, signs. `findings` compares them with limits."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.signal import welch

from softslide.pipeline.checks.rail_run import rail_run
from softslide.pipeline.checks.zone_signs import rests_on_skin, sign_agreement
from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.recordings.successive_means import successive_means
from softslide.pipeline.sensor import Sensor

MAINS_HZ = (50.0, 60.0)
# The frequencies around it that the mains is compared with, on either side.
AROUND_MAINS_HZ = 5.0
# Of the mains, looked for at the least: those beyond half the sample rate are read folded (an assumption).
HARMONICS = 7
# A slide bends the skin slowly; above this frequency the spectrum is noise and pick-up.
NOISE_FROM_HZ = 20.0
# Half-overlapping seconds that the spectrum averages: 40 leave a standard deviation of 1 / sqrt(40), 16 %, in each
# frequency, and about 1 % in the median over the 400 frequencies of a recording at 1 kHz.
SECONDS = 40
# Samples whose noise is kept to be compared between recordings.
FINGERPRINT = 1000
# Differences whose correlation in white noise is beyond 0.95 once in 10^10: as of half as many that are independent.
LEAST_NOISE = 40
# Length of the means whose range shows whether anything was touched, s.
MEAN_S = 0.1


@dataclass(frozen=True)
class Measurements:
    """One recording's figures; arrays are (channels,) unless a shape is named.

    longest_step: in samples. span_v: highest less lowest reading. swing: highest less lowest mean of MEAN_S, over such
    a mean's standard deviation by the noise. rail_run: the longest run of equal
    samples at the highest or lowest reading. noise_v_rthz: density, V / sqrt(Hz). mains_v: amplitude at the
    nearer of 50 and 60 Hz. tone_hz, tone_ratio: the strongest other line and its power over the noise
    floor. rest_s: before the motion, NaN if unlabelled. rest_v: mean before it, or of the first half
    second. drift_v: rest after less rest before, NaN if either is absent or the object stays on the skin.
    agreement, compared_v: (accelerometers, 3, 2), see `zone_signs.sign_agreement`. landmarks: see `_landmarks`.
    fingerprint: (n, channels) noise of the first samples, each channel of unit norm. twin: the highest correlation of
    the noise before the motion, when nothing shakes the board, with another output's. echo: the highest
    autocorrelation of the noise at a lag of a fifth of a second or more.
    """

    name: str
    rate_hz: float
    longest_step: float
    span_v: np.ndarray
    swing: np.ndarray
    rail_run: np.ndarray
    noise_v_rthz: np.ndarray
    mains_hz: float
    mains_v: np.ndarray
    tone_hz: np.ndarray
    tone_ratio: np.ndarray
    rest_s: float
    rest_v: np.ndarray
    drift_v: np.ndarray
    agreement: np.ndarray
    compared_v: np.ndarray
    landmarks: np.ndarray
    fingerprint: np.ndarray
    twin: np.ndarray
    echo: np.ndarray


def measure(
    recording: Recording, labels: pd.Series, sensor: Sensor, level: Recording | None = None
) -> Measurements:
    """The figures of one recording; labels: its row of the manifest.

    level: the same without the motion of the sensor's base, for rest, drift and signs; None: it has no base.
    """
    level = level or recording
    time_s, volts = recording.time_s, recording.volts
    rate = sensor.sample_rate_hz
    start, end = float(labels["motion_start_s"]), float(labels["motion_end_s"])
    # Unlabelled recordings are taken to begin at rest.
    before = time_s < (time_s[0] + 0.5 if np.isnan(start) else start)
    # The skin creeps back for a while after the object has left.
    after = time_s > end + 0.25
    rest_v = level.volts[before].mean(axis=0) if before.any() else np.full(volts.shape[1], np.nan)
    settled = after.sum() > 0.25 * rate and before.any() and not rests_on_skin(labels, sensor)
    floor, frequency, power = _spectrum(volts, rate)
    mains_hz, mains_v = _mains(frequency, power, floor)
    tone_hz, tone_ratio = _tones(frequency, power, floor, rate)
    agreement, compared_v = sign_agreement(level, labels, sensor)
    return Measurements(
        name=recording.name,
        rate_hz=(len(time_s) - 1) / (time_s[-1] - time_s[0]),
        longest_step=float(np.diff(time_s).max() * rate),
        span_v=np.ptp(volts, axis=0),
        swing=_swing(volts, round(MEAN_S * rate), floor),
        rail_run=np.array([rail_run(column) for column in volts.T]),
        noise_v_rthz=np.sqrt(floor),
        mains_hz=mains_hz,
        mains_v=mains_v,
        tone_hz=tone_hz,
        tone_ratio=tone_ratio,
        rest_s=start - time_s[0],
        rest_v=rest_v,
        drift_v=level.volts[after].mean(axis=0) - rest_v if settled else np.full(volts.shape[1], np.nan),
        agreement=agreement,
        compared_v=compared_v,
        landmarks=_landmarks(volts),
        fingerprint=_noise(volts),
        twin=_twin(volts[before]),
        echo=_echo(volts, rate),
    )


def _swing(volts: np.ndarray, count: int, floor: np.ndarray) -> np.ndarray:
    """Highest less lowest mean of `count` samples, over its standard deviation in white noise of this density."""
    if not 0 < count <= len(volts):
        return np.full(volts.shape[1], np.nan)
    return np.ptp(successive_means(volts, count), axis=0) / np.sqrt(np.maximum(floor, 1e-300) / (2 * MEAN_S))


def _noise(volts: np.ndarray) -> np.ndarray:
    """Second differences (n, channels) of the first samples, at most FINGERPRINT, each channel of unit norm."""
    noise = np.diff(volts[: FINGERPRINT + 2], n=2, axis=0)
    return (noise / np.maximum(np.linalg.norm(noise, axis=0), 1e-300)).astype(np.float32)


def _twin(volts: np.ndarray) -> np.ndarray:
    """The highest correlation of each output's noise with another's; 0 where chance alone may be that high."""
    noise = _noise(volts)
    shared = np.abs(noise.T @ noise)
    np.fill_diagonal(shared, 0.0)
    return shared.max(axis=0) * (len(noise) >= LEAST_NOISE)


def _landmarks(volts: np.ndarray) -> np.ndarray:
    """Hashes (m,) of eight successive samples, at the one place in 64 that the hash itself picks.

    They travel with the samples, so that a copy is known by them wherever it begins.
    """
    if len(volts) < 8:
        return np.zeros(0, dtype=np.uint64)
    samples = pd.util.hash_pandas_object(pd.DataFrame(volts), index=False).to_numpy()
    odd = np.random.default_rng(64).integers(1, 2**62, 8, dtype=np.uint64) * np.uint64(2) + np.uint64(1)
    hashes = np.lib.stride_tricks.sliding_window_view(samples, 8) @ odd
    return np.unique(hashes[(hashes >> np.uint64(58)) == 0])


def _spectrum(volts: np.ndarray, rate_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Floor (channels,) V^2/Hz, frequencies (f,) Hz and power (f, channels) V^2/Hz above `NOISE_FROM_HZ`.

    Welch's method (P. D. Welch, IEEE Trans. Audio Electroacoust. 15, 1967): the mean over seconds that overlap by half,
    with Hann windows. The floor is the median over frequency. A
    recording of less than a quarter of a second has no spectrum: its floor is NaN.
    """
    length = min(max(int(rate_hz), 64), len(volts))
    if length < max(0.25 * rate_hz, 16):
        return np.full(volts.shape[1], np.nan), np.zeros(0), np.zeros((0, volts.shape[1]))
    hop = max(length // 2, 1)
    frequency, power = welch(
        volts[: length + (SECONDS - 1) * hop],
        rate_hz,
        window=np.hanning(length),
        noverlap=length - hop,
        detrend="constant",
        axis=0,
    )
    high = (frequency >= NOISE_FROM_HZ) & (frequency < 0.45 * rate_hz)
    if high.sum() < 8:
        high = frequency > frequency[-1] / 2
    return np.median(power[high], axis=0), frequency[high], power[high]


def _mains(frequency: np.ndarray, power: np.ndarray, floor: np.ndarray) -> tuple[float, np.ndarray]:
    """The stronger of 50 and 60 Hz, and its amplitude (channels,) V.

    It is of what stands out of the frequencies around, where a skin that vibrates under an object has power as well.
    """
    if len(frequency) < 2:
        return MAINS_HZ[0], np.zeros(power.shape[1])
    width = frequency[1] - frequency[0]
    amplitudes = []
    for mains in MAINS_HZ:
        off_hz = np.abs(frequency - mains)
        around = (off_hz > 2 * width) & (off_hz <= max(AROUND_MAINS_HZ, 4 * width))
        level = np.median(power[around], axis=0) if around.any() else floor
        excess = np.maximum(power[off_hz <= 2 * width] - level, 0).sum(axis=0) * width
        amplitudes.append(np.sqrt(2 * excess))
    strongest = int(np.argmax([amplitude.sum() for amplitude in amplitudes]))
    return MAINS_HZ[strongest], amplitudes[strongest]


def _tones(
    frequency: np.ndarray, power: np.ndarray, floor: np.ndarray, rate_hz: float
) -> tuple[np.ndarray, np.ndarray]:
    """The strongest line that is not a harmonic of the mains, (channels,) Hz, and its power over the floor."""
    other = np.all([_off_harmonics(frequency, mains, rate_hz) > 3 for mains in MAINS_HZ], axis=0)
    if not other.any():
        return np.full(power.shape[1], np.nan), np.zeros(power.shape[1])
    ratio = power[other] / np.maximum(floor, 1e-300)
    return frequency[other][ratio.argmax(axis=0)], ratio.max(axis=0)


def _echo(volts: np.ndarray, rate_hz: float) -> np.ndarray:
    """The highest autocorrelation of the second differences at a lag of a fifth of a second or more.

    Noise that a program repeats is correlated at long lags; a sensor's is not.
    Mains and its harmonics are taken out first.
    """
    noise = np.diff(volts[:16_384], n=2, axis=0)
    count, lag = len(noise), max(int(0.2 * rate_hz), 100)
    if count < 4 * lag:
        return np.zeros(volts.shape[1])
    length = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(noise - noise.mean(axis=0), length, axis=0)
    frequency = np.fft.rfftfreq(length, 1 / rate_hz)
    for mains in MAINS_HZ:
        spectrum[_off_harmonics(frequency, mains, rate_hz) < 1] = 0
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:count]
    return correlation[lag : count // 2].max(axis=0) / np.maximum(correlation[0], 1e-300)


def _off_harmonics(frequency: np.ndarray, mains: float, rate_hz: float) -> np.ndarray:
    """How far (f,) Hz are from the nearest harmonic of the mains, or what sampling folds it to; 0 among them."""
    harmonics = mains * np.arange(max(HARMONICS, int(rate_hz / 2 / mains)) + 1)
    seen = np.unique(np.abs((harmonics + rate_hz / 2) % rate_hz - rate_hz / 2))
    above = np.searchsorted(seen, frequency).clip(1, len(seen) - 1)
    return np.minimum(np.abs(frequency - seen[above - 1]), np.abs(frequency - seen[above]))
