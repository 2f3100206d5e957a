"""How a skin answers between the first touch and the atlas's shallowest depth: vertical presses, solved, and the law.

Prints, for each skin height of the article's sensor, how far the law of pipeline/synthesis/paths/partial_contact.py is
from the solver: of the depth of the first touch, mm (rms), and, relative to the tilt at the shallowest depth, of the
law from each press's own touch and end (rms along the way) and of law and atlas together (largest along the way),
median and 90 % quantile over presses. Then the exponents that fit these presses best. Takes minutes.

    python -m softslide.experiments.studies.partial_contact --presses 24
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from softslide.experiments.studies.script import Part, count, parser, run
from softslide.pipeline.atlas.atlas import Atlas, read_atlas
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.skin.solved_line import channels, skin_of
from softslide.pipeline.synthesis.paths import partial_contact as law
from softslide.pipeline.synthesis.synthesize import sensor_of

# Half size of the square that places are drawn from: nearer to the rim the response is too small to show a law.
INNER_MM, STEP_MM = 22.0, 0.25
# The touch is where the normal force, straight through the first two above this, would be zero.
TOUCH_N = 0.01


@dataclass(frozen=True)
class Press:
    """One solved press: depths (n,) mm, V_x and V_y of the first board as tilts (n, 2) g, depth of the first touch."""

    place_mm: tuple[float, float]
    height_mm: float
    depth_mm: np.ndarray
    tilt_g: np.ndarray
    touch_mm: float

    def law_g(self, exponent: float) -> np.ndarray:
        """Tilts (n, 2) g as the law has them, from this press's own touch and end."""
        way = (self.depth_mm - self.touch_mm) / (self.depth_mm[-1] - self.touch_mm)
        return np.clip(way, 0, 1)[:, None] ** exponent * self.tilt_g[-1]


def pressed(sensor: Sensor, height_mm: float, deepest_mm: float, x_mm: float, y_mm: float) -> Press | None:
    """A press straight down to the deepest depth; None where the solver finds no equilibrium."""
    skin = skin_of(sensor)
    pressure, inflated = skin.inflate_to(height_mm)
    face = sensor.skin_thickness_mm + sensor.indenter_diameter_mm / 2
    depth = np.append(np.arange(-height_mm - 0.4, deepest_mm - 0.01, STEP_MM), deepest_mm)
    centres = np.column_stack([np.full(len(depth), x_mm), np.full(len(depth), y_mm), face - depth])
    postures, forces = skin.slide(inflated, pressure, centres)
    if postures[-1] is None:
        return None
    tilts = np.array([channels(skin, each, inflated)[:2] for each in postures if each is not None])
    first = int(np.argmax(forces[:, 2] > TOUCH_N))
    (d0, d1), (f0, f1) = depth[first : first + 2], forces[first : first + 2, 2]
    return Press((x_mm, y_mm), height_mm, depth, tilts, float(d0 - f0 * (d1 - d0) / (f1 - f0)))


def errors(press: Press, atlas: Atlas) -> tuple[float, float, float]:
    """Of the touch, mm; of the law, rms; of law and atlas together, largest; the latter two relative."""
    # The solver's height is the wanted one to a micrometre; the atlas holds no further ones.
    height = float(np.clip(press.height_mm, *atlas.height_mm[[0, -1]]))
    x, y = (np.full(len(press.depth_mm), each) for each in press.place_mm)
    size = np.linalg.norm(press.tilt_g[-1])
    alone = np.linalg.norm(press.law_g(law.EXPONENT) - press.tilt_g, axis=1)[press.depth_mm > press.touch_mm]
    both = law.partial_friction_parts(atlas, x, y, press.depth_mm, height)[:, 0, :2] - press.tilt_g
    touch = law.touch_depth_mm(x[:1], y[:1], height, atlas)[0] - press.touch_mm
    return touch, np.sqrt((alone**2).mean()) / size, np.linalg.norm(both, axis=1).max() / size


def fitted(solved: list[Press], sensor: Sensor) -> dict[str, float]:
    """Of the law the constants that fit best."""
    half = np.array(sensor.chamber_mm) / 2
    dome = np.array([np.prod(1 - (np.array(press.place_mm) / half) ** 2) for press in solved])
    height, touch = np.array([(press.height_mm, press.touch_mm) for press in solved]).T
    ratio = height / min(sensor.chamber_mm)

    def misfit(exponent: float) -> float:
        return sum(((p.law_g(exponent) - p.tilt_g) ** 2).sum() / (p.tilt_g[-1] ** 2).sum() for p in solved)

    s = least_squares(lambda s: -height * dome ** (s[0] - s[1] * ratio) - touch, (law.FLATTER, law.ROUNDER)).x
    exponent = minimize_scalar(misfit, bounds=(0.8, 1.6), method="bounded").x
    return {"exponent": exponent, "flatter": s[0], "rounder": s[1]}


def partial_contact(number: int) -> Iterator[Part]:
    """The errors at each height of the article's sensor over so many presses, and what fits best."""
    atlas, random = read_atlas(), np.random.default_rng(0)
    sensor, every = sensor_of(atlas), []
    for height in sensor.skin.height_mm:
        places = random.uniform(-INNER_MM, INNER_MM, (number, 2)).tolist()
        solved = [pressed(sensor, height, float(atlas.depth_mm[0]), x, y) for x, y in places]
        here = [press for press in solved if press is not None]
        touch, alone, both = np.array([errors(press, atlas) for press in here]).T
        figures = {
            "presses": len(here),
            "touch_rms_mm": np.sqrt((touch**2).mean()),
            "law_median": np.median(alone),
            "law_p90": np.percentile(alone, 90),
            "with_atlas_median": np.median(both),
            "with_atlas_p90": np.percentile(both, 90),
        }
        yield f"height, mm {height:g}", figures
        every += here
    yield "fitted", fitted(every, sensor)


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("partial_contact", __doc__)
    count(words, "--presses", 24)
    return run(words, lambda given: partial_contact(given.presses), argv)


if __name__ == "__main__":
    sys.exit(main())
