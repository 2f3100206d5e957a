"""From a sensor's slides and its design to its response map, the residual lag undone.

Candidate fits (near the atlas's prior with three stiffnesses, or from recordings alone) are compared by
cross-validation over lines: a coarse or foreign atlas must not spoil what many recordings tell, and few recordings
need the atlas and a fit that keeps close to it.

Of a sensor whose mechanics are not solved the candidates are splines of several spacings, and what is held out of a
fit is whole lines and, besides, cells of the skin: lines that are close together or cross show the same places.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from features.errors import InputError
from features.height import HeightCalibration
from features.stream.conditioning import Conditioning
from models.held_out import line_folds
from models.response_map.calibrate import blank_map, calibrate
from models.response_map.config import CalibrationConfig
from models.response_map.from_atlas import SensorSpread, prior_map
from models.response_map.heights import calibrated_heights
from models.response_map.lag import with_lag
from models.response_map.map import SPACING_MM, ResponseMap
from models.response_map.onset import Onsets, moved, with_onsets
from models.response_map.slide_fit import fit_slide
from models.response_map.slides import LEAST_HEIGHTS_MM, CalibrationSlide, calibration_slides, main_height_mm
from pipeline.atlas.atlas import Atlas
from pipeline.recordings.derived_labels import USUAL_DEPTH_MM
from pipeline.recordings.folder import Folder
from pipeline.sensor import Sensor

FOLDS = 4
LEAST_ALONE = 24  # slides; fewer leave the map without an atlas full of holes
# Sensors that no atlas can be solved for take what there is.
LEAST_UNSOLVED = 2 * FOLDS
# Of such a sensor's map; each is tried with these times the default's penalties.
SPACINGS_MM = (SPACING_MM, SPACING_MM / 1.5, SPACING_MM / 2.25)
SMOOTHNESS = (1.0, 10.0)
MANY = 100  # slides, from which on the smoother ones are left out: with 297 they were worse at each spacing
CELL_MM = 1.5  # side of the cells that are held out, and their share
CELL_SHARE = 1 / 3
LEAST_STRETCHES = 4  # that a slide keeps
# Factors of the penalties on the map's distance from its prior: 30 is best with 12 slides, 5 with 24, 1 with a hundred
# (experiments/LOG.md). The first is taken where they cannot be compared.
STIFFNESS = (30.0, 5.0, 1.0)
FITS = 4  # at most: the lag is found in the first, what of it is left in the others

Maps = list[tuple[ResponseMap, np.ndarray]]


@dataclass(frozen=True)
class CalibratedMap:
    """A sensor's response map and what it was found from.

    response: fitted to all slides. held_out: for honest errors, maps fitted without some lines, each with the names of
    those lines' recordings. conditioning: of the signal that it is a map of, the lag undone. slides: how many there
    were. summary: figures of the fit; `from_atlas` is 1 where the candidate chosen starts from an atlas.
    folder: the recordings with the motion of every slide used, fitted where the labels do not tell it (untimed of
    them). left_out: why a recording is not among the slides, by name. heights: where they have several heights of the
    skin, what a device needs to know of them; told_mm: the height that each one's static output tells, by name.
    """

    response: ResponseMap
    held_out: Maps
    conditioning: Conditioning
    slides: int
    summary: dict[str, float]
    folder: Folder
    untimed: int
    left_out: dict[str, str]
    heights: HeightCalibration | None = None
    told_mm: dict[str, float] = field(default_factory=dict)


def calibrated_map(
    folder: Folder,
    atlas: Atlas | None,
    conditioning: Conditioning,
    calibration: CalibrationConfig,
    spread: SensorSpread,
) -> CalibratedMap:
    """Calibrates on the folder's slides: the map, the lag it shows, then the map of the signal without this lag.

    A lag that `conditioning` already names is taken as it is. Slides at several heights of the skin share one map over
    heights, unless maps of one height each predict held-out lines better: then it is that of the height that most have,
    and the others are left out.

    Raises:
        InputError: neither an atlas nor enough slides, or none of the folder's recordings can be used.
    """
    onsets = with_onsets(folder, atlas, conditioning, spread, calibration)
    lag_known, sensor = conditioning.delayed > 0, folder.sensor.scaled(conditioning.scale)
    for _ in range(FITS):
        read = conditioning
        slides = calibration_slides(onsets.folder, read, onsets.fitted)
        left_out = _left_out(onsets, slides)
        candidates = _candidates(len(slides), atlas is not None, calibration, sensor)
        whole, folds = _parts(slides, atlas, sensor, spread)
        response, held_out, summary = _cross_validated(candidates, whole, folds)
        conditioning = read if lag_known else with_lag(read, slides, response, held_out)
        if conditioning == read:
            break
    lag = {"delayed": read.delayed, "tau_s": read.tau_s}
    if response.height_slope is not None:
        shares = _shares_at_other_heights(slides, held_out, atlas, sensor, spread, calibration)
        told = {f"heldout_residual_{name}": share for name, share in shares.items()}
        summary |= told
        if shares and shares["map_a_height"] < shares["map_over_heights"]:
            others = _names_at_other_heights(slides)
            alone = replace(folder, manifest=folder.manifest.drop(index=others))
            found = calibrated_map(alone, atlas, conditioning, calibration, spread)
            why = dict.fromkeys(
                others, "a map of each height predicts held-out lines better; train one for it"
            )
            return replace(found, summary=found.summary | told, left_out=found.left_out | why)
    untimed = [slide for slide in slides if not slide.timed]
    shifts = {slide.recording: fit_slide(slide, response, calibration).shift_mm for slide in untimed}
    placed = moved(onsets.folder, shifts)
    heights = calibrated_heights(response, slides)
    told_mm = {} if heights is None else {s.recording: heights.told(s.static_v) for s in slides}
    return CalibratedMap(
        response, held_out, read, len(slides), summary | lag, placed, len(untimed), left_out, heights, told_mm
    )


def _names_at_other_heights(slides: list[CalibrationSlide]) -> list[str]:
    """The recordings whose skin's height is not that of most."""
    main_mm = main_height_mm(slides)
    return [s.recording for s in slides if abs(s.height_mm - main_mm) > LEAST_HEIGHTS_MM]


def _shares_at_other_heights(
    slides: list[CalibrationSlide],
    held_out: Maps,
    atlas: Atlas | None,
    sensor: Sensor,
    spread: SensorSpread,
    config: CalibrationConfig,
) -> dict[str, float]:
    """What a map over heights (held_out) and what a map of each height leave of held-out lines at other heights than
    that of most: the median residual as a share of a slide's largest output. Empty where no height has enough slides.
    """
    names = set(_names_at_other_heights(slides))
    others = [slide for slide in slides if slide.recording in names]
    others.sort(key=lambda slide: slide.height_mm)
    gaps = np.flatnonzero(np.diff([slide.height_mm for slide in others]) > LEAST_HEIGHTS_MM) + 1
    shared: list[float] = []
    apart: list[float] = []
    for at in np.split(np.arange(len(others)), gaps):
        group = [others[n] for n in at]
        if len(group) < (2 * FOLDS if atlas is not None else LEAST_ALONE):
            continue
        whole, folds = _parts(group, atlas, sensor, spread)
        candidates = _candidates(len(group), atlas is not None, config, sensor)
        own = _cross_validated(candidates, whole, folds)[1]
        for shares, maps in ((shared, held_out), (apart, own)):
            shares += [
                fit_slide(slide, response, CalibrationConfig()).rms_v / np.abs(slide.volts).max()
                for response, unseen in maps
                for slide in group
                if slide.recording in unseen
            ]
    if not shared:
        return {}
    return {"map_over_heights": float(np.median(shared)), "map_a_height": float(np.median(apart))}


def _left_out(onsets: Onsets, slides: list[CalibrationSlide]) -> dict[str, str]:
    """Why each recording that is not among the slides is not, by name.

    Raises:
        InputError: none is.
    """
    used = {slide.recording for slide in slides}
    names = [str(name) for name in onsets.folder.manifest.index if name not in used]
    left_out = {name: onsets.left_out.get(name, "no rest before its motion") for name in names}
    if names and not used:
        raise InputError(
            f"{onsets.folder.root}: none of {len(names)} labelled recordings can be used "
            f"({names[0]}: {left_out[names[0]]}); mend them, or train from the design alone"
        )
    return left_out


@dataclass(frozen=True)
class _Part:
    """slides: to fit to. prior: a map of the design moved to them (None without an atlas), with what moved it.
    unseen: the slides that were left out."""

    slides: list[CalibrationSlide]
    prior: ResponseMap | None
    moved: dict[str, float]
    depth_mm: float
    unseen: list[CalibrationSlide]


_Fit = Callable[[_Part], tuple[ResponseMap, dict[str, float]]]


def _candidates(slides: int, has_atlas: bool, config: CalibrationConfig, sensor: Sensor) -> dict[str, _Fit]:
    """The fits that are possible, by name: near an atlas's prior, a stiffness each, and from recordings alone.

    Raises:
        InputError: neither an atlas nor enough slides.
    """
    if not sensor.measures_gravity:
        return _unsolved(slides, config, sensor)
    if not has_atlas and slides < LEAST_ALONE:
        raise InputError(
            f"{sensor.name}: {slides} labelled slides and no atlas; record at least {LEAST_ALONE}, "
            "or name an atlas that 'softslide simulate' made"
        )

    def near(stiffness: float) -> _Fit:
        stiff = config.stiffened(stiffness)

        def fit(part: _Part) -> tuple[ResponseMap, dict[str, float]]:
            assert part.prior is not None
            return calibrate(part.slides, part.prior, True, stiff) if part.slides else (part.prior, {})

        return fit

    def alone(part: _Part) -> tuple[ResponseMap, dict[str, float]]:
        start = blank_map(sensor, part.depth_mm)
        if part.prior is not None:
            # Recordings of one depth say nothing of others: that part is the design's in any case.
            changes = part.prior.depth_slope, part.prior.height_slope
            start = replace(start, depth_slope=changes[0], height_slope=changes[1])
        return calibrate(part.slides, start, False, config)

    candidates: dict[str, _Fit] = {f"atlas_{s:g}": near(s) for s in STIFFNESS} if has_atlas else {}
    return candidates | ({"alone": alone} if slides >= LEAST_ALONE else {})


def _unsolved(slides: int, config: CalibrationConfig, sensor: Sensor) -> dict[str, _Fit]:
    """The fits of a sensor whose mechanics are not known: from recordings alone, a spacing and a smoothness each.

    Raises:
        InputError: too few slides.
    """
    if slides < LEAST_UNSOLVED:
        raise InputError(f"{sensor.name}: {slides} labelled slides; record at least {LEAST_UNSOLVED}")

    def alone(spacing_mm: float, smoothness: float) -> _Fit:
        smooth = config.stiffened(smoothness)
        return lambda part: calibrate(
            part.slides, blank_map(sensor, part.depth_mm, spacing_mm), False, smooth
        )

    return {
        f"alone_{spacing:.1f}_mm_{smoothness:g}": alone(spacing, smoothness)
        for spacing in SPACINGS_MM
        for smoothness in (SMOOTHNESS if slides < MANY else SMOOTHNESS[:1])
    }


def _parts(
    slides: list[CalibrationSlide], atlas: Atlas | None, sensor: Sensor, spread: SensorSpread
) -> tuple[_Part, list[_Part]]:
    """All the slides; and all but a fold of lines each, where there are enough slides for folds."""
    depth_mm = float(np.median([s.depth_mm for s in slides])) if slides else USUAL_DEPTH_MM

    def part(seen: list[CalibrationSlide], unseen: list[CalibrationSlide]) -> _Part:
        prior, moved = (None, {}) if atlas is None else prior_map(atlas, sensor, seen, depth_mm, spread)
        return _Part(seen, prior, moved, depth_mm, unseen)

    whole = part(slides, [])
    if len(slides) < 2 * FOLDS:
        return whole, []
    direction = np.array([s.direction_rad for s in slides])
    fold = line_folds(direction, np.array([s.line_offset_mm for s in slides]), FOLDS)
    split = [
        tuple([s for s, f in zip(slides, fold, strict=True) if (f == number) == out] for out in (False, True))
        for number in np.unique(fold)
    ]
    if not sensor.measures_gravity:
        split = [(_by_cell(seen, False), _by_cell(unseen, True)) for seen, unseen in split]
    return whole, [part(seen, unseen) for seen, unseen in split]


def _by_cell(slides: list[CalibrationSlide], held_out: bool) -> list[CalibrationSlide]:
    """What of the slides lies in the cells that are held out, or outside them."""
    kept = []
    for slide in slides:
        cell = np.floor(np.stack(slide.place(0.0, 0.0), axis=1) / CELL_MM).astype(int)
        inside = [
            np.random.default_rng(cell_of % 2**32).random() < CELL_SHARE for cell_of in cell @ (1, 1009)
        ]
        mask = np.array(inside) == held_out
        if mask.sum() >= LEAST_STRETCHES:
            parts = {name: getattr(slide, name)[mask] for name in ("travelled_mm", "speed_mm_s", "volts")}
            kept.append(replace(slide, **parts))
    return kept


def _cross_validated(
    candidates: dict[str, _Fit], whole: _Part, folds: list[_Part]
) -> tuple[ResponseMap, Maps, dict[str, float]]:
    """The candidate with the least held-out residual: fitted to all slides, to each fold's, and its figures."""
    maps = {name: [fit(fold)[0] for fold in folds] for name, fit in candidates.items()}
    residual = {name: _residual_share(fitted, folds) for name, fitted in maps.items()}
    best = min(candidates, key=lambda name: residual[name])
    response, summary = candidates[best](whole)
    if not response.rim:
        # What the map leaves of places that it was not fitted to; of those that it was it leaves less.
        floor_v = float(np.sqrt(np.mean(_residuals_v(maps[best], folds) ** 2)))
        response = replace(response, floor_v=floor_v)
        maps[best] = [replace(fitted, floor_v=floor_v) for fitted in maps[best]]
        summary = summary | {"residual_v": floor_v, "spacing_mm": response.spacing_mm}
    shares = {f"heldout_residual_{name}": share for name, share in residual.items() if folds}
    names = [np.array([slide.recording for slide in fold.unseen]) for fold in folds]
    figures = whole.moved | summary | shares | {"from_atlas": float(best.startswith("atlas"))}
    return response, list(zip(maps[best], names, strict=True)), figures


def _residual_share(maps: list[ResponseMap], folds: list[_Part]) -> float:
    """Median over held-out slides of the rms residual as a share of the slide's largest output; 0 without folds."""
    peaks_v = [np.abs(slide.volts).max() for fold in folds for slide in fold.unseen]
    return float(np.median(_residuals_v(maps, folds) / peaks_v)) if peaks_v else 0.0


def _residuals_v(maps: list[ResponseMap], folds: list[_Part]) -> np.ndarray:
    """(n,) V: rms residual of each held-out slide beside the map that was not fitted to it."""
    return np.array(
        [
            fit_slide(slide, response, CalibrationConfig()).rms_v
            for response, fold in zip(maps, folds, strict=True)
            for slide in fold.unseen
        ]
    )
