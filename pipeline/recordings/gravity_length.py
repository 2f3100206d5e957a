"""How well gravity keeps its length in a folder's slides: what V_z shows apart from the tilt."""

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.features.stream.gravity import MOST_AGAINST, MOST_CHANGE_SD, GravityWatch
from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.sensor import Sensor

# The limits are so many times what the slides reach at most.
MARGIN = 2.0
# V_z of the emulated benches swings by 0.007 g with the pressure; recordings at steadier pressure show less of that.
LEAST_SD_G = 0.006


def gravity_sd_g(
    slides: Sequence[tuple[Recording, float]], sensor: Sensor, conditioning: Conditioning
) -> float:
    """`Conditioning.gravity_sd_g`, so large that none of the slides is refused.

    slides: each with when it moves, s. Without any, or of elements that do not measure gravity, that of `conditioning`.
    """
    if not sensor.measures_gravity or not slides:
        return conditioning.gravity_sd_g
    elements = [asdict(element) for element in sensor.accelerometers]
    watch = GravityWatch(elements, conditioning)
    usable = np.ones(len(elements), dtype=bool)
    sd_g = LEAST_SD_G
    for recording, moves_s in slides:
        blocks = block_means(recording.volts, conditioning, sensor.sample_rate_hz)
        resting = int((moves_s - recording.time_s[0]) / conditioning.block_s)
        if resting < 1:
            continue
        static = blocks[:resting].mean(axis=0)
        watch.begin()
        for block in blocks[resting:]:
            watch.push(static, block - static, usable)
            sd_g = max(sd_g, watch.change_g * MARGIN / MOST_CHANGE_SD)
            sd_g = max(sd_g, np.sqrt(max(watch.against_g2, 0.0) * MARGIN / (2.0 * MOST_AGAINST)))
    return float(sd_g)
