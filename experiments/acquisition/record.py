"""`softslide record`: walks through a plan, slide by slide, into a folder of recordings.

Each slide is written when it is kept, so that the folder is whole at any time and the same command goes on where an
earlier one stopped. A slide during which the source was gone or lost samples is not kept, and recorded again.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pandas as pd

from softslide.experiments.acquisition.approach import MOST_MM, approach
from softslide.experiments.acquisition.capture import Level, Listener, Lost, Phases, capture, remarks
from softslide.experiments.acquisition.dialogue import Operator, Stopped, level_bar
from softslide.experiments.acquisition.driven import drive_in_the_air, driven
from softslide.experiments.acquisition.gcode import CLEAR_MM, NEEDED
from softslide.experiments.acquisition.stage import Stage, check_slides
from softslide.experiments.acquisition.waypoints import read_waypoints, truth_of, waypoints_of
from softslide.features.errors import CheckFailed, InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.atlas.library import atlas_of
from softslide.pipeline.recordings.base_motion import BASE_SPLIT
from softslide.pipeline.recordings.folder import Folder, Recording
from softslide.pipeline.recordings.growing_folder import add_recording, open_growing
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.recordings.manifest import LABELS, check_manifest, read_table
from softslide.pipeline.sensor import Sensor, read_sensor

LIVE = ("serial://", "udp://", "ros2://")
BASE_S = 60.0  # of a robot that moves while nothing touches, where the plan gives no travel and speed
ATTEMPTS = 3  # at a slide that fails with nobody to ask
RAMP_S = 1.0  # a stage's ramps come on top of way over speed; `softslide check` allows as much
ON_THE_MIDDLE = "Pressure off: put the ball over the chamber's middle, just touching the skin. Enter lifts it"
ABOVE = "Pressure off. Enter lowers the ball over the chamber's middle until an output changes"
INFLATED = "Turn the pressure on and let it settle. Enter begins"


@dataclass(frozen=True)
class Bench:
    """What a slide is recorded with. rest_s, start_s: as in `Phases`. wait_s: for the source to come back. atlas: of
    the design, where the plan has paths: by it the skin is touched."""

    listener: Listener
    operator: Operator
    rest_s: float
    start_s: float
    wait_s: float
    stage: Stage | None
    atlas: Atlas | None


def record(
    source: str,
    plan: str | Path,
    out: str | Path,
    sensor: str | Path | None = None,
    format: str = "csv",
    rest_s: float = 3.0,
    start_s: float = 3.0,
    timeout_s: float = 2.0,
    wait_s: float = 600.0,
    yes: bool = False,
    stage: str | None = None,
    origin_mm: Sequence[float] | None = None,
    dry_run: bool = False,
    until: Sequence[str] = (),
    page: str | Path | None = None,
    approach_mm: float | None = None,
) -> tuple[Folder, int]:
    """Records the slides of a plan that the folder `out` does not hold yet. Returns the folder, and how many are left.

    source: serial://, udp:// or ros2://, as in serve/stream/sources.py. sensor: a sensor.toml; None: the folder's own.
    format: csv or f32, of the bytes that come in. rest_s: before and after each motion; start_s: to start the stage in;
    timeout_s: silence that counts as a pulled cable; wait_s: for the source to come back. yes: asks nothing.
    stage: what moves the ball, and origin_mm, as in `Stage`; None: a person does. dry_run: drives the slides above the
    skin, and records nothing. approach_mm: the stage is above the skin at first, and finds its height by going down so
    far at most (approach.py). until: errors ("0.3deg", "0.7%", "0.09mm") from which on no more slides to learn from are
    recorded; page: an HTML file to show slides and errors on meanwhile (verdict.py).

    Raises:
        InputError: the source, the plan, the sensor, the folder or the stage is wrong, the source did not come back, or
            the output left its range while the stage moved.
        CheckFailed: a slide failed ATTEMPTS times with nobody to ask.
    """
    if not source.startswith(LIVE):
        raise InputError(f"{source}: name a live one, {', '.join(f'{kind}...' for kind in LIVE)}", "source")
    for option, time_s in {"rest": rest_s, "start": start_s, "timeout": timeout_s, "wait": wait_s}.items():
        if not time_s > 0:
            raise InputError(f"{time_s:g}: give a positive time in s", option)
    folder = open_growing(Path(out), None if sensor is None else read_sensor(sensor))
    slides = read_plan(Path(plan), folder.sensor)
    operator = Operator(yes)
    is_enough = _goal(until, page, slides, folder.sensor, operator.say)
    _check_options(stage, origin_mm, approach_mm, dry_run, yes)
    paths = slides.index[slides["waypoints"].notna()]
    if stage is not None:
        check_slides(slides, folder.sensor)
    elif len(paths):
        raise InputError(f"{plan}: {paths[0]} follows waypoints, which takes a stage; name one", "stage")
    atlas = atlas_of(folder.sensor) if len(paths) else None
    if done := slides.index.isin(folder.manifest.index).sum():
        operator.say(f"{folder.root}: {done} of {len(slides)} slides are recorded; going on")
    enough = is_enough(folder)
    with ExitStack() as stack, suppress(Stopped):
        listener = stack.enter_context(closing(Listener(source, folder.sensor, format, timeout_s)))
        mover = None
        if stage is not None:
            if origin_mm is None:
                operator.ask(ON_THE_MIDDLE)
            mover = stack.enter_context(Stage(stage, origin_mm))
            _set_up(mover, listener, operator, origin_mm is None, approach_mm)
        if mover is not None and dry_run:
            for name, labels in slides.iterrows():
                operator.say(f"{name}: {CLEAR_MM:g} mm above the flat skin's face")
                drive_in_the_air(mover, waypoints_of(labels))
        else:
            bench = Bench(listener, operator, rest_s, start_s, wait_s, mover, atlas)
            folder = _all_slides(slides, folder, bench, is_enough, enough)
    return folder, int((~slides.index.isin(folder.manifest.index)).sum())


def _check_options(
    stage: str | None, origin_mm: Sequence[float] | None, approach_mm: float | None, dry_run: bool, yes: bool
) -> None:
    """Raises InputError where options of `record` do not go together."""
    given = {"dry_run": dry_run or None, "origin": origin_mm, "approach_mm": approach_mm}
    if stage is None and (of_stage := [name for name, value in given.items() if value is not None]):
        raise InputError("is for a stage; name one", of_stage[0])
    if stage is not None and origin_mm is None and yes:
        raise InputError("is needed where nobody is there to put the ball on the skin's middle", "origin")
    if approach_mm is None:
        return
    if not 0 < approach_mm <= MOST_MM:
        raise InputError(f"{approach_mm:g} mm; the ball is lowered by at most {MOST_MM:g}", "approach_mm")
    if yes or origin_mm is None:
        raise InputError("needs an origin, and somebody who turns the pressure on after it", "approach_mm")


def _set_up(
    stage: Stage, listener: Listener, operator: Operator, by_hand: bool, approach_mm: float | None
) -> None:
    """Lifts the ball, after its height was found if that is asked for. by_hand: the ball was put on the skin.

    Raises:
        Stopped: the operator stops.
    """
    if approach_mm is not None:
        operator.ask(ABOVE)
        found_mm = approach(stage, listener, approach_mm)
        operator.say(f"the flat skin's face is {found_mm:g} mm below the origin")
    stage.lift()
    if by_hand or approach_mm is not None:
        operator.ask(INFLATED)


def _all_slides(
    slides: pd.DataFrame, folder: Folder, bench: Bench, is_enough: Callable[[Folder], bool], enough: bool
) -> Folder:
    """The folder with every slide of the plan that it has not, until the operator stops.

    enough: whether the slides to learn from are left out, as `is_enough` may say later too.
    """
    say = bench.operator.say
    for place, (name, labels) in enumerate(slides.iterrows(), 1):
        if name in folder.manifest.index or (enough and labels["split"].startswith(CALIBRATION)):
            continue
        say(f"[{place}/{len(slides)}] {name}: {_described(labels)}")
        try:
            slide = _slide(str(name), labels, bench)
        except Stopped:
            break
        if slide is not None:
            folder = add_recording(folder, *slide)
            say(f"kept: {folder.root}, {len(folder)} recordings")
            enough = is_enough(folder)
    return folder


def _goal(
    until: Sequence[str],
    page: str | Path | None,
    slides: pd.DataFrame,
    sensor: Sensor,
    say: Callable[[str], None],
) -> Callable[[Folder], bool]:
    """Whether a folder has enough slides to learn from."""
    if not until and page is None:
        return lambda folder: False
    # What calibrates a map and draws is of the train extra.
    from softslide.experiments.acquisition.error_so_far import atlas_to_calibrate
    from softslide.experiments.acquisition.verdict import Verdict

    # Before anything is recorded: where none is at hand it takes minutes.
    verdict = Verdict(until, None if page is None else Path(page), slides, atlas_to_calibrate(sensor))
    return partial(verdict.is_enough, say=say)


def _described(labels: pd.Series) -> str:
    """A slide in words: what the stage is set to."""
    if labels["split"] == BASE_SPLIT:
        return f"lean the robot over in all directions for {_motion_s(labels):g} s, nothing touches"
    if labels["waypoints"] is not None:
        return f"{len(labels['waypoints'])} waypoints, {_motion_s(labels) - RAMP_S:.1f} s"
    text = (
        f"from x {labels.start_x_mm:g}, y {labels.start_y_mm:g} mm, direction {labels.direction_deg:g} deg, "
        f"{labels.travel_mm:g} mm at {labels.speed_mm_s:g} mm/s"
    )
    return text if math.isnan(labels.depth_mm) else f"{text}, depth {labels.depth_mm:g} mm"


def _motion_s(labels: pd.Series) -> float:
    """How long the motion takes, s."""
    moves_s = float(waypoints_of(labels)[-1, 0]) + RAMP_S
    return BASE_S if labels["split"] == BASE_SPLIT and math.isnan(moves_s) else moves_s


def _slide(name: str, labels: pd.Series, bench: Bench) -> tuple[Recording, dict[str, object]] | None:
    """One slide that the operator keeps, and its labels for the manifest; None if it is skipped.

    Raises:
        Stopped: the operator stops.
        InputError, CheckFailed: as `record`.
    """
    listener, operator = bench.listener, bench.operator
    lost_s = 0.0 if bench.stage is None else bench.stage.lost_s(waypoints_of(labels))
    phases = Phases(bench.rest_s, bench.start_s, _motion_s(labels) + lost_s)
    of_base, failed = labels["split"] == BASE_SPLIT, 0
    begin = (
        "Let the robot begin" if of_base else "Set the stage" if bench.stage is None else "The stage is set"
    )
    while True:
        listener.wait(bench.wait_s, operator.say)
        if _answer(bench, f"{begin}. Enter records, s skips") == "s":
            return None
        try:
            slide, known = _captured(name, labels, phases, bench)
        except Lost as reason:
            failed += 1
            operator.say(f"{name} is not kept: {reason}")
            if operator.absent and failed == ATTEMPTS:
                raise CheckFailed(f"{name} failed {ATTEMPTS} times: {reason}; what is kept stays") from None
            continue
        for remark in remarks(slide, listener.sensor, phases, touched=not of_base):
            operator.say(f"  {remark}")
        answer = _answer(bench, "Keep it? Enter keeps, a records again, s skips")
        if answer != "a":
            return None if answer == "s" else (slide, known)


def _answer(bench: Bench, question: str) -> str:
    """As `Operator.ask`, with the level next to the question."""
    level = Level(bench.listener.sensor.sample_rate_hz)
    return bench.operator.ask(question, lambda: level_bar(level.of(bench.listener.take())))


def _captured(
    name: str, labels: pd.Series, phases: Phases, bench: Bench
) -> tuple[Recording, dict[str, object]]:
    """The slide and its labels, with the moments of motion where a stage drives it, which knows them.

    Raises:
        Lost, InputError: as `capture`, or as `driven`.
    """
    show = bench.operator.guide(phases, bench.stage is not None)
    known = {str(k): v for k, v in labels.drop("waypoints").items()}
    if bench.stage is None:
        return capture(bench.listener, name, phases, show)[0], known
    way = waypoints_of(labels)
    slide, moments_s = driven(name, way, phases, bench.stage, bench.listener, show)
    if labels["waypoints"] is not None and bench.atlas is not None:
        slide = replace(slide, truth=truth_of(way, moments_s, slide.time_s[-1], bench.atlas))
    start_s, end_s = moments_s[[0, -1], 1].round(4).tolist()
    return slide, known | {"motion_start_s": start_s, "motion_end_s": end_s}


def read_plan(path: Path, sensor: Sensor) -> pd.DataFrame:
    """The slides by name, with `split` and the manifest's labels as columns; those not given are NaN.

    And `waypoints`, as in waypoints.py, of rows that name a file of them, from the plan's folder; None of others.
    Slides without a name are called p01, p02, ...; without a split they are `calibration`. Rows of the split `base`, of
    a robot that moves, need no label.

    Raises:
        InputError: no such file, also of waypoints, no rows, a label that a stage needs is missing, a cell is wrong, or
            a row is of a base that the sensor has not.
    """
    table = read_table(path)
    if "recording" not in table:
        table["recording"] = [f"p{n:02d}" for n in range(1, len(table) + 1)]
    table = table.assign(split=table.get("split", "calibration"), file="-")
    plan = check_manifest(table, sensor, path)
    of_base = plan["split"] == BASE_SPLIT
    if of_base.any() and sensor.base is None:
        raise InputError(
            f"{path}: {plan.index[of_base][0]} is of the split '{BASE_SPLIT}', and sensor.toml has no [base]"
        )
    table_of = plan.get("waypoints", pd.Series("", plan.index)).fillna("").astype(str)
    for column in NEEDED:
        if (empty := plan[column].isna() & ~of_base & (table_of == "")).any():
            row = int(empty.to_numpy().argmax())
            raise InputError(
                f"{path}: row {row + 1} ({plan.index[row]}), {column} is empty; a stage needs it, write it"
            )
    plan = plan[["split", *LABELS]]
    tables = [read_waypoints(path.parent / file) if file else None for file in table_of]
    return plan.assign(waypoints=pd.Series(tables, plan.index, object))
