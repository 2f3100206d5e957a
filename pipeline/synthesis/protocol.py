"""The article's slides (4): every line of its protocol at every speed, forward and backward; 512 in all."""

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.motion import Stroke
from softslide.pipeline.synthesis.slide_plan import Slide, crossing

STEP_MM = 2.5
# Of X-slides y, of Y-slides the distance on one side, both from the accelerometer.
X_LINES_MM = tuple(STEP_MM * n for n in range(-10, 11))
Y_LINES_MM = tuple(STEP_MM * n for n in range(11))
SPEEDS_MM_S = tuple(0.5 * n for n in range(1, 9))
DEPTH_MM = 0.5
SPLIT = "calibration"
RAMP_S = 0.05  # of the stage, which the article does not state
# Of a seed's streams of random numbers, the protocol's.
_STREAM = 6


def article_slides(atlas: Atlas, sensor: Sensor, distribution: Distribution, seed: int) -> list[Slide]:
    """The 512 plans, in the order of the article's lists. The seed decides posture and gain of each.

    Y-slides pass on the side of the accelerometer that has more room in the chamber. Slides move over the whole skin,
    so that they are longer than the 50 mm of the inflated area. Heights and repeatability are the distribution's.

    Raises:
        InputError: a line of the protocol misses the sensor's chamber.
    """
    d, random = distribution, np.random.default_rng([seed, _STREAM])
    height = d.nominal_height_mm(atlas)
    # An offset counts to the left of the motion.
    lines = [(heading, sense * y) for y in X_LINES_MM for heading, sense in ((0.0, 1), (180.0, -1))]
    side = -1.0 if sensor.reference_mm[0] >= 0 else 1.0
    lines += [(heading, sense * side * x) for x in Y_LINES_MM for heading, sense in ((90.0, -1), (270.0, 1))]
    slides: list[Slide] = []
    for direction, offset in lines:
        line = crossing(direction, offset, sensor)
        if line is None:
            raise InputError(
                f"{sensor.name}: the protocol's line of direction {direction:g} deg and offset {offset:g} mm misses "
                "the chamber; it is made for the article's sensor"
            )
        start, travel, _ = line
        for speed in SPEEDS_MM_S:
            posture = d.posture_deg * random.standard_normal(2)
            slides.append(
                Slide(
                    direction,
                    offset + 0.0,
                    start,
                    Stroke(travel, speed, RAMP_S),
                    DEPTH_MM,
                    sensor.pressure_mpa,
                    height,
                    name=f"p{len(slides):04d}",
                    split=SPLIT,
                    posture_deg=(float(posture[0]), float(posture[1])),
                    gain=1 + d.repeatability * random.standard_normal(),
                )
            )
    return slides
