"""A bank of hypotheses about one contact: a Gaussian sum (Alspach and Sorenson 1972) of extended Kalman filters.

Each holds a state and its covariance. The state of a sensor with C tilt channels, n = 11 + C numbers:
x, y (mm), heading (rad), speed along it (mm/s, negative: backwards), acceleration (mm/s2), curvature (1/mm), gain
(1: the calibration's), depth (mm off the map's), rise (1/s: of the gain, while the contact is pressed on or lifted),
the friction on the skin along x and y (1: as large as where the contact slides), and the map's residual in each channel
(V). For a lag each also holds where it was at the last steps, corrected by what was measured since: a fixed-lag
smoother by state augmentation (Anderson and Moore, Optimal Filtering, 1979, section 7.3).
"""

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from softslide.features.contact.response_surface import ResponseSurface

X, Y, HEADING, SPEED, ACCELERATION, CURVATURE, GAIN, DEPTH, RISE, FRICTION_X, FRICTION_Y = range(11)
FRICTION = slice(FRICTION_X, FRICTION_Y + 1)
MOTION = slice(X, SPEED + 1)  # what is reported, and remembered
RESIDUAL = 11

# Of way, over which the friction's direction follows the motion's (measured on the emulator).
FRICTION_MM = 0.35
# Of way, over which the map's residual is correlated: between one and two knots of its splines.
RESIDUAL_MM = 4.0
ACCELERATION_MM = 12.0  # of way, over which a change of speed goes on
MANOEUVRE_MM = 25.0  # of way, over which manoeuvres are remembered
# Of the present output: what friction's dependence on the path adds at 0.1 (rms, simulated).
PEAK_SHARE = 0.01
# Of the present output, over 1 s: how much the shape of the response changes while a contact is pressed on.
PARTIAL_SHARE = 0.02
MISFIT_S = 0.5  # memory of the misfit


@dataclass(frozen=True)
class MotionNoise:
    """Standard deviations that a hypothesis grows by over 1 mm of way between manoeuvres.

    place: mm. heading: rad. speed, acceleration: shares (of the speed; of its square). curvature: 1/mm. gain: 1.
    depth: mm. friction: 1; turned: a share of its way towards the motion's direction, which it takes late and then at
    once, from a rest or after a turn (paths solved step by step, experiments/LOG.md). rise: 1/s, over 1 s, while the
    contact is pressed on or lifted.
    """

    place: float = 0.01
    heading: float = 0.01
    speed: float = 0.03
    acceleration: float = 0.004
    curvature: float = 0.003
    gain: float = 0.003
    depth: float = 0.005
    friction: float = 0.05
    turned: float = 0.5
    rise: float = 0.2


@dataclass
class Hypotheses:
    """N hypotheses.

    state: (N, n). covariance: (N, n, n).
    log_weight: (N,), the largest is 0. partial: (N,) bool, whether the contact is being pressed on or lifted.
    misfit: (N,), the innovation's chi-square over C, a running mean. way_mm: (N,) since the last branching; age_mm:
    (N,) in all, forgotten over MANOEUVRE_MM, and so is manoeuvres: (N,).
    past: (N, K, 4), x, y, heading and speed at the last K steps, the newest first, NaN from before the hypothesis
    began; past_covariance: (N, K, 4, 4); past_cross: (N, K, 4, n), their covariance with the state.
    """

    state: np.ndarray
    covariance: np.ndarray
    log_weight: np.ndarray
    partial: np.ndarray
    misfit: np.ndarray
    way_mm: np.ndarray
    age_mm: np.ndarray
    manoeuvres: np.ndarray
    past: np.ndarray
    past_covariance: np.ndarray
    past_cross: np.ndarray

    def __len__(self) -> int:
        return len(self.state)

    def take(self, which: Any) -> "Hypotheses":
        """Some of them, as a copy."""
        return Hypotheses(*(getattr(self, f.name)[which].copy() for f in fields(self)))

    def likeliest(self, most: int) -> "Hypotheses":
        """The likeliest, at most `most`, in the order of their weights, as a copy."""
        return self.take(np.argsort(-self.log_weight, kind="stable")[:most])

    @property
    def sound(self) -> np.ndarray:
        """(N,) bool: whose weight and state are finite, and whose variances are not negative."""
        variance = self.covariance.diagonal(0, 1, 2)
        return np.isfinite(self.log_weight) & np.isfinite(self.state).all(1) & (variance >= 0.0).all(1)

    def beyond_mm(self, half_mm: tuple[float, float]) -> np.ndarray:
        """(N,) mm: how far outside the chamber, of half the sizes half_mm, each place is; negative inside."""
        return np.maximum(np.abs(self.state[:, X]) - half_mm[0], np.abs(self.state[:, Y]) - half_mm[1])

    @property
    def best_speed(self) -> float:
        """mm/s, of the likeliest."""
        return abs(float(self.state[self.log_weight.argmax(), SPEED]))

    @property
    def weight(self) -> np.ndarray:
        """(N,), the sum is 1."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return weight / weight.sum()


def joined(parts: list[Hypotheses]) -> Hypotheses:
    """All of them in one bank."""
    return Hypotheses(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Hypotheses)))


def placed(x_mm: np.ndarray, y_mm: np.ndarray, channels: int) -> np.ndarray:
    """States (N, n) of whole contacts at places (N,) mm, without motion, friction and residual."""
    state = np.zeros((len(x_mm), RESIDUAL + channels))
    state[:, X], state[:, Y], state[:, GAIN] = x_mm, y_mm, 1.0
    return state


def started(state: np.ndarray, sd: np.ndarray, log_weight: np.ndarray, partial: bool) -> Hypotheses:
    """New hypotheses from states (N, n), their standard deviations (N, n) and log weights (N,)."""
    count, size = state.shape
    covariance = np.zeros((count, size, size))
    covariance[:, range(size), range(size)] = sd**2
    zero = np.zeros(count)
    return Hypotheses(
        state,
        covariance,
        log_weight,
        np.full(count, partial),
        np.ones(count),
        zero.copy(),
        zero.copy(),
        zero.copy(),
        *_no_past(count, size, 0),
    )


def _no_past(count: int, size: int, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        np.full((count, steps, 4), np.nan),
        np.zeros((count, steps, 4, 4)),
        np.zeros((count, steps, 4, size)),
    )


def remembering(bank: Hypotheses, steps: int) -> Hypotheses:
    """A bank that has just begun, which remembers so many steps."""
    past, covariance, cross = _no_past(len(bank), bank.state.shape[1], steps)
    return replace(bank, past=past, past_covariance=covariance, past_cross=cross)


def remember(bank: Hypotheses) -> None:
    """Takes the present motion for the newest step of the past, after a measurement."""
    for past, newest in (
        (bank.past, bank.state[:, MOTION]),
        (bank.past_covariance, bank.covariance[:, MOTION, MOTION]),
        (bank.past_cross, bank.covariance[:, MOTION]),
    ):
        past[:, 1:] = past[:, :-1]
        past[:, :1] = newest[:, None]


def correct(bank: Hypotheses, along: np.ndarray, change: np.ndarray, less: np.ndarray) -> None:
    """Changes states and their past by J @ change, their covariance by -J @ less @ J', where J = covariance @ along.

    along: (N, n, m), change: (N, m, 1), less: (N, m, m).
    """
    crossed = bank.covariance @ along
    bank.state += (crossed @ change)[:, :, 0]
    covariance = bank.covariance - crossed @ less @ crossed.transpose(0, 2, 1)
    bank.covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    if not bank.past.shape[1]:
        return
    earlier = bank.past_cross @ along[:, None]
    gain = earlier @ less[:, None]
    bank.past += (earlier @ change[:, None])[..., 0]
    bank.past_covariance -= gain @ earlier.swapaxes(2, 3)
    bank.past_cross -= gain @ crossed.transpose(0, 2, 1)[:, None]


def predict(
    bank: Hypotheses, elapsed_s: float, residual_v: float, partial_v: float, noise: MotionNoise
) -> None:
    """Moves every hypothesis on by elapsed_s along its arc. residual_v: V, standard deviation of the map's
    residual; partial_v: V, what it grows by in 1 s while a contact is pressed on or lifted."""
    state, count, size = bank.state, len(bank), bank.state.shape[1]
    state[:, SPEED] += elapsed_s * state[:, ACCELERATION]
    speed, curvature = state[:, SPEED], state[:, CURVATURE]
    step = elapsed_s * speed
    way = np.abs(step)
    middle = state[:, HEADING] + 0.5 * curvature * step
    cos, sin = np.cos(middle), np.sin(middle)
    slope = np.zeros((count, size, size))
    diagonal = slope.reshape(count, -1)[:, :: size + 1]
    diagonal[:] = 1.0
    slope[:, X, HEADING], slope[:, X, SPEED] = -step * sin, elapsed_s * cos
    slope[:, Y, HEADING], slope[:, Y, SPEED] = step * cos, elapsed_s * sin
    slope[:, HEADING, SPEED], slope[:, HEADING, CURVATURE] = elapsed_s * curvature, step
    slope[:, SPEED, ACCELERATION] = slope[:, GAIN, RISE] = elapsed_s
    kept = np.exp(-way[:, None] / np.array([ACCELERATION_MM, RESIDUAL_MM, FRICTION_MM, MANOEUVRE_MM]))
    diagonal[:, ACCELERATION] = kept[:, 0]
    diagonal[:, FRICTION] = kept[:, 2:3]
    diagonal[:, RESIDUAL:] = kept[:, 1:2]
    motion, turning = _motion(state), 1.0 - kept[:, 2]
    slope[:, FRICTION_X, HEADING] = -turning * motion[:, 1]
    slope[:, FRICTION_Y, HEADING] = turning * motion[:, 0]
    turned = turning[:, None] * (motion - state[:, FRICTION])
    state[:, FRICTION] += turned
    state[:, X] += step * cos
    state[:, Y] += step * sin
    state[:, HEADING] += curvature * step
    state[:, ACCELERATION] *= kept[:, 0]
    state[:, GAIN] += elapsed_s * state[:, RISE]
    state[:, RESIDUAL:] *= kept[:, 1:2]
    covariance = slope @ bank.covariance @ slope.transpose(0, 2, 1)
    grown = covariance.reshape(count, -1)[:, :: size + 1]
    grown[:, X] += noise.place**2 * way
    grown[:, Y] += noise.place**2 * way
    grown[:, HEADING] += noise.heading**2 * way
    grown[:, SPEED] += (noise.speed * speed) ** 2 * way
    grown[:, ACCELERATION] += (noise.acceleration * speed * speed) ** 2 * way
    grown[:, CURVATURE] += noise.curvature**2 * way
    grown[:, GAIN] += noise.gain**2 * way
    grown[:, RISE] += np.where(bank.partial, noise.rise**2 * elapsed_s, 0.0)
    grown[:, DEPTH] += noise.depth**2 * way
    grown[:, FRICTION] += (noise.friction**2 * way)[:, None] + (noise.turned * turned) ** 2
    grown[:, RESIDUAL:] += (residual_v**2 * (1.0 - kept[:, 1] ** 2))[:, None]
    grown[:, RESIDUAL:] += np.where(bank.partial, partial_v**2 * elapsed_s, 0.0)[:, None]
    bank.covariance = covariance
    bank.past_cross = bank.past_cross @ slope.transpose(0, 2, 1)[:, None]
    bank.way_mm += way
    bank.age_mm = kept[:, 3] * (bank.age_mm + way)
    bank.manoeuvres *= kept[:, 3]


class LocalErrors(NamedTuple):
    """Standard deviations of the place (mm) and the gain (1) at which a measurement is what the map shows, independent
    from one measurement to the next."""

    place_mm: float
    gain: float


def update(
    bank: Hypotheses,
    volts: np.ndarray,
    variance: np.ndarray,
    surface: ResponseSurface,
    elapsed_s: float,
    local: LocalErrors | None = None,
) -> tuple[float, float]:
    """Corrects every hypothesis by one measurement and weighs it by its likelihood.

    volts: (C,) V, subtracted; variance: (C,) V^2 of its noise, infinite for a dead channel; local: further errors.
    -> the logarithm of the measurement's predicted density, less C/2 log(2 pi), and the chi-square over C of the
    hypothesis that is the likeliest after it.
    """
    count = len(bank)
    channels = np.flatnonzero(np.isfinite(variance))
    if not len(channels):
        return 0.0, 0.0
    shown, by_state = expected(bank, surface)
    volts, shown, by_state = volts[channels], shown[:, channels], by_state[:, channels]
    spread = by_state @ bank.covariance @ by_state.transpose(0, 2, 1)
    spread.reshape(count, -1)[:, :: len(channels) + 1] += variance[channels]
    if local is not None:
        slopes = by_state[:, :, : Y + 1]
        spread += local.place_mm**2 * (slopes @ slopes.transpose(0, 2, 1))
        spread += local.gain**2 * shown[:, :, None] * shown[:, None]
    gap = (volts - shown)[:, :, None]
    inverse = np.linalg.inv(spread)
    pull = inverse @ gap
    chi_square = (gap * pull).sum((1, 2))
    correct(bank, by_state.transpose(0, 2, 1), pull, inverse)
    # One outlying block must not decide between hypotheses: its likelihood is cut off.
    evidence = np.minimum(chi_square, OUTLIER) + _log_determinants(spread)
    before = np.logaddexp.reduce(bank.log_weight)
    bank.log_weight -= 0.5 * evidence
    log_density = float(np.logaddexp.reduce(bank.log_weight) - before)
    best = bank.log_weight.max()
    if np.isfinite(best):
        bank.log_weight -= best
    misfit = chi_square / len(channels)
    bank.misfit += min(elapsed_s / MISFIT_S, 1.0) * (misfit - bank.misfit)
    return log_density, float(misfit[bank.log_weight.argmax()])


def _log_determinants(spread: np.ndarray) -> np.ndarray:
    """(N,) of covariances (N, C, C); infinite for one that is not positive definite, which predicts nothing."""
    try:
        factor = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError:
        size = np.linalg.eigvalsh(np.nan_to_num(spread))
        good = size[:, 0] > 0.0
        return np.where(good, np.log(np.where(good[:, None], size, 1.0)).sum(1), np.inf)
    return 2.0 * np.log(factor.diagonal(0, 1, 2)).sum(1)


OUTLIER = 60.0  # chi-square beyond which one measurement says nothing more


def expected(bank: Hypotheses, surface: ResponseSurface) -> tuple[np.ndarray, np.ndarray]:
    """The subtracted output that each hypothesis expects (N, C) V, and its derivatives by the state (N, C, n)."""
    state, channels = bank.state, surface.channels
    response = surface.at(state[:, X], state[:, Y])
    gain = state[:, GAIN, None]
    mixture = np.empty((len(bank), 1, 4, 1))
    mixture[:, 0, 0, 0] = 1.0
    mixture[:, 0, 1:3, 0] = state[:, FRICTION]
    mixture[:, 0, 3, 0] = state[:, DEPTH]
    raw = (response * mixture).sum(2)
    by_state = np.zeros((len(bank), channels, state.shape[1]))
    by_state[:, :, X] = gain * raw[:, 1]
    by_state[:, :, Y] = gain * raw[:, 2]
    by_state[:, :, GAIN] = raw[:, 0]
    by_state[:, :, DEPTH] = gain * response[:, 0, 3]
    by_state[:, :, FRICTION_X] = gain * response[:, 0, 1]
    by_state[:, :, FRICTION_Y] = gain * response[:, 0, 2]
    by_state[:, range(channels), range(RESIDUAL, RESIDUAL + channels)] = 1.0
    return gain * raw[:, 0] + state[:, RESIDUAL:], by_state


def _motion(state: np.ndarray) -> np.ndarray:
    """(N, 2): the unit vector along the motion."""
    sign = np.where(state[:, SPEED] < 0.0, -1.0, 1.0)
    return np.stack([sign * np.cos(state[:, HEADING]), sign * np.sin(state[:, HEADING])], axis=1)
