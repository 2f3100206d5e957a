"""Speed of the skin's solver, next to FElupe (test extra), and of the synthetic signal. Minutes on one core.

Prints positions a core-second on the way up the dome, how many times as fast as FElupe that is, with PARDISO and with
SciPy's solver, on the same mesh and path, and seconds of 1 kHz three-axis signal a core-second. The environment is to
say OMP_NUM_THREADS=1 before Python starts, so that no library takes more than one thread.

    OMP_NUM_THREADS=1 python -m softslide.experiments.studies.skin_speed --json skin.json
"""

import sys
import time
from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from scipy.sparse.linalg import spsolve

from softslide.experiments.studies.felupe_path import felupe_path
from softslide.experiments.studies.script import Part, parser, run
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR
from softslide.pipeline.sensor import read_sensor
from softslide.pipeline.skin.solved_line import skin_of
from softslide.pipeline.synthesis.synthesize import synthetic_slides

SLIDING_MPA, DEPTH_MM = 1e-3, 0.6
# Positions of the line: before the first it is not counted (the skin is not touched there, compilers and orderings do
# their work), from the second on FElupe has SciPy's solver.
COUNTED = (6, 9, 12)
# FElupe takes seconds, which average over a machine's load; the solver tenths, of which the median is taken.
OWN_RUNS = 7
SLIDES = 120


def solver() -> Iterator[Part]:
    """The indenter slides onto the inflated skin of the article's sensor, and up to the board.

    Mesh, path, steps, traction, friction and tolerance are FElupe's too; its board is a stiff solid.
    """
    from pypardiso import spsolve as pardiso

    sensor = read_sensor(DEFAULT_SENSOR)
    skin = skin_of(sensor)
    inflated = skin.inflate(SLIDING_MPA)
    first, middle, last = COUNTED
    face = sensor.skin_thickness_mm + sensor.indenter_diameter_mm / 2
    centres = np.array([(-30.0 + 1.25 * n, 2.5, face - DEPTH_MM) for n in range(last)])

    def own_s(count: int) -> float:
        began = time.process_time()
        skin.slide(inflated, SLIDING_MPA, centres[:count])
        return time.process_time() - began

    own = np.median([[own_s(count) for count in COUNTED] for _ in range(OWN_RUNS)], axis=0)
    yield "positions_per_core_s_on_the_way_up", (last - first) / (own[-1] - own[0])
    solvers = [pardiso] * middle + [spsolve] * (last - middle)
    # The first mark is the inflated skin's.
    path = felupe_path(skin, SLIDING_MPA, centres, pardiso, solvers)
    felupe = np.array([time.process_time() for _ in path])[list(COUNTED)]
    for name, times in zip(("pypardiso", "scipy"), np.diff(felupe) / np.diff(own), strict=True):
        yield f"times_felupe_{name}", times


def synthetic_signal(slides: int) -> Iterator[Part]:
    """With every effect of the default distribution."""
    list(synthetic_slides(2, 0))
    began = time.process_time()
    made = sum(recording.time_s[-1] for _, recording in synthetic_slides(slides, 1))
    yield "synthetic_times_real_time", made / (time.process_time() - began)


def main(argv: Sequence[str] | None = None) -> int:
    return run(parser("skin_speed", __doc__), lambda _: chain(solver(), synthetic_signal(SLIDES)), argv)


if __name__ == "__main__":
    sys.exit(main())
