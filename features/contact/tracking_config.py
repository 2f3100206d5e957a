"""The numbers of the contact tracker: of contacts over a rim or pressed on, and of ones that come down anywhere."""

import math
from dataclasses import dataclass, field

from softslide.features.contact.hypotheses import LocalErrors, MotionNoise
from softslide.features.contact.manoeuvres import Manoeuvres


@dataclass(frozen=True)
class TrackingConfig:
    """step_blocks: of a measurement, 40 ms, in which the fastest slide calibrated for (13 mm/s) goes half a millimetre.
    local: of contacts that come down anywhere, what the map leaves of a measurement next to a part that is alike
    everywhere: errors of place and gain, white from one to the next; None: contacts come over the rim or are pressed
    on, and what the map leaves is correlated over the way.
    branch_steps: between two branchings; first_steps: before the first one that adds hypotheses.
    most, most_partial: hypotheses kept after a branching, of a whole contact and of one pressed on or lifted.
    parents: hypotheses that get children, within parent_odds of the best.
    young_s: after the touch, in which an output that comes to rest may have been pressed on there. lost: misfit of a
    track that is lost.
    edge_mm: a place further off the chamber is unlikely, by edge_cost for the first mm, which grows with the power
    edge_power; most_gain: and so is a gain beyond it. held_cost: in 1 s, of a contact that is pressed on or
    lifted whose gain hardly changes (paths solved step by step, experiments/LOG.md).
    least_log_odds: of a contact, that a step adds. prior_steps: as many steps count as what the calibration says of
    the residual's size; None: nothing else counts."""

    step_blocks: int = 2
    local: LocalErrors | None = None
    noise: MotionNoise = field(default_factory=MotionNoise)
    manoeuvres: Manoeuvres = field(default_factory=Manoeuvres)
    branch_steps: int = 5
    first_steps: int = 0
    most: int = 14
    most_partial: int = 12
    parents: int = 3
    parent_odds: float = 5.0
    young_s: float = 4.0
    lost: float = 5.0
    edge_mm: float = 4.0
    edge_cost: float = 0.3
    edge_power: float = 1.0
    most_gain: float = 1.15
    held_cost: float = 2.0
    least_log_odds: float = -math.inf
    prior_steps: float | None = None

    @property
    def comes_down(self) -> bool:
        """Whether contacts are there from one block to the next, anywhere on the skin, and are lifted as fast."""
        return self.local is not None


# Of what a map of recordings alone does not know: friction, other depths, residuals along the way.
TINY = 1e-9
NEVER = 1e-9

# Contacts bend and change speed, and no more: where presses stand for a motion, one that is held looks like a stop, and
# hypotheses that stop, turn back or turn a corner follow these instead of the motion. While the residual of such a map
# stays as it is, from one press to the next, a smooth signal predicts the output better: a block counts for -2 at
# least. Slides on smooth skins leave less than the calibration says: by a formula's map 5 and 10 mm/s reach -74 and -37
# of log odds with a tenth of a block as prior, -95 and -65 with a whole one. All numbers are chosen on circles,
# S-curves and lines assembled from a pass and places that the map had not seen (experiments/LOG.md).
TOUCH_DOWN = TrackingConfig(
    step_blocks=1,
    local=LocalErrors(0.42, 0.07),
    noise=MotionNoise(
        place=0.01, heading=0.01, speed=0.03, acceleration=TINY, curvature=0.01, gain=0.002, depth=TINY
    ),
    manoeuvres=Manoeuvres(
        steering=(0.2, 0.6, 0.2),
        speed=0.3,
        acceleration=TINY,
        curvature=0.3,
        stop=NEVER,
        back=NEVER,
        corner=NEVER,
        restart=NEVER,
        lift=NEVER,
        lift_at_rest=NEVER,
    ),
    branch_steps=3,
    first_steps=12,
    most=24,
    most_partial=1,
    parents=4,
    parent_odds=6.0,
    young_s=0.0,
    lost=math.inf,
    edge_mm=0.5,
    edge_cost=2.0,
    edge_power=2.0,
    most_gain=math.inf,
    held_cost=0.0,
    least_log_odds=-2.0,
    prior_steps=0.1,
)
