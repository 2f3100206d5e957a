"""The signal path that fits a sensor: from its data sheet, and from what its recordings show before the motion."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from softslide.features.angles import touch_channels
from softslide.features.stream.conditioning import ONSETS, Conditioning, block_means
from softslide.pipeline.recordings.folder import Folder, Recording
from softslide.pipeline.recordings.gravity_length import gravity_sd_g
from softslide.pipeline.sensor import Sensor

# V/g of the sensor that the constants in V are made for, the article's MMA7361L.
REFERENCE_V_PER_G = 0.8
# Standard deviation (V) of a block's mean that they are made for; outputs in another unit are scaled to it.
REFERENCE_NOISE_V = 1.1e-3
# Of a tone at 60 Hz blocks of 20 ms leave 16 %: of 5 mg 0.6 mV, half the noise of a block's mean (experiments/LOG.md).
MAINS_G = 0.005
# Rest that separates 50 from 60 Hz: with a Hann window lines of 5 Hz.
LEAST_REST_S = 0.4
# So many recordings show the mains and the noise.
MOST_RECORDINGS = 24
# The trigger stays above so many standard deviations of the mean that it is compared with: with normal noise two
# channels reach six once in weeks of blocks, five in hours.
TRIGGER_SD = 6.0
USUAL = Conditioning()


def conditioning_for(folder: Folder, conditioning: Conditioning) -> Conditioning:
    """`conditioning` for the folder's sensor; constants that differ from the defaults were chosen, and stay.

    touch_axes are the sensor's; onset is "rim" for accelerometers, whose skin has one. scale brings volts to those of
    0.8 V/g, and outputs of another kind to the same noise at rest, so that thresholds and all that is learned mean the
    same at any sensitivity and in any unit.
    block_s holds a period of 60 Hz mains where `sensor.toml` names it, or where it shows at rest.
    Where the noise at rest is more than the thresholds allow for, they grow together.
    gravity_sd_g is what the slides show.
    """
    sensor, slides = folder.sensor, _some(folder)
    onset = ONSETS[0 if sensor.measures_gravity else 1]
    conditioning = replace(conditioning, touch_axes=sensor.touch_axes, onset=onset)
    rests = list(_rests(slides, sensor))
    if conditioning.scale == USUAL.scale and not sensor.measures_gravity:
        noise = _block_noise(rests, sensor.sample_rate_hz, conditioning)
        conditioning = replace(conditioning, scale=REFERENCE_NOISE_V / noise if noise > 0 else USUAL.scale)
    elif conditioning.scale == USUAL.scale:
        sensitivity = float(np.median([a.sensitivity_v_per_g for a in sensor.accelerometers]))
        conditioning = replace(conditioning, scale=REFERENCE_V_PER_G / sensitivity)
    rests = [volts * conditioning.scale for volts in rests]
    if conditioning.block_s == USUAL.block_s:
        mains_hz = sensor.mains_hz or _mains_hz(rests, sensor.sample_rate_hz)
        conditioning = replace(conditioning, block_s=1.0 / mains_hz)
    conditioning = _above_noise(rests, sensor.sample_rate_hz, conditioning)
    if conditioning.gravity_sd_g == USUAL.gravity_sd_g:
        conditioning = replace(conditioning, gravity_sd_g=gravity_sd_g(slides, sensor, conditioning))
    return conditioning


def _some(folder: Folder) -> list[tuple[Recording, float]]:
    """Recordings enough, of those whose moments are labelled, each with when it moves, s."""
    known = folder.manifest["motion_start_s"].dropna()
    some = known.iloc[:: max(1, len(known) // MOST_RECORDINGS)]
    return [(folder.load(str(name)), float(moves_s)) for name, moves_s in some.items()]


def _rests(slides: Sequence[tuple[Recording, float]], sensor: Sensor) -> Iterator[np.ndarray]:
    """Outputs (n, C) V that answer to a touch, before the motion."""
    touch = touch_channels(len(sensor.channels), sensor.touch_axes)
    for recording, moves_s in slides:
        rest = recording.volts[recording.time_s < moves_s - USUAL.block_s][:, touch]
        if len(rest) > LEAST_REST_S * sensor.sample_rate_hz:
            yield rest


def _mains_hz(rests: list[np.ndarray], rate_hz: float) -> float:
    """60 where that tone is the stronger one and its amplitude at rest above MAINS_G, else 50."""
    if not rests or rate_hz <= 2 * 60.0:
        return 50.0
    power = np.mean([[_amplitude(rest, rate_hz, hz) ** 2 for hz in (50.0, 60.0)] for rest in rests], axis=0)
    # The noise's own share: what neighbouring frequencies, free of mains, show.
    noise = np.mean([[_amplitude(rest, rate_hz, hz) ** 2 for hz in (42.0, 55.0)] for rest in rests])
    limit_v = MAINS_G * REFERENCE_V_PER_G
    return 60.0 if power[1] > power[0] and power[1] - noise > limit_v**2 else 50.0


def _amplitude(volts: np.ndarray, rate_hz: float, tone_hz: float) -> float:
    """Largest amplitude (V) over the channels of a tone in volts (n, C), under a Hann window."""
    weight = np.hanning(len(volts))
    turning = weight * np.exp(-2j * np.pi * tone_hz * np.arange(len(volts)) / rate_hz)
    return float(np.abs(turning @ (volts - volts.mean(axis=0))).max() * 2.0 / weight.sum())


def _above_noise(rests: list[np.ndarray], rate_hz: float, conditioning: Conditioning) -> Conditioning:
    """The same with its thresholds times what the noise at rest asks for; at least as they are."""
    if conditioning.trigger_v != USUAL.trigger_v:
        return conditioning
    level_sd = _block_noise(rests, rate_hz, conditioning) / np.sqrt(conditioning.trigger_blocks)
    times = float(TRIGGER_SD * level_sd / conditioning.trigger_v)
    if times <= 1.0:
        return conditioning
    names = ("trigger_v", "release_v", "calm_v", "still_peak_v")
    return replace(conditioning, **{name: times * getattr(conditioning, name) for name in names})


def _block_noise(rests: list[np.ndarray], rate_hz: float, conditioning: Conditioning) -> float:
    """Standard deviation (V) of a block's mean in the noisiest channel, median over rests (n, C) V; 0 without any."""
    plain = replace(conditioning, scale=1.0)
    means = [block_means(rest, plain, rate_hz) for rest in rests]
    deviations = [np.diff(m, axis=0).std(axis=0).max() / np.sqrt(2.0) for m in means if len(m) > 5]
    return float(np.median(deviations)) if deviations else 0.0
