"""Equilibrium by a held factor with Anderson acceleration, and continuation along the indenter's line.

A factorisation costs as much as several iterations, so a factor is held, over positions too, for as long as
Anderson acceleration converges with it faster than a new one is expected to. Each line starts from the
inflated, untouched skin and goes on in short steps: after a jump the rod can pierce the skin and
converge to a false equilibrium. Each search starts from the last solution plus half of the last step's change;
the whole change overshoots.

A highly inflated skin snaps through as the rod passes the dome's middle: the solution branch ends (a pivot becomes
negative) and Newton's method does not converge. A damped descent of the energy then leads to the
branch after the snap: steps of (K + eta M) with eta large enough for every pivot to be positive.
Steps that fail nevertheless are halved.
"""

import math
import time
from dataclasses import dataclass, field

import numpy as np

from softslide.pipeline.skin.anderson import AndersonMixing
from softslide.pipeline.skin.linear import linear_solver
from softslide.pipeline.skin.mesh import Mesh
from softslide.pipeline.skin.system import Load, Material, State, System

TOLERANCE_N = 3e-4
CAP_MM = 0.7  # no unknown moves further in one iteration
NEW_FACTOR_COST = 7  # held-factor iterations that assembling and factoring cost
MOST_FACTORS = 12
CREEP_STEPS = 80
CREEP_START_N_MM = 1e-3  # eta: per node, about a hundredth of the skin's stiffness
PIERCED = 0.6  # of the indenter's radius: deeper than any posture that holds, half way to coming out beyond
LONGEST_STEP_MM = 1.25  # of the indenter; a longer one is a jump
SHORTEST_STEP_MM = 0.05  # before a position is given up
LEAD = 0.5  # of the last step's change, taken as the start of the next
AIR_STEP_MPA = 2e-4
BALLOON = 0.4  # of the chamber's width: a skin this high is beyond its limit point
HEIGHT_TOLERANCE_MM = 1e-3
STATIC_TOLERANCE_N = 1e-6  # everything is measured against the untouched skin


class NoEquilibrium(Exception):
    """No equilibrium was found from the start of the search."""


@dataclass
class Statistics:
    """What the solves of a line cost."""

    positions: int = 0
    iterations: int = 0
    factors: int = 0
    creeps: int = 0
    halvings: int = 0
    deepest_mm: float = 0.0
    seconds: float = 0.0


@dataclass
class Skin:
    """A skin with its linear solver and the factor it holds. Not shared between threads."""

    mesh: Mesh
    material: Material
    statistics: Statistics = field(default_factory=Statistics)

    def __post_init__(self) -> None:
        self.system = System(self.mesh, self.material)
        self.linear = linear_solver()
        self._mixing = AndersonMixing(self.system.size)
        self.forget()

    def forget(self) -> None:
        """Drops the held factor and the last step, so that what follows does not depend on what was before."""
        self._has_factor = False
        # The posture before the last step, and its length in mm.
        self._last: tuple[State, float] | None = None

    def equilibrium(
        self, start: State, load: Load, tolerance_n: float = TOLERANCE_N
    ) -> tuple[State, np.ndarray]:
        """The posture in balance near `start`, and the force on the indenter (3,) N
        with the depth that it sinks into the skin, mm, as fourth.

        Raises:
            NoEquilibrium: the search did not end within `MOST_FACTORS` factorisations.
        """
        state = start.copy()
        residual, force = self.system.residual(state, load)
        if residual is None:
            raise NoEquilibrium("an element is inside out at the start")
        norm = float(np.linalg.norm(residual))
        factors = 0
        fresh = not self._has_factor
        self._mixing.restart()
        norms: list[float] = []
        while norm > tolerance_n:
            if fresh:
                if factors == MOST_FACTORS:
                    raise NoEquilibrium(f"{norm:.2g} N out of balance after {factors} factorisations")
                self.system.residual(state, load, wants_tangent=True)
                self.linear.factor(self.system.pattern)
                self._has_factor = True
                factors += 1
                self.statistics.factors += 1
                self._mixing.restart()
                norms, fresh = [], False
            self.statistics.iterations += 1
            correction = -self.linear.solve(residual)
            step = self._mixing.step(state.unknowns, correction)
            step *= min(1.0, CAP_MM / max(float(np.abs(step).max()), 1e-30))
            norms.append(norm)
            accepted = self._advance(state, step, load, norm)
            if accepted is None:
                if len(norms) == 1 and factors:
                    raise NoEquilibrium(f"{norm:.2g} N out of balance, and no step lowers it")
                fresh = True
                continue
            state, residual, force, norm = accepted
            fresh = _is_slow([*norms, norm], tolerance_n)
        return self.system.accept(state), force

    def creep(self, start: State, load: Load, tolerance_n: float = TOLERANCE_N) -> tuple[State, np.ndarray]:
        """As `equilibrium`, down the energy from a posture that has lost its balance; the end is stable.

        Raises:
            NoEquilibrium: not within `CREEP_STEPS`.
        """
        self.statistics.creeps += 1
        self._has_factor = False
        state, eta = start.copy(), CREEP_START_N_MM
        pattern = self.system.pattern
        diagonal = pattern.indptr[:-1]
        # A board resists like the nodes it replaces, by about a hundred square millimetres where it turns.
        weight = np.ones(self.system.size)
        self.system.boards(weight)[:] = [[25.0] * 3, [400.0] * 3]
        for _ in range(CREEP_STEPS):
            residual, force = self.system.residual(state, load, wants_tangent=True)
            if residual is None:
                break
            undamped = pattern.data[diagonal].copy()
            while True:
                pattern.data[diagonal] = undamped + eta * weight
                self.linear.factor(pattern)
                self.statistics.factors += 1
                if not self.linear.negative:
                    break
                eta = max(4 * eta, CREEP_START_N_MM)
            if np.linalg.norm(residual) <= tolerance_n and eta == 0.0:
                return self.system.accept(state), force
            step = -self.linear.solve(residual)
            step *= min(1.0, CAP_MM / max(float(np.abs(step).max()), 1e-30))
            while self.system.residual(State(state.unknowns + step, state.rotations), load)[0] is None:
                step /= 2
                if np.abs(step).max() < 1e-3:
                    raise NoEquilibrium("an element turns inside out")
            state.unknowns += step
            eta = eta / 4 if eta > CREEP_START_N_MM / 16 else 0.0
        raise NoEquilibrium(f"still creeping after {CREEP_STEPS} steps")

    def _advance(
        self, state: State, step: np.ndarray, load: Load, norm: float
    ) -> tuple[State, np.ndarray, np.ndarray, float] | None:
        """The step, shortened until it does not raise the imbalance much; None if no part of it will do."""
        for part in (1.0, 0.5, 0.25, 0.1):
            trial = State(state.unknowns + part * step, state.rotations)
            residual, force = self.system.residual(trial, load)
            if residual is not None:
                new = float(np.linalg.norm(residual))
                if new < 1.5 * norm:
                    return trial, residual, force, new
        return None

    def inflate(self, pressure_mpa: float, start: State | None = None, at_mpa: float = 0.0) -> State:
        """The untouched skin under air, by steps of pressure from rest or from a posture at `at_mpa`.

        Raises:
            NoEquilibrium: the pressure lies beyond the skin's limit.
        """
        self.forget()
        state = self.system.rest() if start is None else start
        at, step = at_mpa, AIR_STEP_MPA
        while at != pressure_mpa:
            to = at + math.copysign(min(step, abs(pressure_mpa - at)), pressure_mpa - at)
            try:
                new = self._settle(state, Load(to), STATIC_TOLERANCE_N)[0]
                if self.height(new) > BALLOON * np.ptp(self.mesh.nodes[:, :2], axis=0).min():
                    raise NoEquilibrium("the skin balloons")
            except NoEquilibrium:
                self.forget()
                step /= 4
                if step < AIR_STEP_MPA / 64:
                    raise NoEquilibrium(f"the skin balloons at {at:.3g} MPa") from None
                continue
            state, at = new, to
        return state

    def inflate_to(self, height_mm: float) -> tuple[float, State]:
        """The effective pressure, MPa, at which the skin stands so high, by the secant rule; and its posture.

        Raises:
            NoEquilibrium: the skin balloons before.
        """
        pressure, state, height = 0.0, self.system.rest(), 0.0
        # A membrane rises as the pressure's cube root, so the first steps are short.
        guess = AIR_STEP_MPA
        for _ in range(40):
            new = self.inflate(guess, state, pressure)
            slope = (self.height(new) - height) / (guess - pressure)
            pressure, state, height = guess, new, self.height(new)
            if abs(height - height_mm) < HEIGHT_TOLERANCE_MM:
                return pressure, state
            if not slope > 0.0:
                break
            guess = pressure + min((height_mm - height) / slope, 2 * AIR_STEP_MPA)
        raise NoEquilibrium(f"no pressure holds the skin at {height_mm:g} mm")

    def height(self, state: State) -> float:
        """How far the upper face's highest node stands over the flat skin, mm."""
        return float(self.system.places(state)[:, 2].max() - self.mesh.nodes[:, 2].max())

    def slide(
        self, inflated: State, pressure_mpa: float, centres: np.ndarray
    ) -> tuple[list[State | None], np.ndarray]:
        """The postures along a line of indenter centres (n, 3) mm, which begins clear of the skin.

        Returns:
            postures, None from where no equilibrium was found to the end of the line; forces (n, 3) N on the
            indenter, nan there.
        """
        self.forget()
        started = time.perf_counter()
        postures: list[State | None] = []
        forces = np.full((len(centres), 3), np.nan)
        state, before = inflated, centres[0]
        for n, centre in enumerate(centres):
            try:
                state, forces[n] = self._go(state, pressure_mpa, before, centre)
            except NoEquilibrium:
                postures.extend([None] * (len(centres) - n))
                break
            postures.append(state)
            before = centre
        self.statistics.positions += len(centres)
        self.statistics.seconds += time.perf_counter() - started
        return postures, forces

    def _go(
        self, state: State, pressure_mpa: float, before: np.ndarray, centre: np.ndarray
    ) -> tuple[State, np.ndarray]:
        """From one indenter centre to the next, never in a jump, in halves of halves where need be."""
        way = float(np.linalg.norm(centre - before))
        done, part = 0.0, 1.0 / max(1, math.ceil(way / LONGEST_STEP_MM - 1e-9))
        force = np.zeros(3)
        while done < 1.0 - 1e-9:
            old, new = (before + share * (centre - before) for share in (done, done + part))
            load = Load(pressure_mpa, new, old, self.system.places(state))
            guess = state
            if self._last is not None:
                guess = self.system.ahead(self._last[0], state, LEAD * part * way / self._last[1])
            try:
                settled, force = self._settle(state, load, guess=guess)
            except NoEquilibrium:
                self._last = None
                self.statistics.halvings += 1
                part /= 2
                if part * way < SHORTEST_STEP_MM:
                    raise
                continue
            self._last = (state, part * way) if way > 0 else None
            state = settled
            done += part
        return state, force

    def _settle(
        self, state: State, load: Load, tolerance_n: float = TOLERANCE_N, guess: State | None = None
    ) -> tuple[State, np.ndarray]:
        """The balance near `guess`, or the one that the skin snaps to from `state`; never one that is pierced."""
        try:
            state, touch = self.equilibrium(guess or state, load, tolerance_n)
        except NoEquilibrium:
            state, touch = self.creep(state, load, tolerance_n)
        if touch[3] > PIERCED * self.material.radius_mm:
            raise NoEquilibrium("the rod pierces the skin")
        self.statistics.deepest_mm = max(self.statistics.deepest_mm, float(touch[3]))
        return state, touch[:3]


def _is_slow(norms: list[float], tolerance: float) -> bool:
    """Whether a new factor is expected to be cheaper than going on at the rate of the last iterations."""
    if len(norms) < 5 or norms[-1] <= tolerance:
        return False
    rate = (norms[-1] / norms[-5]) ** 0.25
    if rate > 0.95:
        return True
    return math.log(tolerance / norms[-1]) / math.log(rate) > NEW_FACTOR_COST + 6
