"""Slides that end with a stop on the skin, and others, through a real bundle: what evidence lets through and what not.

The bundle in `docs/examples/bundle` is of a synthetic sensor: `softslide synthesize --slides 138 --seed 301 --config
stop.toml` with `stopping = 0.3`, then `softslide train`. The slides are the same sensor's, drawn anew here.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from streams import pushed

from softslide.experiments.evaluation.tracks import estimate_table, judge
from softslide.features.angles import wrapped_deg
from softslide.features.estimate import Contact, Estimate
from softslide.features.stream.tracker import SlideState
from softslide.pipeline.atlas.atlas import Atlas, read_atlas
from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.no_contact import SIGNALS, untouched
from softslide.pipeline.synthesis.paths.draw import draw_path
from softslide.pipeline.synthesis.slide_plan import Slide
from softslide.pipeline.synthesis.specimen import Specimen, draw_specimen
from softslide.pipeline.synthesis.synthesize import noise_of, plan, record, sensor_of
from softslide.serve.localizer import Localizer
from softslide.serve.records import record as as_record

SEED = 301
# On less than half of the way not every slide is known yet.
STOPPING = Distribution(
    stopping=1.0, turning=0.0, stop_share=(0.5, 0.9), rest_s=(1.0, 3.0), speed_mm_s=(2.0, 13.0)
)
SLIDES = range(200, 206)
Streams = list[tuple[Slide, list[Estimate]]]


@pytest.fixture(scope="module")
def localizer() -> Localizer:
    return Localizer.load(Path(__file__).parents[1] / "docs" / "examples" / "bundle")


@cache
def skin() -> tuple[Atlas, Specimen]:
    atlas = read_atlas()
    return atlas, draw_specimen(sensor_of(atlas), STOPPING, SEED)


def drawn_slide(
    number: int, distribution: Distribution = STOPPING, **changes: float
) -> tuple[Slide, Recording]:
    atlas, specimen = skin()
    slide = replace(plan(number, SEED, atlas, sensor_of(atlas), distribution), **changes)
    return slide, record(slide, specimen, atlas, noise_of(number, SEED))


def valid_errors(
    localizer: Localizer,
    drawn: tuple[Slide, Recording],
    since: float,
    misfits: tuple[float, float] | None = None,
) -> np.ndarray:
    """(n, 3): of the valid estimates between this share of the way and 0.95, with a misfit between these if given."""
    slide, recording = drawn
    found = []
    for estimate in pushed(localizer, recording.volts):
        share = (estimate.time_s - slide.motion_start_s) / slide.stroke.forth_s
        if misfits is not None and not misfits[0] < estimate.misfit < misfits[1]:
            continue
        if estimate.valid and since < share < 0.95:
            found.append(errors(slide, estimate))
    return np.array(found).reshape(-1, 3)


@pytest.fixture(scope="module")
def streams(localizer: Localizer) -> Streams:
    found = []
    for number in SLIDES:
        slide, recording = drawn_slide(number, rest_after_s=3.0)
        found.append((slide, pushed(localizer, recording.volts)))
    return found


def errors(slide: Slide, estimate: Estimate) -> np.ndarray:
    """Direction deg, speed %, offset mm (3,)."""
    turn = float(wrapped_deg(estimate.direction_deg - slide.direction_deg))
    faster = 100 * (estimate.speed_mm_s / slide.stroke.speed_mm_s - 1)
    return np.abs([turn, faster, estimate.offset_mm - slide.offset_mm])


def end_s(slide: Slide) -> float:
    return slide.motion_start_s + slide.stroke.duration_s


@pytest.mark.parametrize("later_s", [0.0, 2.5])
def test_a_slide_that_stops_keeps_the_line_and_speed_that_it_had(streams: Streams, later_s: float) -> None:
    """As the motion ends, and once the contact rests. Where its output is below the noise, it looks as if released."""
    found, resting = [], []
    for slide, estimates in streams:
        at = [e for e in estimates if e.time_s <= end_s(slide) + later_s][-1]
        assert at.valid, (slide.name, at.reason)
        found.append(errors(slide, at))
        if later_s:
            assert at.state is SlideState.ENDED
            resting.append(at.contact is Contact.STOPPED)
            assert (at.vx_mm_s == 0.0 and at.vy_mm_s == 0.0) == resting[-1]
    assert sum(resting) >= 0.75 * len(resting)
    assert (np.mean(found, axis=0) < [0.4, 0.8, 0.1]).all(), np.mean(found, axis=0)
    assert (np.max(found, axis=0) < [3.0, 5.0, 0.5]).all(), np.max(found, axis=0)


def test_no_slide_goes_another_way_for_long(streams: Streams) -> None:
    """Never five estimates in a row that are valid and more than 20 degrees off, nor as it creeps at rest."""
    for slide, estimates in streams:
        wrong = 0
        for estimate in estimates:
            wrong = wrong + 1 if estimate.valid and errors(slide, estimate)[0] > 20.0 else 0
            assert wrong < 5, (slide.name, estimate.time_s)


def test_while_a_contact_pauses_its_speed_is_zero(streams: Streams) -> None:
    """Between the stop and the end of the slide the contact rests where it is."""
    found = [e for _, estimates in streams for e in estimates if e.state is SlideState.SLIDE]
    resting = [e.speed_mm_s for e in found if e.contact is Contact.STOPPED]
    assert len(resting) > 100
    assert {*resting} == {0.0}


def test_a_slide_after_one_that_stopped_is_as_the_first(localizer: Localizer) -> None:
    """The stop before is not a part of it: it is followed live, and moves."""
    slide, recording = drawn_slide(206, rest_after_s=3.0)
    estimates = pushed(localizer, np.concatenate([recording.volts, recording.volts]))
    second_s = estimates[-1].time_s / 2
    moving = [e for e in estimates if second_s + end_s(slide) - 1.0 < e.time_s < second_s + end_s(slide)]
    assert {(e.state, e.contact, e.valid) for e in moving} == {(SlideState.SLIDE, Contact.SLIDE, True)}
    assert max(errors(slide, e)[0] for e in moving) < 3.0


def test_a_track_that_changes_its_speed_does_not_overrule_a_slide_that_fits(localizer: Localizer) -> None:
    """Two slow slides near the board, where the map's residual looks like a change of speed for a while."""
    slow = replace(STOPPING, stopping=0.0, speed_mm_s=(2.0, 8.0), rest_s=(1.0, 1.5))
    drawn = [drawn_slide(number, slow) for number in (309, 327)]
    off = np.concatenate([valid_errors(localizer, each, 0.4) for each in drawn])
    assert len(off) > 900
    assert (off[:, 1] > 20.0).mean() < 0.05


def test_a_misfit_that_grows_for_a_while_does_not_give_up_the_line(localizer: Localizer) -> None:
    """Two slides by the board, where the map's residual takes the misfit of a fit that is right over the limit: the
    track there is off by 0.7 deg and 2.3 % of the speed, and for moments it takes over (experiments/LOG.md)."""
    faster = replace(STOPPING, stopping=0.0, speed_mm_s=(4.0, 13.0), rest_s=(1.0, 1.5))
    drawn = [drawn_slide(number, faster) for number in (304, 317)]
    limit = localizer.card.validity.misfit
    off = np.concatenate([valid_errors(localizer, each, 0.3, (limit, 2 * limit)) for each in drawn])
    assert len(off) > 40
    middle = np.median(off, axis=0)
    assert (middle < [0.1, 0.3, 0.01]).all(), middle


@pytest.mark.parametrize(("kind", "number"), [("tilt", 7), ("drift", 7)])
def test_what_fits_a_straight_slide_and_no_contact_makes_is_not_valid(
    localizer: Localizer, kind: str, number: int
) -> None:
    """For 0.5 s and more a straight slide fits these signals, next to a track that is not valid itself."""
    contact = localizer.card.contact
    assert contact is not None
    random = np.random.default_rng([3, number])
    volts = untouched(sensor_of(skin()[0]), np.array(contact.static_v), SIGNALS[kind], 25.0, random)
    found = [e for e in pushed(localizer, volts) if e.state is SlideState.SLIDE]
    assert len(found) > 300
    assert not any(estimate.valid for estimate in found)


@pytest.mark.parametrize(("number", "least"), [(42, 0.78), (50, 0.3)])
def test_a_contact_that_came_down_in_mid_skin_is_valid_once_the_evidence_is_clear(
    localizer: Localizer, number: int, least: float
) -> None:
    """Their output keeps its shape for long, as a press's does: a straight slide is too early there, the track not."""
    (atlas, specimen), random = skin(), np.random.default_rng([0, number])
    path = draw_path(number, atlas, sensor_of(atlas), Distribution(), random, kind="touchdown")
    recording = record(path, specimen, atlas, noise_of(number, SEED))
    stream = estimate_table([as_record(estimate) for estimate in pushed(localizer, recording.volts)])
    assert recording.truth is not None
    judged = judge(stream, recording.truth, localizer.card.reference_mm)
    contact = judged[judged["touching"]]
    assert contact["live"].mean() > least
    assert not (contact["live"] & contact["wrong"]).any()
