"""From a sensor's slides and its design to its response map, the residual lag undone.

Top-down: read the slides (slides.py), the onset of those whose labels leave it out (onset.py); fit candidates
(calibrate.py) near the design (from_atlas.py) or from recordings alone; choose the one that predicts held-out lines
best; undo the lag that is left (slide_fit.py), and repeat.

Candidates near the atlas's prior have one of three stiffnesses: a coarse or foreign atlas must not spoil what many
recordings show, and few recordings need the atlas and a fit that keeps close to it. Of a sensor whose mechanics are not
solved the candidates are splines of several spacings, and what is held out of a fit is whole lines and cells of the
skin: lines that are close together or cross show the same places.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from softslide.features.angles import touch_channels
from softslide.features.contact.calibration import ContactCalibration
from softslide.features.errors import InputError
from softslide.features.height import HeightCalibration
from softslide.features.stream.conditioning import Conditioning
from softslide.models.held_out import line_folds
from softslide.models.response_map.calibrate import blank_map, calibrate
from softslide.models.response_map.card import calibrated_heights, contact_calibration
from softslide.models.response_map.from_atlas import SensorSpread, prior_map, tilt_v_per_g
from softslide.models.response_map.map import SPACING_MM, ResponseMap
from softslide.models.response_map.onset import moved, with_onsets
from softslide.models.response_map.slide_fit import CalibrationConfig, fit_slide, with_lag
from softslide.models.response_map.slides import (
    LEAST_APART_MM,
    CalibrationSlide,
    at_height,
    calibration_slides,
    main_height_mm,
    static_scatter,
)
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.derived_labels import USUAL_DEPTH_MM
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.sensor import Sensor

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
# A map over heights that leaves so many times as much of held-out lines as maps of one height each: its heights are
# wrong. Right ones leave up to 1.01 times as much, those of two pressures that are swapped 1.19 (experiments/LOG.md).
WRONG_HEIGHTS = 1.1
FITS = 4  # at most: the lag is found in the first, what of it is left in the others

Maps = list[tuple[ResponseMap, np.ndarray]]


@dataclass(frozen=True)
class CalibratedMap:
    """A sensor's response map and what it was found from.

    response: fitted to all slides. held_out: for honest errors, maps fitted without some lines, each with the names of
    those lines' recordings. conditioning: of the signal that it is a map of, the lag undone. slides: how many there
    were. summary: figures of the fit; `from_atlas` is 1 where the candidate chosen starts from an atlas.
    folder: the recordings with the motion of every slide used, fitted where the labels leave it out (untimed of
    them). left_out: why a recording is not among the slides, by name.
    """

    response: ResponseMap
    held_out: Maps
    conditioning: Conditioning
    slides: int
    summary: dict[str, float]
    folder: Folder
    untimed: int
    left_out: dict[str, str]

    @property
    def heights(self) -> HeightCalibration | None:
        """What a device needs to know of the heights of the skin; None where the slides have one."""
        return calibrated_heights(self.response)

    def contact(self, atlas: Atlas | None) -> ContactCalibration:
        """What a device needs to track contacts, with what recordings and design show of the output at rest."""
        if self.response.height_slope is not None:
            static = static_scatter(self.folder, self.conditioning, self.response.height_mm)
            touch = touch_channels(3 * len(self.folder.sensor.accelerometers), self.conditioning.touch_axes)
            inflation = () if static is None else tuple(static.v_per_mm[touch].tolist())
            return contact_calibration(self.response, inflation, static)
        inflation = self._inflation_v_per_mm(atlas)
        static = static_scatter(self.folder, self.conditioning) if inflation else None
        return contact_calibration(self.response, inflation, static)

    def _inflation_v_per_mm(self, atlas: Atlas | None) -> tuple[float, ...]:
        """(C,) V/mm, by which the output at rest changes as the skin rises, as the solved design shows it on the whole
        of its way from the flat skin; empty where it is not known."""
        if atlas is None:
            return ()
        tilts_g = atlas.statics[:, :, :2].reshape(len(atlas.height_mm), -1)
        per_mm = atlas.height_mm @ tilts_g / (atlas.height_mm @ atlas.height_mm)
        sensor = self.folder.sensor.scaled(self.conditioning.scale)
        # A board that tilts so many times as far in a contact does so at rest.
        gains = [self.summary.get(f"{board.name}_gain", 1.0) for board in sensor.accelerometers]
        return tuple((tilt_v_per_g(sensor) * np.repeat(gains, 2) * per_mm).tolist())


def calibrated_map(
    folder: Folder,
    atlas: Atlas | None,
    conditioning: Conditioning,
    calibration: CalibrationConfig,
    spread: SensorSpread,
) -> CalibratedMap:
    """Calibrates on the folder's slides: the map, the lag it shows, then the map of the signal without this lag.

    A lag that `conditioning` already names is taken as it is. Slides at several heights of the skin share one map over
    heights, unless maps of one height each predict held-out lines clearly better: then it is that of the height of
    most, and the others are left out.

    Raises:
        InputError: neither an atlas nor enough slides, or none of the folder's recordings can be used.
    """
    folder, left_out = with_onsets(folder, atlas, conditioning, spread, calibration)
    known = _Known(atlas, folder.sensor.scaled(conditioning.scale), spread, calibration)
    found, slides = _fitted(folder, left_out, conditioning, known)
    if found.response.height_slope is not None:
        shares = _shares_at_other_heights(slides, found.held_out, known)
        figures = {f"heldout_residual_{name}": share for name, share in shares.items()}
        if shares and shares["map_over_heights"] > WRONG_HEIGHTS * shares["map_a_height"]:
            others = [slide.recording for slide in _at_other_heights(slides)]
            why = "a map of each height predicts held-out lines better; train one for it"
            folder = replace(folder, manifest=folder.manifest.drop(index=others))
            found, slides = _fitted(folder, left_out, found.conditioning, known)
            found = replace(found, left_out=found.left_out | dict.fromkeys(others, why))
        found = replace(found, summary=found.summary | figures)
    untimed = [slide for slide in slides if not slide.timed]
    shifts = {slide.recording: fit_slide(slide, found.response, calibration).shift_mm for slide in untimed}
    return replace(found, folder=moved(folder, shifts), untimed=len(untimed))


@dataclass(frozen=True)
class _Known:
    """What is known of a sensor before any of its slides is read, and the fit's constants."""

    atlas: Atlas | None
    sensor: Sensor
    spread: SensorSpread
    config: CalibrationConfig


def _fitted(
    folder: Folder, left_out: dict[str, str], conditioning: Conditioning, known: _Known
) -> tuple[CalibratedMap, list[CalibrationSlide]]:
    """The map of the signal without the lag that maps show, and its slides; a lag that `conditioning` names is not
    looked for. left_out: why a recording has no place."""
    undone = conditioning
    for _ in range(FITS):
        read = undone
        slides = calibration_slides(folder, read)
        unused = _unused(folder, slides, left_out)
        response, held_out, summary = _chosen(slides, known)
        undone = read if conditioning.delayed > 0 else with_lag(read, slides, response, held_out)
        if undone == read:
            break
    summary |= {"delayed": read.delayed, "tau_s": read.tau_s}
    return CalibratedMap(response, held_out, read, len(slides), summary, folder, 0, unused), slides


def _unused(folder: Folder, slides: list[CalibrationSlide], left_out: dict[str, str]) -> dict[str, str]:
    """Why each recording that is not among the slides is not, by name: as in left_out, or for want of a rest.

    Raises:
        InputError: there are recordings and no slides.
    """
    used = {slide.recording for slide in slides}
    names = [str(name) for name in folder.manifest.index if name not in used]
    unused = {name: left_out.get(name, "no rest before its motion") for name in names}
    if names and not used:
        raise InputError(
            f"{folder.root}: none of {len(names)} labelled recordings can be used "
            f"({names[0]}: {unused[names[0]]}); mend them, or train from the design alone"
        )
    return unused


@dataclass(frozen=True)
class _Part:
    """slides: to fit to. prior: a map of the design moved to them (None without an atlas), with what moved it.
    unseen: the slides that were left out."""

    slides: list[CalibrationSlide]
    prior: ResponseMap | None
    moved: dict[str, float]
    depth_mm: float
    unseen: list[CalibrationSlide]


@dataclass(frozen=True)
class _Candidate:
    """A fit that is possible: near an atlas's prior or from recordings alone, with so many times the penalties."""

    near_atlas: bool
    stiffness: float = 1.0
    spacing_mm: float = SPACING_MM

    def fit(self, part: _Part, known: _Known) -> tuple[ResponseMap, dict[str, float]]:
        """The map of a part's slides, and the fit's figures."""
        config, prior = known.config.stiffened(self.stiffness), part.prior
        if self.near_atlas:
            assert prior is not None
            return calibrate(part.slides, prior, True, config) if part.slides else (prior, {})
        start = blank_map(known.sensor, part.depth_mm, self.spacing_mm)
        if prior is not None:
            # Recordings of one depth say nothing of others: that part is the design's in any case.
            start = replace(start, depth_slope=prior.depth_slope, height_slope=prior.height_slope)
        return calibrate(part.slides, start, False, config)


def _candidates(slides: int, known: _Known) -> dict[str, _Candidate]:
    """The fits of so many slides that are possible, by name.

    Raises:
        InputError: neither an atlas nor enough slides.
    """
    name = known.sensor.name
    if not known.sensor.measures_gravity:
        if slides < LEAST_UNSOLVED:
            raise InputError(f"{name}: {slides} labelled slides; record at least {LEAST_UNSOLVED}")
        return {
            f"alone_{spacing:.1f}_mm_{smoothness:g}": _Candidate(False, smoothness, spacing)
            for spacing in SPACINGS_MM
            for smoothness in (SMOOTHNESS if slides < MANY else SMOOTHNESS[:1])
        }
    if known.atlas is None and slides < LEAST_ALONE:
        raise InputError(
            f"{name}: {slides} labelled slides and no atlas; record at least {LEAST_ALONE}, "
            "or name an atlas that 'softslide simulate' made"
        )
    near = {f"atlas_{s:g}": _Candidate(True, s) for s in STIFFNESS if known.atlas is not None}
    return near | ({"alone": _Candidate(False)} if slides >= LEAST_ALONE else {})


def _parts(slides: list[CalibrationSlide], known: _Known) -> tuple[_Part, list[_Part]]:
    """All the slides; and all but a fold of lines each, where there are enough slides for folds."""
    depth_mm = float(np.median([s.depth_mm for s in slides])) if slides else USUAL_DEPTH_MM

    def part(seen: list[CalibrationSlide], unseen: list[CalibrationSlide]) -> _Part:
        prior, moved = (
            (None, {})
            if known.atlas is None
            else prior_map(known.atlas, known.sensor, seen, depth_mm, known.spread)
        )
        return _Part(seen, prior, moved, depth_mm, unseen)

    whole = part(slides, [])
    if len(slides) < 2 * FOLDS:
        return whole, []
    direction = np.array([s.direction_rad for s in slides])
    fold = line_folds(direction, np.array([s.line_offset_mm for s in slides]), FOLDS)
    split = [
        (list(compress(slides, fold != number)), list(compress(slides, fold == number)))
        for number in np.unique(fold)
    ]
    if not known.sensor.measures_gravity:
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


def _chosen(slides: list[CalibrationSlide], known: _Known) -> tuple[ResponseMap, Maps, dict[str, float]]:
    """The candidate with the least held-out residual: fitted to all slides, to each fold's, and its figures."""
    candidates = _candidates(len(slides), known)
    whole, folds = _parts(slides, known)
    names = [np.array([slide.recording for slide in fold.unseen]) for fold in folds]
    maps: dict[str, Maps] = {name: [] for name in candidates}
    work = [(name, fold, out) for name in candidates for fold, out in zip(folds, names, strict=True)]
    for name, fold, out in progress_bar("calibrating the map", "fit", work):
        maps[name].append((candidates[name].fit(fold, known)[0], out))
    unseen = [slide for fold in folds for slide in fold.unseen]
    residual = {name: _median(_residuals(fitted, unseen)) for name, fitted in maps.items()}
    best = min(candidates, key=lambda name: residual[name])
    held_out = maps[best]
    response, summary = candidates[best].fit(whole, known)
    if not response.rim:
        # What the map leaves of places that it was not fitted to; of those that it was it leaves less.
        floor_v = float(np.sqrt(np.mean(np.square([rms_v for rms_v, _ in _residuals(held_out, unseen)]))))
        response = replace(response, floor_v=floor_v)
        held_out = [(replace(fitted, floor_v=floor_v), out) for fitted, out in held_out]
        summary = summary | {"residual_v": floor_v, "spacing_mm": response.spacing_mm}
    shares = {f"heldout_residual_{name}": share for name, share in residual.items() if folds}
    from_atlas = {"from_atlas": float(candidates[best].near_atlas)}
    return response, held_out, whole.moved | summary | shares | from_atlas


def _shares_at_other_heights(
    slides: list[CalibrationSlide], held_out: Maps, known: _Known
) -> dict[str, float]:
    """What a map over heights (held_out) and what a map of each height leave of held-out lines at other heights than
    that of most: the median residual as a share of a slide's largest output. Empty where no height has enough slides:
    heights anywhere between two are none.
    """
    others = sorted(_at_other_heights(slides), key=lambda slide: slide.height_mm)
    gaps = np.flatnonzero(np.diff([slide.height_mm for slide in others]) > LEAST_APART_MM) + 1
    least = 2 * FOLDS if known.atlas is not None else LEAST_ALONE
    shared: list[tuple[float, float]] = []
    apart: list[tuple[float, float]] = []
    for at in np.split(np.arange(len(others)), gaps):
        group = [others[n] for n in at]
        if len(group) >= least and group[-1].height_mm - group[0].height_mm <= 2 * LEAST_APART_MM:
            shared += _residuals(held_out, group)
            apart += _residuals(_chosen(group, known)[1], group)
    return {"map_over_heights": _median(shared), "map_a_height": _median(apart)} if shared else {}


def _at_other_heights(slides: list[CalibrationSlide]) -> list[CalibrationSlide]:
    """The slides at other heights of the skin than that of most."""
    return list(compress(slides, ~at_height(slides, main_height_mm(slides))))


def _residuals(maps: Maps, slides: list[CalibrationSlide]) -> Iterator[tuple[float, float]]:
    """Of each slide and the map that was not fitted to it: the rms residual, V, and its share of the largest output."""
    for response, unseen in maps:
        for slide in slides:
            if slide.recording in unseen:
                rms_v = fit_slide(slide, response, CalibrationConfig()).rms_v
                yield rms_v, float(rms_v / np.abs(slide.volts).max())


def _median(residuals: Iterable[tuple[float, float]]) -> float:
    """Of the residuals' shares; 0 without any."""
    shares = [share for _, share in residuals]
    return float(np.median(shares)) if shares else 0.0
