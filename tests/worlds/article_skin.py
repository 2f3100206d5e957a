"""The article's skin as it ships: atlas, sensor, specimens that add nothing, and the atlas as if of other designs."""

import json
from dataclasses import replace
from typing import Any

import numpy as np

from softslide.pipeline.atlas.atlas import Atlas, read_atlas
from softslide.pipeline.sensor import Sensor, design_hash, design_of
from softslide.pipeline.skin.lines import MIRROR_BOARD, PER_BOARD
from softslide.pipeline.synthesis.electronics import ideal_electronics
from softslide.pipeline.synthesis.specimen import Specimen
from softslide.pipeline.synthesis.synthesize import sensor_of

ATLAS = read_atlas()
SENSOR = sensor_of(ATLAS)
BOARD, FORCE = ATLAS.parts[..., :PER_BOARD], ATLAS.parts[..., PER_BOARD:]
# The board's answer, were it at (-5, 0) mm: mirrored in x, where friction along x turns round.
MIRRORED = BOARD[:, ::-1] * MIRROR_BOARD[0] * np.array([1, -1, 1])[:, None, None, None, None, None]


def exact(**changes: Any) -> Specimen:
    """A specimen that adds nothing, not even the ADC's step."""
    return Specimen(replace(ideal_electronics(SENSOR), adc_step_v=0.0), **changes)


def of_design(sensor: Sensor, **changes: Any) -> Atlas:
    """The atlas as if it were solved for another design."""
    design = json.loads(json.dumps(design_of(sensor)))
    return replace(
        ATLAS, meta={**ATLAS.meta, "design": design, "design_hash": design_hash(sensor)}, **changes
    )
