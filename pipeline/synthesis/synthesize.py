"""Synthetic slides: what a specimen of a solved design would record, as arrays or as a folder of recordings.

The atlas is asked every half millimetre of the way, the slow part (way, lag, ripple, posture) is computed every
hundredth of a second or less, and cubic convolution leads to the sample rate, where vibration and electronics come in.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import lfilter

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, Atlas, check_atlas, read_atlas
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.sensor import Accelerometer, Board, Sensor, Skin, design_hash, read_sensor
from softslide.pipeline.skin.lines import PER_BOARD
from softslide.pipeline.synthesis.board_gravity import in_tilted_sensor, upright
from softslide.pipeline.synthesis.distribution import Distribution, draw_slide
from softslide.pipeline.synthesis.electronics import volts
from softslide.pipeline.synthesis.paths.contact_path import ContactPath
from softslide.pipeline.synthesis.paths.distribution import PathDistribution
from softslide.pipeline.synthesis.paths.draw import draw_path
from softslide.pipeline.synthesis.paths.response import path_response, path_truth
from softslide.pipeline.synthesis.protocol import article_slides
from softslide.pipeline.synthesis.slide_plan import Slide
from softslide.pipeline.synthesis.specimen import Specimen, draw_specimen
from softslide.pipeline.synthesis.upsampling import upsampled
from softslide.pipeline.synthesis.viscoelastic_lag import standard_solid
from softslide.pipeline.toml_tables import from_table, read_toml

KNOT_MM = 0.5
SLOW_S = 0.01
# The slow clock is as quick as the way needs: no more than this between its samples.
SLOW_MM = 0.2
# The vibration's resonance is broad: a pole at this radius for each cycle of ringing that is heard.
_RINGING = 3.0
# The vibration amplitude in `Distribution` is for this speed and this normal force.
_VIBRATION_MM_S, _VIBRATION_N = 10.0, 0.3
# The atlas's channels and the speed along a path at times (n,) s.
PathResponse = Callable[[ContactPath, Atlas, np.ndarray], tuple[np.ndarray, np.ndarray]]
# Streams of random numbers of one seed; 0 is the specimen's.
_PLAN, _NOISE, _PATH_PLAN, _PATH_NOISE, _PROTOCOL_NOISE = 1, 2, 3, 4, 5


def synthetic_slides(
    count: int,
    seed: int,
    atlas: Atlas | None = None,
    sensor: Sensor | None = None,
    distribution: Distribution | None = None,
) -> Iterator[tuple[Slide, Recording]]:
    """Plans and recordings, one at a time, without touching the disk; the same for the same seed.

    A slide depends on the seed and its number alone: more of them begin with the same ones.
    """
    atlas, distribution = atlas or read_atlas(), distribution or Distribution()
    sensor = sensor or sensor_of(atlas)
    specimen = draw_specimen(sensor, distribution, seed)
    for number in range(count):
        slide = plan(number, seed, atlas, sensor, distribution)
        yield slide, record(slide, specimen, atlas, noise_of(number, seed))


def plan(number: int, seed: int, atlas: Atlas, sensor: Sensor, distribution: Distribution) -> Slide:
    """The plan of a seed's slide."""
    return draw_slide(number, atlas, sensor, distribution, np.random.default_rng([seed, _PLAN, number]))


def path_plan(
    number: int,
    seed: int,
    atlas: Atlas,
    sensor: Sensor,
    distribution: Distribution,
    paths: PathDistribution | None = None,
) -> ContactPath:
    """The plan of a seed's path."""
    random = np.random.default_rng([seed, _PATH_PLAN, number])
    return draw_path(number, atlas, sensor, distribution, random, paths)


def noise_of(number: int, seed: int, stream: int = _NOISE) -> np.random.Generator:
    """The random numbers of a seed's slide that are not part of its plan."""
    return np.random.default_rng([seed, stream, number])


def record(
    plan: Slide | ContactPath,
    specimen: Specimen,
    atlas: Atlas,
    random: np.random.Generator,
    respond: PathResponse = path_response,
) -> Recording:
    """What the specimen records of a slide or of a contact along a path. respond: what the skin does along a path.

    Raises:
        InputError: the plan leaves the atlas's depths or heights.
    """
    rate = specimen.electronics.rate_hz
    count = int(plan.duration_s * rate) + 1
    factor = max(1, int(rate * min(SLOW_S, SLOW_MM / plan.quickest_mm_s)))
    slow_s = (np.arange(-1, -(-count // factor) + 2)) * factor / rate
    tilt, yaw, rubbing = _skin(plan, specimen, atlas, slow_s, random, respond)
    gravity = in_tilted_sensor(tilt, yaw, upright(plan.posture_deg))
    boards = len(gravity)
    # Each output's own straight drift.
    gravity += specimen.drift_g * random.standard_normal((boards, 3, 1)) * slow_s / 60
    slow = np.concatenate([gravity.reshape(boards * 3, -1), rubbing[None]])
    fast = upsampled(slow, factor)[:, :count]
    sensed = fast[:-1].reshape(boards, 3, count)
    if specimen.vibration_g > 0:
        coupling = random.standard_normal((boards, 3, 1)).astype(np.float32)
        sensed += coupling * (fast[-1] * _ringing(count, specimen, random))
    output = volts(sensed, specimen.electronics, random)
    truth = path_truth(plan, atlas) if isinstance(plan, ContactPath) else None
    return Recording(plan.name, np.arange(count) / rate, output.astype(float), truth)


def _skin(
    plan: Slide | ContactPath,
    specimen: Specimen,
    atlas: Atlas,
    time_s: np.ndarray,
    random: np.random.Generator,
    respond: PathResponse,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the skin does to its boards at (n,) s.

    Returns:
        Readings along x and y in a level sensor (boards, 2, n) g; yaw (boards, n) rad; the vibration's rms (n,) g.
    """
    boards, level = atlas.boards, atlas.pressure_at(plan.height_mm)
    if isinstance(plan, ContactPath):
        values, speed = respond(plan, atlas, time_s)
    else:
        values, speed = _line_response(plan, specimen, atlas, time_s)
    posture = plan.gain * values[:, : PER_BOARD * boards].reshape(-1, boards, PER_BOARD)
    chosen = posture[:, :, [0, 1, 6]].reshape(-1, boards * 3)
    lagging = standard_solid(chosen, time_s[1] - time_s[0], specimen.delayed, specimen.tau_s)
    tilt = atlas.static(level)[:, :2] + lagging.reshape(-1, boards, 3)[:, :, :2]
    if specimen.ripple > 0:
        wave = np.sin(2 * np.pi * (specimen.ripple_hz * time_s + random.uniform()))
        # All tilts go with the pressure as the static one does, to first order.
        tilt = tilt * (1 + _static_exponent(atlas, level) * specimen.ripple * wave)[:, None, None]
    pressing = np.maximum(values[:, -1], 0) / _VIBRATION_N
    rubbing = specimen.vibration_g * np.sqrt(speed / _VIBRATION_MM_S) * pressing
    return np.moveaxis(tilt, 0, -1), lagging.reshape(-1, boards, 3)[:, :, 2].T, rubbing


def _line_response(
    slide: Slide, specimen: Specimen, atlas: Atlas, time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What the atlas says of a slide at (n,) s, without any lag: (n, channels); and the speed (n,) mm/s."""
    forth, back, speed = slide.stroke.at(time_s - slide.motion_start_s)
    parts = _along_the_way(slide, atlas, atlas.pressure_at(slide.height_mm))(forth - back)
    # Friction is fully there once the indenter slides and turns within some way (P. R. Dahl, 1968).
    turned = np.where(back > 0, 2 * np.exp(-back / max(specimen.friction_mm, 1e-9)) - 1, 1.0)
    angle = np.deg2rad(slide.direction_deg)
    drag = np.cos(angle) * parts[:, 1] + np.sin(angle) * parts[:, 2]
    return parts[:, 0] + turned[:, None] * drag, speed


def _along_the_way(slide: Slide, atlas: Atlas, level: float) -> BSpline:
    """The atlas's mean, fx and fy as a spline of the way: (n,) mm -> (n, 3, channels)."""
    way = np.linspace(0, slide.stroke.travel_mm, max(4, int(slide.stroke.travel_mm / KNOT_MM) + 1))
    parts = atlas.friction_parts(*slide.places(way), slide.depths(way), level)
    if np.isnan(parts).any():
        raise InputError(f"{slide.name} passes a position that was not solved; choose another line")
    return make_interp_spline(way, parts)


def _static_exponent(atlas: Atlas, level: float) -> float:
    """d log(static tilt) / d log(pressure), 0 for a board at the centre or an atlas of one level."""
    ends = atlas.pressure_mpa[[0, -1]]
    low, high = np.clip([0.98 * level, 1.02 * level], *ends)
    tilts = [np.linalg.norm(atlas.static(float(p))[:, :2]) for p in (low, high)]
    return float(np.log(tilts[1] / tilts[0]) / np.log(high / low)) if low < high and tilts[0] > 1e-6 else 0.0


def _ringing(count: int, specimen: Specimen, random: np.random.Generator) -> np.ndarray:
    """Noise (n,) of unit variance round the vibration's frequency: white noise through one pair of poles."""
    turn = 2 * np.pi * min(specimen.vibration_hz / specimen.electronics.rate_hz, 0.45)
    radius = np.exp(-turn / (2 * _RINGING))
    a = np.array([1, -2 * radius * np.cos(turn), radius**2], np.float32)
    rung = lfilter(np.ones(1, np.float32), a, random.standard_normal(count, dtype=np.float32))
    # Variance of a second-order autoregression: (1 + a2) / ((1 - a2) ((1 + a2)^2 - a1^2)).
    variance = (1 + a[2]) / ((1 - a[2]) * ((1 + a[2]) ** 2 - a[1] ** 2))
    return rung / np.sqrt(variance)


def sensor_of(atlas: Atlas) -> Sensor:
    """The sensor that an atlas was solved for, with the article's electronics: the atlas holds its mechanics alone.

    The reference point is the middle of the accelerometers.
    """
    article = read_sensor(DEFAULT_SENSOR)
    design = atlas.meta["design"]
    if design_hash(article) == atlas.meta["design_hash"]:
        return article
    places = np.array(design["boards_mm"], float)

    def tuples(table: dict[str, Any]) -> dict[str, Any]:
        return {name: tuple(value) if isinstance(value, list) else value for name, value in table.items()}

    return replace(
        article,
        name=f"design-{atlas.meta['design_hash']}",
        reference_mm=(float(places[:, 0].mean()), float(places[:, 1].mean())),
        accelerometers=tuple(Accelerometer(f"a{n}", float(x), float(y)) for n, (x, y) in enumerate(places)),
        skin=Skin(**tuples(design["skin"])),
        board=Board(**tuples(design["board"])),
        **tuples(
            {name: value for name, value in design.items() if name not in ("boards_mm", "skin", "board")}
        ),
    )


def synthesize(
    out: str | Path,
    slides: int = 0,
    paths: int = 0,
    *,
    atlas: str | Path | None = None,
    sensor: str | Path | None = None,
    seed: int = 0,
    config: str | Path | Distribution | None = None,
    protocol: str | None = None,
    solved: bool = False,
) -> Folder:
    """`softslide synthesize`: writes a folder of recordings, whole or not at all.

    slides: how many along straight lines; paths: how many contacts along any path; protocol: "article" for the
    article's slides as well, all on the same specimen. config: what they are drawn from, or a TOML file with changes.
    solved: paths are solved step by step instead of read from the atlas.

    Raises:
        InputError: no recordings, a negative seed, an atlas that is not one or of another design, an `out` not to be
            written.
    """
    for name, count in (("slides", slides), ("paths", paths), ("seed", seed)):
        if count < 0:
            raise InputError(f"{count}: it must not be negative", name)
    if protocol not in (None, "article"):
        raise InputError(f"{protocol}: name article", "protocol")
    if not slides + paths and protocol is None:
        raise InputError(f"{slides}: at least one is needed, or a path", "slides")
    if solved and not paths:
        raise InputError("only paths are solved; ask for some", "solved")
    solution = read_atlas(Path(atlas)) if atlas else read_atlas()
    design = read_sensor(sensor) if sensor else sensor_of(solution)
    if design.base is not None:
        raise InputError(f"{sensor}: has a [base], and synthetic slides none; take it out")
    check_atlas(solution, design, str(atlas or "the default atlas"))
    if paths and not solved and any(design.indenter_edge_mm):
        raise InputError(
            f"{paths}: how a touch grows is known of a ball, not of an edge; have the paths solved", "paths"
        )
    # Whoever reads a report on these recordings is to see what they are.
    design = replace(design, name=f"{design.name}, synthetic", origin="synthetic")
    if isinstance(config, str | Path):
        config = from_table(Distribution, read_toml(Path(config)), str(config))
    distribution = config or Distribution()
    specimen = draw_specimen(design, distribution, seed)
    drawn = (seed, solution, design, distribution)
    article = article_slides(solution, design, distribution, seed) if protocol else ()
    plans: list[tuple[Slide | ContactPath, np.random.Generator]] = [
        *((slide, noise_of(n, seed, _PROTOCOL_NOISE)) for n, slide in enumerate(article)),
        *((plan(n, *drawn), noise_of(n, seed)) for n in range(slides)),
        *((path_plan(n, *drawn), noise_of(n, seed, _PATH_NOISE)) for n in range(paths)),
    ]
    manifest = pd.DataFrame([each.labels() for each, _ in plans])
    respond = path_response
    if solved:
        # The solver needs numba, which the io extra does not bring.
        from softslide.pipeline.synthesis.paths.solved import solved_response

        respond = partial(solved_response, sensor_of(solution))
    recordings = (record(each, specimen, solution, noise, respond) for each, noise in plans)
    origin = {
        "what": "synthetic slides, made by softslide synthesize; never measured on hardware",
        "seed": seed,
        "atlas_design": solution.meta["design_hash"],
        "atlas_heights_mm": solution.height_mm.tolist(),
        "distribution": asdict(distribution),
    }
    if protocol:
        origin["protocol"] = "the article's 512 slides"
    if paths:
        origin["paths"] = asdict(PathDistribution()) | {"solved": solved}
    notes = {"synthesis.json": json.dumps(origin, indent=1) + "\n"}
    watched = progress_bar("synthesizing", "slide", recordings, len(plans))
    return write_folder(out, design, manifest, watched, notes)
