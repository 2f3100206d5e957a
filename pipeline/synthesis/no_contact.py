"""Outputs of a sensor that nothing touches: at rest, and what the device, its pressure and its wires may add.

Of a signal other than gravity (waves, bumps, chirps, walks, steps) V_x and V_y change; V_z stays in every second stream
and changes alike in the others.
"""

from collections.abc import Callable

import numpy as np

from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.distribution import log_uniform
from softslide.pipeline.synthesis.electronics import ElectronicsSpread, draw_electronics, volts

REST_S = 3.0  # before the signal, in which a localizer learns the static output
# Largest output of a signal, g; of the article's accelerometer 5 to 300 mV, the weakest and the strongest contact.
LARGEST_G = (0.00625, 0.375)
WAVE_HZ = (0.05, 5.0)
BEGINS_S = 1.0  # a wave grows to its amplitude

# Static output (boards, 3) g, times since the signal began (n,) s and random numbers -> what is added (boards, 3, n) g.
Signal = Callable[[np.ndarray, np.ndarray, np.random.Generator], np.ndarray]


def rest(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Nothing but noise."""
    return np.zeros((*static_g.shape, len(time_s)))


def tilt(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The device is tilted by 2 to 20 deg within 1 to 30 s, about any level axis, and stays so."""
    angle, duration_s = log_uniform(random, (2.0, 20.0)), log_uniform(random, (1.0, 30.0))
    towards = random.uniform(0, 2 * np.pi)
    grown = angle * _smooth_step(time_s / duration_s)
    return _turned(static_g, np.deg2rad(grown), towards)


def rocking(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The device is tilted to and fro by 0.4 to 20 deg."""
    angle, towards = log_uniform(random, (0.4, 20.0)), random.uniform(0, 2 * np.pi)
    return _turned(static_g, np.deg2rad(angle * _wave(time_s, random)), towards)


def swaying(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The device is accelerated to and fro along a level line: alike in all accelerometers, and not in V_z."""
    towards = random.uniform(0, 2 * np.pi)
    along = np.array([np.cos(towards), np.sin(towards), 0.0])
    return np.tile(
        log_uniform(random, LARGEST_G) * along[:, None] * _wave(time_s, random), (len(static_g), 1, 1)
    )


def pressure(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The pressure changes by up to a quarter, in steps of 0.2 to 5 s or in waves: static tilts grow with it."""
    share = random.uniform(0.02, 0.25) * random.choice([-1.0, 1.0])
    if random.random() < 0.5:
        change = share * _wave(time_s, random)
    else:
        change = share * _smooth_step(time_s / log_uniform(random, (0.2, 5.0)))
    xy = static_g[:, :2, None] * (1.0 + change)
    z = np.sqrt(np.maximum((static_g**2).sum(axis=1)[:, None] - (xy**2).sum(axis=1), 0.0))
    return np.concatenate([xy, z[:, None]], axis=1) - static_g[:, :, None]


def wave(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A sine in each channel, of its own amplitude and phase and one frequency."""
    frequency = log_uniform(random, WAVE_HZ)
    phase = random.uniform(0, 2 * np.pi, (*static_g.shape, 1))
    return _channels(
        static_g, random, _smooth_step(time_s / BEGINS_S) * np.sin(2 * np.pi * frequency * time_s + phase)
    )


def line_wave(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """One sine along one direction of the channels."""
    return _channels(static_g, random, _wave(time_s, random))


def bumps(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """In each channel a bump of 0.3 to 4 s and its slope, in any proportion: what a slide's output looks like."""
    width_s = log_uniform(random, (0.3, 4.0))
    middle_s = 4.0 * width_s + random.uniform(0.0, 0.3, (*static_g.shape, 1)) * width_s
    u = (time_s - middle_s) / width_s
    mix = random.normal(size=(2, *static_g.shape, 1))
    shape = (mix[0] - mix[1] * u) * np.exp(-(u**2) / 2)
    return _channels(static_g, random, shape)


def chirp(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A sine in each channel whose frequency rises tenfold in 5 to 25 s, then stays."""
    low_hz, duration_s = log_uniform(random, (0.05, 0.5)), random.uniform(5.0, 25.0)
    frequency = low_hz * 10.0 ** np.minimum(time_s / duration_s, 1.0)
    turns = np.cumsum(frequency) * (time_s[1] - time_s[0])
    phase = random.uniform(0, 2 * np.pi, (*static_g.shape, 1))
    return _channels(static_g, random, _smooth_step(time_s / BEGINS_S) * np.sin(2 * np.pi * turns + phase))


def walk(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A random walk in each channel, smoothed over 0.1 to 2 s."""
    step_s = time_s[1] - time_s[0]
    smooth = max(round(log_uniform(random, (0.1, 2.0)) / step_s), 1)
    steps = random.normal(size=(*static_g.shape, len(time_s)))
    walked = np.cumsum(steps, axis=-1)
    summed = np.cumsum(walked, axis=-1)
    delayed = np.concatenate([np.zeros((*static_g.shape, smooth)), summed], axis=-1)[..., : len(time_s)]
    return _channels(static_g, random, (summed - delayed) / smooth)


def drift(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Every channel changes steadily, each at its own rate."""
    return _channels(static_g, random, time_s)


def step(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The channels change along one direction within 0.1 to 3 s, and stay so: a wire or a strap that is moved."""
    duration_s = log_uniform(random, (0.1, 3.0))
    return _channels(static_g, random, _smooth_step(time_s / duration_s))


def taps(static_g: np.ndarray, time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Knocks of 30 to 300 ms, one every 1 to 4 s, each along a direction of its own."""
    signal = np.zeros((*static_g.shape, len(time_s)))
    at_s = 0.0
    while (at_s := at_s + random.uniform(1.0, 4.0)) < time_s[-1]:
        width_s = log_uniform(random, (0.03, 0.3)) / 2
        signal += random.normal(size=(*static_g.shape, 1)) * np.exp(-(((time_s - at_s) / width_s) ** 2))
    return _channels(static_g, random, signal)


SIGNALS: dict[str, Signal] = {
    f.__name__: f
    for f in (rest, tilt, rocking, swaying, pressure, wave, line_wave, bumps, chirp, walk, drift, step, taps)
}
# Of the device's attitude, motion and pressure, as accelerometers show them.
OF_ACCELEROMETERS = tuple(f.__name__ for f in (tilt, rocking, swaying, pressure))


def untouched(
    sensor: Sensor, static_v: np.ndarray, signal: Signal, seconds: float, random: np.random.Generator
) -> np.ndarray:
    """volts (n, C) V of accelerometers that nothing touches: REST_S at rest, then `seconds` of the signal.

    static_v: (C,) V. The noise is the data sheet's.
    """
    boards = sensor.accelerometers
    zero_v = np.repeat([board.zero_g_v for board in boards], 3)
    volts_per_g = np.repeat([board.sensitivity_v_per_g for board in boards], 3)
    static_g = ((static_v - zero_v) / volts_per_g).reshape(-1, 3)
    gravity_g = static_g[:, :, None] + _added(static_g, signal, seconds, sensor.sample_rate_hz, random)
    exact = ElectronicsSpread(sensitivity=0.0, zero_g_v=0.0, cross_axis=0.0, turn_deg=0.0)
    return volts(gravity_g, draw_electronics(sensor, exact, random), random)


def disturbed(
    static: np.ndarray,
    noise: np.ndarray,
    per_g: float,
    signal: Signal,
    seconds: float,
    rate_hz: float,
    random: np.random.Generator,
) -> np.ndarray:
    """The same of any sensor's outputs (n, C), in their unit, for a signal that is not of gravity.

    static: (C,); noise: (C,) of a sample; per_g: what stands for 1 g.
    """
    added = per_g * _added(static.reshape(-1, 3) / per_g, signal, seconds, rate_hz, random)
    outputs = static + added.reshape(len(static), -1).T
    noisy: np.ndarray = outputs + noise * random.standard_normal(outputs.shape)
    return noisy


def _added(
    static_g: np.ndarray, signal: Signal, seconds: float, rate_hz: float, random: np.random.Generator
) -> np.ndarray:
    """(boards, 3, n) g: nothing for REST_S, then the signal."""
    count = round(seconds * rate_hz)
    rests = np.zeros((*static_g.shape, round(REST_S * rate_hz)))
    return np.concatenate([rests, signal(static_g, np.arange(count) / rate_hz, random)], axis=2)


def _smooth_step(u: np.ndarray) -> np.ndarray:
    u = np.clip(u, 0.0, 1.0)
    return u**2 * (3.0 - 2.0 * u)


def _wave(time_s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """(n,) a sine from 0, of WAVE_HZ."""
    return np.sin(2 * np.pi * log_uniform(random, WAVE_HZ) * time_s)


def _turned(static_g: np.ndarray, angle_rad: np.ndarray, towards_rad: float) -> np.ndarray:
    """What boards (boards, 3) g read less that, in a device tilted by angles (n,) about one level axis (Rodrigues)."""
    axis = np.array([-np.sin(towards_rad), np.cos(towards_rad), 0.0])
    across = np.cross(axis, static_g)[:, :, None]
    along = (static_g @ axis)[:, None, None] * axis[:, None]
    grown, turned = 1.0 - np.cos(angle_rad), np.sin(angle_rad)
    return across * turned + (along - static_g[:, :, None]) * grown


def _channels(static_g: np.ndarray, random: np.random.Generator, shape: np.ndarray) -> np.ndarray:
    """Any shape (n,) or (boards, 3, n), its largest value drawn and each channel's share of it drawn too."""
    shape = np.broadcast_to(shape, (*static_g.shape, shape.shape[-1]))
    signal = random.normal(size=(*static_g.shape, 1)) * shape
    if random.random() < 0.5:
        signal = signal * np.array([1.0, 1.0, 0.0])[:, None]
    return log_uniform(random, LARGEST_G) * signal / max(float(np.abs(signal[:, :2]).max()), 1e-12)
