"""How a skin answers between the first touch and the atlas's shallowest depth: vertical presses, solved, and the law.

Run with `python -m experiments.studies.partial_contact`; takes minutes. Prints, for each skin height of the article's
sensor, how far the law of `pipeline.synthesis.paths.partial_contact` is from the solver, and the exponents that fit
these presses best.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from pipeline.atlas.atlas import Atlas, read_atlas
from pipeline.sensor import Sensor
from pipeline.skin.solved_line import channels, skin_of
from pipeline.synthesis.paths.partial_contact import (
    EXPONENT,
    FLATTER,
    ROUNDER,
    partial_friction_parts,
    touch_depth_mm,
)
from pipeline.synthesis.synthesize import sensor_of

# Half size of the square that places are drawn from: nearer to the rim the response is too small to tell a law.
INNER_MM = 22.0
STEP_MM = 0.25
# The touch is where the normal force, straight through the first two above this, would be zero.
TOUCH_N = 0.01


@dataclass(frozen=True)
class Press:
    """One solved press: depths (n,) mm, V_x and V_y of the first board as tilts (n, 2) g, normal force (n,) N."""

    place_mm: tuple[float, float]
    height_mm: float
    depth_mm: np.ndarray
    tilt_g: np.ndarray
    force_n: np.ndarray

    @property
    def touch_mm(self) -> float:
        """Depth of the first touch."""
        first = int(np.argmax(self.force_n > TOUCH_N))
        (d0, d1), (f0, f1) = self.depth_mm[first : first + 2], self.force_n[first : first + 2]
        return float(d0 - f0 * (d1 - d0) / (f1 - f0))


def presses(
    sensor: Sensor, height_mm: float, count: int, deepest_mm: float, random: np.random.Generator
) -> Iterator[Press]:
    """Presses at random places, straight down to the deepest depth."""
    skin = skin_of(sensor)
    pressure, inflated = skin.inflate_to(height_mm)
    face = sensor.skin_thickness_mm + sensor.indenter_diameter_mm / 2
    depth = np.append(np.arange(-height_mm - 0.4, deepest_mm - 0.01, STEP_MM), deepest_mm)
    for x, y in random.uniform(-INNER_MM, INNER_MM, (count, 2)):
        centres = np.column_stack([np.full(len(depth), x), np.full(len(depth), y), face - depth])
        postures, forces = skin.slide(inflated, pressure, centres)
        if postures[-1] is None:
            continue
        tilts = np.array(
            [channels(skin, posture, inflated)[:2] for posture in postures if posture is not None]
        )
        yield Press((float(x), float(y)), height_mm, depth, tilts, forces[:, 2])


def errors(press: Press, atlas: Atlas) -> tuple[float, float, float]:
    """Touch, mm; root mean square of the law from the press's own touch and end; largest of law and atlas together.

    Both of the latter are relative to the tilt at the shallowest depth.
    """
    (x, y), depth = press.place_mm, press.depth_mm
    size = np.linalg.norm(press.tilt_g[-1])
    own = np.clip((depth - press.touch_mm) / (depth[-1] - press.touch_mm), 0, 1) ** EXPONENT
    law = np.linalg.norm(own[:, None] * press.tilt_g[-1] - press.tilt_g, axis=1)[own > 0] / size
    everywhere = np.full(len(depth), x), np.full(len(depth), y)
    told = partial_friction_parts(atlas, *everywhere, depth, press.height_mm)[:, 0, :2]
    touch = touch_depth_mm(np.array([x]), np.array([y]), press.height_mm, atlas)[0] - press.touch_mm
    return (
        touch,
        float(np.sqrt((law**2).mean())),
        float(np.linalg.norm(told - press.tilt_g, axis=1).max() / size),
    )


def fitted(solved: list[Press], sensor: Sensor) -> tuple[float, float, float]:
    """EXPONENT, FLATTER and ROUNDER that fit best."""
    half = np.array(sensor.chamber_mm) / 2
    dome = np.array([np.prod(1 - (np.array(press.place_mm) / half) ** 2) for press in solved])
    height, touch = np.array([(press.height_mm, press.touch_mm) for press in solved]).T
    ratio = height / min(sensor.chamber_mm)

    def off(shape: np.ndarray) -> np.ndarray:
        return -height * dome ** (shape[0] - shape[1] * ratio) - touch

    def misfit(exponent: float) -> float:
        total = 0.0
        for press in solved:
            way = (press.depth_mm - press.touch_mm) / (press.depth_mm[-1] - press.touch_mm)
            law = np.clip(way, 0, 1)[:, None] ** exponent * press.tilt_g[-1]
            total += float(((law - press.tilt_g) ** 2).sum() / (press.tilt_g[-1] ** 2).sum())
        return total

    flatter, rounder = least_squares(off, (FLATTER, ROUNDER)).x
    return float(minimize_scalar(misfit, bounds=(0.8, 1.6), method="bounded").x), flatter, rounder


def main(count: int = 24) -> None:
    """Prints the tables."""
    atlas = read_atlas()
    sensor, random = sensor_of(atlas), np.random.default_rng(0)
    solved: list[Press] = []
    print(
        "height mm | presses | touch rms mm | law median | p90 | with the atlas median | p90, of the tilt at the end"
    )
    for height in sensor.skin.height_mm:
        # The solver's height is the wanted one to a micrometre; the atlas holds no further ones.
        here = list(presses(sensor, height, count, float(atlas.depth_mm[0]), random))
        within = float(np.clip(height, *atlas.height_mm[[0, -1]]))
        touch, law, whole = np.array(
            [errors(Press(p.place_mm, within, p.depth_mm, p.tilt_g, p.force_n), atlas) for p in here]
        ).T
        told = [np.sqrt((touch**2).mean()), *np.percentile(law, (50, 90)), *np.percentile(whole, (50, 90))]
        print(f"{height:g} | {len(here)} | " + " | ".join(f"{value:.3f}" for value in told))
        solved += here
    print("fitted: exponent {:.2f}, flatter {:.2f}, rounder {:.2f}".format(*fitted(solved, sensor)))


if __name__ == "__main__":
    main()
