"""What a contact may do next: each hypothesis gets children that change speed, bend, stop, turn back, turn a corner,
start again, lift off or finish being pressed on, and two for the halves of a place that is known badly. The likelihood
of the next blocks decides between them.

Manoeuvres are a renewal process along the way: a hypothesis that has made few expects few (the rate's posterior mean
under a gamma prior), so that a straight slide grows sharp.
"""

from dataclasses import dataclass

import numpy as np

from softslide.features.contact.hypotheses import (
    ACCELERATION,
    CURVATURE,
    GAIN,
    HEADING,
    RISE,
    SPEED,
    Hypotheses,
    Y,
    correct,
    joined,
)


@dataclass(frozen=True)
class Manoeuvres:
    """Chosen on synthetic paths (experiments/LOG.md).

    prior_count, prior_mm: gamma prior of the manoeuvres' rate, 1/mm. steering: shares of a change of speed, a bend and
    both. speed: standard deviation of a change, a share of the speed; speed_mm_s: and at least this.
    acceleration: a share of the speed's square, 1/mm. curvature: 1/mm.
    stop, back, corner, lift: rates, 1/mm. rise: of a lift's gain, 1/s. lift_at_rest, whole, restart: probabilities at
    each branching.
    """

    prior_count: float = 0.5
    prior_mm: float = 12.0
    steering: tuple[float, float, float] = (0.4, 0.4, 0.2)
    speed: float = 0.5
    speed_mm_s: float = 0.1
    acceleration: float = 0.06
    curvature: float = 0.08
    stop: float = 0.012
    back: float = 0.006
    corner: float = 0.008
    lift: float = 0.02
    rise: float = 0.7
    lift_at_rest: float = 0.02
    whole: float = 0.3
    restart: float = 0.004


SLOW_MM_S = 0.3  # a contact this slow may start again in any direction
SLOW_PARENTS = 6
RESTART_HEADINGS = 6
RESTART_SPEEDS = ((0.8, 0.4), (3.0, 1.3))  # mm/s: mean and standard deviation
STOPPED_MM_S = 0.05
# A place whose standard deviation along one direction is beyond WIDE_MM is split in two, SPLIT standard deviations to
# either side, each of probability HALF; what is left of the variance is that of half a Gaussian (1 - 2 / pi).
WIDE_MM = 0.4
SPLIT = 0.8
HALF = 0.3
CORNER_RAD = (-1.2, 1.2)


def branched(
    bank: Hypotheses, parents: int, log_odds: float, gain_sd: float, probabilities: Manoeuvres
) -> Hypotheses:
    """The bank and the children of its best hypotheses: of at most `parents`, within `log_odds` of the best.

    A parent's way counts for the manoeuvres of this branching; it and its children begin the next with none.
    """
    order = np.argsort(-bank.log_weight, kind="stable")[:parents]
    best = order[bank.log_weight[order] > -log_odds]
    p = probabilities
    way = np.maximum(bank.way_mm[best], 0.02)
    bank.way_mm[best] = 0.0
    parent = bank.take(best)
    rate = (p.prior_count + parent.manoeuvres) / (p.prior_mm + parent.age_mm)
    chance = np.minimum(rate * way, 0.6)
    speed = np.abs(parent.state[:, SPEED])
    change = (p.speed * speed) ** 2 + p.speed_mm_s**2
    acceleration = (p.acceleration * speed**2) ** 2 + 0.05**2
    children = [bank, *_halves(parent)]
    for share, speeds, bends in zip(p.steering, (True, False, True), (False, True, True), strict=True):
        child = _child(parent, share * chance)
        if speeds:
            child.covariance[:, SPEED, SPEED] += change
            child.covariance[:, ACCELERATION, ACCELERATION] += acceleration
        if bends:
            child.covariance[:, CURVATURE, CURVATURE] += p.curvature**2
        children.append(child)
    stop = _child(parent, np.minimum(p.stop * way, 0.1))
    _set_speed(stop, 0.0, STOPPED_MM_S)
    back = _child(parent, np.minimum(p.back * way, 0.1))
    _set_speed(back, -back.state[:, SPEED], 0.3 * speed + 0.1)
    children += [stop, back]
    for turn in CORNER_RAD:
        corner = _child(parent, np.minimum(p.corner * way, 0.1))
        corner.state[:, HEADING] += turn
        corner.covariance[:, HEADING, HEADING] += 0.5**2
        _set(corner, CURVATURE, 0.0, 0.02)
        children.append(corner)
    slow = np.abs(bank.state[:, SPEED]) < SLOW_MM_S
    slow &= bank.log_weight > -log_odds
    if slow.any():
        at = np.flatnonzero(slow)
        at = at[np.argsort(-bank.log_weight[at], kind="stable")[:SLOW_PARENTS]]
        children += _restarts(bank.take(at), p.restart)
    whole = ~parent.partial
    if whole.any():
        # One that stands still is lifted after a time, not after a way.
        at_rest = np.where(speed[whole] < SLOW_MM_S, p.lift_at_rest, 0.0)
        lift = _child(parent.take(whole), np.minimum(p.lift * way[whole] + at_rest, 0.1))
        lift.partial[:] = True
        lift.covariance[:, RISE, RISE] += p.rise**2
        children.append(lift)
    if parent.partial.any():
        children.append(_made_whole(parent.take(parent.partial), gain_sd, p.whole))
    return joined(children)


def merged(bank: Hypotheses, most: int, most_partial: int, log_odds: float) -> Hypotheses:
    """The best hypotheses, like ones in one: at most `most` of a whole contact and `most_partial` of one that is
    pressed on or lifted, within `log_odds` of the best."""
    order = np.argsort(-bank.log_weight, kind="stable")
    order = order[bank.log_weight[order] > -log_odds]
    partial = bank.partial[order]
    order = order[np.where(partial, partial.cumsum() <= 3 * most_partial, (~partial).cumsum() <= 3 * most)]
    bank = bank.take(order)
    # x, y, heading, speed, acceleration, curvature, gain
    state = bank.state[:, :7]
    sd = np.sqrt(np.maximum(bank.covariance.diagonal(0, 1, 2)[:, :7], 0.0))
    sd = np.maximum(sd, [0.02, 0.02, 0.005, 0.02, 0.02, 0.001, 0.005])
    apart = np.abs(state[:, None] - state[None])
    apart[:, :, HEADING] = np.abs((apart[:, :, HEADING] + np.pi) % (2 * np.pi) - np.pi)
    less, more = np.minimum(sd[:, None], sd[None]), np.maximum(sd[:, None], sd[None])
    alike = (
        (apart < 0.6 * less).all(2)
        & (more < 1.6 * less).all(2)
        & (bank.partial[:, None] == bank.partial[None])
    )
    kept: list[int] = []
    left = {False: most, True: most_partial}
    free = np.ones(len(bank), dtype=bool)
    for n in range(len(bank)):
        if free[n] and left[bool(bank.partial[n])]:
            same = alike[n] & free
            bank.log_weight[n] = np.logaddexp.reduce(bank.log_weight[same])
            free &= ~same
            kept.append(n)
            left[bool(bank.partial[n])] -= 1
    bank = bank.take(np.array(kept))
    bank.log_weight -= bank.log_weight.max()
    return bank


def _child(parent: Hypotheses, chance: np.ndarray | float) -> Hypotheses:
    child = parent.take(slice(None))
    child.log_weight += np.log(chance)
    child.manoeuvres += 1.0
    child.way_mm[:] = 0.0
    return child


def _halves(parent: Hypotheses) -> list[Hypotheses]:
    """What is uncertain along one direction of the skin, as two halves of it.

    A filter is linear in the place. Near a fold of the map one that covers both sides follows neither.
    """
    variance, axes = np.linalg.eigh(parent.covariance[:, :2, :2])
    wide = np.flatnonzero(variance[:, 1] > WIDE_MM**2)
    sd, axis = np.sqrt(variance[wide, 1]), axes[wide, :, 1]
    along = np.zeros((len(wide), parent.state.shape[1], 1))
    along[:, : Y + 1, 0] = axis / sd[:, None]
    children = []
    for side in (-SPLIT, SPLIT):
        child = parent.take(wide)
        # The state given the place along the axis: shifted, and with less left of it.
        one = np.ones((len(wide), 1, 1))
        correct(child, along, side * one, SPLIT**2 * one)
        child.log_weight += np.log(HALF)
        children.append(child)
    return children


def _set(bank: Hypotheses, n: int, value: np.ndarray | float, sd: np.ndarray | float) -> None:
    """Number n of the state anew, of all or (N,), correlated with nothing."""
    bank.state[:, n] = value
    bank.covariance[:, n, :] = 0.0
    bank.covariance[:, :, n] = 0.0
    bank.covariance[:, n, n] = np.square(sd)
    bank.past_cross[..., n] = 0.0


def _set_speed(bank: Hypotheses, value: np.ndarray | float, sd: np.ndarray | float) -> None:
    _set(bank, SPEED, value, sd)
    _set(bank, ACCELERATION, 0.0, 0.01)


def _restarts(slow: Hypotheses, chance: float) -> list[Hypotheses]:
    """A contact at rest, or nearly, that sets off in any direction."""
    children = []
    for k in range(RESTART_HEADINGS):
        for speed, sd in RESTART_SPEEDS:
            child = _child(slow, chance)
            turned = child.state[:, HEADING] + k * 2 * np.pi / RESTART_HEADINGS
            _set(child, HEADING, turned, np.pi / RESTART_HEADINGS)
            _set(child, CURVATURE, 0.0, 0.02)
            _set_speed(child, speed, sd)
            children.append(child)
    return children


def _made_whole(partial: Hypotheses, gain_sd: float, chance: float) -> Hypotheses:
    """Contacts that have been pressed on: from now their gain is what slides repeat by."""
    child = _child(partial, chance)
    gap = 1.0 - child.state[:, GAIN]
    total = child.covariance[:, GAIN, GAIN] + gain_sd**2
    # The density of the prior of a gain between 0 and 1 is 1.
    child.log_weight -= 0.5 * (gap**2 / total + np.log(2 * np.pi * total))
    along = np.zeros((*child.state.shape, 1))
    along[:, GAIN] = 1.0
    correct(child, along, (gap / total)[:, None, None], 1.0 / total[:, None, None])
    child.partial[:] = False
    child.manoeuvres -= 1.0
    _set(child, RISE, 0.0, 0.0)
    return child
