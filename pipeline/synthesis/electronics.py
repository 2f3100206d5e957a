"""Board gravity in g becomes volts at the sample rate: what an accelerometer, its wires and an ADC add.

Gravity is filtered with the noise by the accelerometer's own low-pass; mains come in on the wires behind it. The
recorder is taken to pass no noise from above half its rate, so that the density at low frequencies is the data
sheet's.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from softslide.pipeline.sensor import NOISE_G_RTHZ, Sensor

# Freescale MMA7361L data sheet, rev. 0: bandwidth (3 dB), 400 Hz in x and y, 300 Hz in z; a supply of 3.3 V. Parts of
# other models are taken to be alike.
BANDWIDTH_HZ = (400.0, 400.0, 300.0)
SUPPLY_V = 3.3


@dataclass(frozen=True)
class ElectronicsSpread:
    """By how much parts differ from `sensor.toml`: standard deviations of normal draws, or bounds of log-uniform ones.

    sensitivity: relative error after a six-position calibration. zero_g_v: V. cross_axis: share of another axis.
    turn_deg: of a board about its normal as cast in. mains_g: bounds of the amplitude picked up, in g of the output;
    mains_hz: one of these. harmonic: share of the third harmonic. noise: density over the data sheet's.
    """

    sensitivity: float = 0.01
    zero_g_v: float = 0.02
    cross_axis: float = 0.01
    turn_deg: float = 1.0
    mains_g: tuple[float, float] = (0.0003, 0.002)
    mains_hz: tuple[float, ...] = (50.0, 60.0)
    harmonic: float = 0.2
    noise: float = 1.0

    def __post_init__(self) -> None:
        if not self.noise >= 0:
            raise ValueError(f"noise is {self.noise}; it must not be negative")


@dataclass(frozen=True)
class Electronics:
    """One specimen's electronics.

    volts_per_g: (boards, 3, 3) outputs by the board's axes. zero_v: (boards, 3). noise_g_rthz: (boards, 3).
    bandwidth_hz: of x, y, z. mains_v: (boards * 3, 4) amplitudes of sine and cosine, of the fundamental and of
    the third harmonic. adc_step_v: 0 for none.
    """

    rate_hz: float
    volts_per_g: np.ndarray
    zero_v: np.ndarray
    noise_g_rthz: np.ndarray
    bandwidth_hz: tuple[float, float, float]
    mains_hz: float
    mains_v: np.ndarray
    adc_step_v: float


def ideal_electronics(sensor: Sensor) -> Electronics:
    """What `sensor.toml` says to the letter, without noise, bandwidth or pick-up; the ADC's step stays."""
    parts = sensor.accelerometers
    return Electronics(
        sensor.sample_rate_hz,
        np.array([part.sensitivity_v_per_g * np.eye(3) for part in parts]),
        np.array([[part.zero_g_v] * 3 for part in parts]),
        np.zeros((len(parts), 3)),
        (np.inf, np.inf, np.inf),
        50.0,
        np.zeros((3 * len(parts), 4)),
        sensor.adc_step_v,
    )


def draw_electronics(sensor: Sensor, spread: ElectronicsSpread, random: np.random.Generator) -> Electronics:
    """The electronics of one specimen of this sensor."""
    ideal = ideal_electronics(sensor)
    boards = len(sensor.accelerometers)
    turn = np.deg2rad(spread.turn_deg) * random.standard_normal(boards)
    turned = np.zeros((boards, 3, 3))
    turned[:, 0, 0] = turned[:, 1, 1] = np.cos(turn)
    turned[:, 0, 1], turned[:, 1, 0] = np.sin(turn), -np.sin(turn)
    turned[:, 2, 2] = 1
    gain = 1 + spread.sensitivity * random.standard_normal((boards, 3, 1))
    crossed = np.eye(3) + spread.cross_axis * random.standard_normal((boards, 3, 3)) * (1 - np.eye(3))
    volts_per_g = np.array([part.sensitivity_v_per_g for part in sensor.accelerometers])
    low, high = np.log(spread.mains_g)
    amplitude = np.exp(random.uniform(low, high, (boards, 3))) * volts_per_g[:, None]
    phase = random.uniform(0, 2 * np.pi, (2, boards * 3))
    waves = np.array([1, spread.harmonic])[:, None] * amplitude.reshape(-1)
    mains = [wave * part(turn) for wave, turn in zip(waves, phase, strict=True) for part in (np.cos, np.sin)]
    return replace(
        ideal,
        volts_per_g=ideal.volts_per_g @ (gain * crossed) @ turned,
        zero_v=ideal.zero_v + spread.zero_g_v * random.standard_normal((boards, 3)),
        noise_g_rthz=np.full((boards, 3), spread.noise * NOISE_G_RTHZ["MMA7361L"]),
        bandwidth_hz=BANDWIDTH_HZ,
        # The grid holds its frequency to some hundredths of a hertz.
        mains_hz=float(random.choice(spread.mains_hz)) + 0.02 * random.standard_normal(),
        mains_v=np.stack(mains, axis=1),
    )


def volts(
    gravity_g: np.ndarray,
    electronics: Electronics,
    random: np.random.Generator,
    turns: float | None = None,
) -> np.ndarray:
    """Samples (n, boards * 3) V, in `Sensor.channels` order, of the boards' gravity (boards, 3, n) g.

    The values are single precision's, as a file keeps them. turns: the mains' phase at the first sample, in whole
    turns; None: drawn.
    """
    e = electronics
    boards, _, count = gravity_g.shape
    # One-sided density N: white noise of variance N^2 rate / 2.
    sigma = e.noise_g_rthz * np.sqrt(e.rate_hz / 2)
    sensed = (
        random.standard_normal((boards, 3, count), dtype=np.float32) * sigma.astype(np.float32)[..., None]
    )
    sensed += gravity_g
    start = random.standard_normal((boards, 3))
    for axis, bandwidth in enumerate(e.bandwidth_hz):
        if (forget := low_pass_pole(bandwidth, e.rate_hz)) > 0:
            # Begins as if it had run for ever: at the first gravity, with the noise that the filter leaves.
            settled = sigma[:, axis] * np.sqrt((1 - forget) / (1 + forget)) * start[:, axis]
            state = forget * (gravity_g[:, axis, 0] + settled).astype(np.float32)[:, None]
            coefficients = np.array([1 - forget], np.float32), np.array([1, -forget], np.float32)
            sensed[:, axis], _ = lfilter(*coefficients, sensed[:, axis], zi=state)
    output = np.matmul(e.volts_per_g.astype(np.float32), sensed).reshape(boards * 3, count)
    output += e.zero_v.astype(np.float32).reshape(-1, 1)
    if e.mains_v.any():
        output += _mains(e, count, random.uniform() if turns is None else turns)
    return digitized(output, e.adc_step_v).T


def low_pass_pole(bandwidth_hz: float, rate_hz: float) -> float:
    """The pole b of y_n = b y_(n-1) + (1 - b) x_n whose power gain is a half at the bandwidth; 0 above half the rate.

    |H|^2 = (1 - b)^2 / (1 - 2 b cos w + b^2) = 1/2 has the root b = p - sqrt(p^2 - 1), p = 2 - cos w.
    """
    if bandwidth_hz >= rate_hz / 2:
        return 0.0
    p = 2 - np.cos(2 * np.pi * bandwidth_hz / rate_hz)
    return float(p - np.sqrt(p**2 - 1))


def digitized(output_v: np.ndarray, step_v: float) -> np.ndarray:
    """The nearest multiples of the ADC's step between the supply's rails; 0 for no ADC."""
    if step_v == 0:
        return np.clip(output_v, 0, SUPPLY_V)
    codes = np.clip(np.rint(output_v * np.float32(1 / step_v)), 0, np.floor(SUPPLY_V / step_v + 1e-6))
    return (codes * step_v).astype(np.float32)


def _mains(electronics: Electronics, count: int, turns: float) -> np.ndarray:
    """(boards * 3, n) V; turns: the mains' phase at the first sample, in whole turns."""
    cycles = (turns + electronics.mains_hz / electronics.rate_hz * np.arange(count)) % 1.0
    angle = (2 * np.pi * cycles).astype(np.float32)
    sine, cosine = np.sin(angle), np.cos(angle)
    # sin 3a = 3 sin a - 4 sin^3 a, cos 3a = 4 cos^3 a - 3 cos a
    waves = np.stack([sine, cosine, sine * (3 - 4 * sine**2), cosine * (4 * cosine**2 - 3)])
    return electronics.mains_v.astype(np.float32) @ waves
