"""`softslide record`: walks through a plan, slide by slide, into a folder of recordings.

Each slide is written when it is kept, so that the folder is whole at any time and the same command goes on where an
earlier one stopped. A slide during which the source was gone or lost samples is not kept, and recorded again.
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from softslide.experiments.acquisition.approach import MOST_MM, approach
from softslide.experiments.acquisition.capture import (
    POLL_S,
    Level,
    Listener,
    Lost,
    Phases,
    capture,
    remarks,
    stray,
)
from softslide.experiments.acquisition.dialogue import Operator, level_bar
from softslide.experiments.acquisition.gcode import CLEAR_MM, NEEDED, TRAVEL_MM_S, ends
from softslide.experiments.acquisition.stage import Stage, check_slides
from softslide.features.errors import CheckFailed, InputError
from softslide.pipeline.recordings.base_motion import BASE_SPLIT
from softslide.pipeline.recordings.folder import Folder, Recording
from softslide.pipeline.recordings.growing_folder import add_recording, open_growing
from softslide.pipeline.recordings.manifest import LABELS, check_manifest, read_table
from softslide.pipeline.sensor import Sensor, read_sensor
from softslide.serve.stream.sources import open_live

if TYPE_CHECKING:
    from softslide.experiments.acquisition.verdict import Verdict

LIVE = ("serial://", "udp://", "ros2://")
BASE_S = 60.0  # of a robot that moves while nothing touches, where the plan gives no travel and speed
ATTEMPTS = 3  # at a slide that fails with nobody to ask
RAMP_S = 1.0  # a stage's ramps come on top of way over speed; `softslide check` allows as much
ON_THE_MIDDLE = (
    "Pressure off: put the ball over the chamber's middle, just touching the skin. Enter lifts it, q stops:"
)
ABOVE = "Pressure off. Enter lowers the ball over the chamber's middle until an output changes, q stops:"
INFLATED = "Turn the pressure on and let it settle. Enter begins, q stops:"
# A skin is never tilted so far, by 49 degrees: a stage is stopped there.
LARGEST_TILT_G = 0.75


@dataclass(frozen=True)
class Times:
    """In s. rest: before and after each motion. start: to start the stage in. timeout: silence that counts as a pulled
    cable. wait: for the source to come back."""

    rest: float
    start: float
    timeout: float
    wait: float

    def __post_init__(self) -> None:
        for field in fields(self):
            if not getattr(self, field.name) > 0:
                raise InputError(f"{getattr(self, field.name):g}: give a positive time in s", field.name)


class _Stopped(Exception):
    """The operator stops."""


@dataclass(frozen=True)
class Bench:
    """What a slide is recorded with."""

    listener: Listener
    sensor: Sensor
    operator: Operator
    times: Times
    source: str
    stage: Stage | None = None


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
    format: csv or f32, of the bytes that come in. rest_s, start_s, timeout_s, wait_s: as in `Times`. yes: asks nothing.
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
    out, times = Path(out), Times(rest_s, start_s, timeout_s, wait_s)
    folder = open_growing(out, None if sensor is None else read_sensor(sensor))
    slides = read_plan(Path(plan), folder.sensor)
    operator, verdict = Operator(yes), _verdict(until, page, slides, folder.sensor)
    _check_options(stage, origin_mm, approach_mm, dry_run, yes)
    if stage is not None:
        check_slides(slides, folder.sensor)
    if done := int(slides.index.isin(folder.manifest.index).sum()):
        operator.say(f"{out}: {done} of {len(slides)} slides are recorded; going on")
    enough = verdict is not None and verdict.is_enough(folder, operator.say)
    columns = len(folder.sensor.columns)
    with ExitStack() as stack:
        listener = stack.enter_context(closing(Listener(lambda: open_live(source, columns, format))))
        bench = Bench(listener, folder.sensor, operator, times, source)
        if stage is not None:
            if origin_mm is None and operator.ask(ON_THE_MIDDLE, str) == "q":
                return folder, len(slides) - done
            driven = stack.enter_context(Stage(stage, origin_mm))
            if not _is_set_up(driven, bench, origin_mm is None, approach_mm):
                return folder, len(slides) - done
            bench = replace(bench, stage=driven)
        if dry_run and bench.stage:
            for name, labels in slides.iterrows():
                operator.say(f"{name}: {CLEAR_MM:g} mm above the flat skin's face")
                _drive_in_the_air(bench.stage, *ends(labels))
            return folder, len(slides) - done
        folder = _all_slides(slides, folder, bench, verdict, enough)
    return folder, int((~slides.index.isin(folder.manifest.index)).sum())


def _check_options(
    stage: str | None, origin_mm: Sequence[float] | None, approach_mm: float | None, dry_run: bool, yes: bool
) -> None:
    """Raises InputError where options of `record` do not go together."""
    given = {"dry_run": dry_run, "origin": origin_mm is not None, "approach_mm": approach_mm is not None}
    if stage is None and any(given.values()):
        raise InputError(
            "is for a stage; name one", next(name for name, is_given in given.items() if is_given)
        )
    if stage is not None and origin_mm is None and yes:
        raise InputError("is needed where nobody is there to put the ball on the skin's middle", "origin")
    if approach_mm is None:
        return
    if not 0 < approach_mm <= MOST_MM:
        raise InputError(f"{approach_mm:g} mm; the ball is lowered by at most {MOST_MM:g}", "approach_mm")
    if yes or origin_mm is None:
        raise InputError("needs an origin, and somebody who turns the pressure on after it", "approach_mm")


def _all_slides(
    slides: pd.DataFrame, folder: Folder, bench: Bench, verdict: "Verdict | None", enough: bool
) -> Folder:
    """The folder with every slide of the plan that it has not, until the operator stops.

    enough: whether the slides to learn from are left out, as the verdict may say later too.
    """
    say = bench.operator.say
    for place, (name, labels) in enumerate(slides.iterrows(), 1):
        if name in folder.manifest.index or (enough and _learned(labels)):
            continue
        say(f"[{place}/{len(slides)}] {name}: {_described(labels)}")
        try:
            slide = _slide(str(name), labels, bench)
        except _Stopped:
            break
        if slide is not None:
            folder = add_recording(folder, slide, {str(k): v for k, v in labels.items()})
            say(f"kept: {folder.root}, {len(folder)} recordings")
            enough = verdict is not None and verdict.is_enough(folder, say)
    return folder


def _is_set_up(stage: Stage, bench: Bench, by_hand: bool, approach_mm: float | None) -> bool:
    """Lifts the ball, after its height was found if that is asked for; whether the operator goes on."""
    operator = bench.operator
    if approach_mm is not None:
        if operator.ask(ABOVE, str) == "q":
            return False
        found_mm = approach(stage, bench.listener, bench.sensor, approach_mm, bench.times.timeout)
        operator.say(f"the flat skin's face is {found_mm:g} mm below the origin")
    stage.lift()
    return (not by_hand and approach_mm is None) or operator.ask(INFLATED, str) != "q"


def _learned(labels: pd.Series) -> bool:
    """Whether a slide is one to learn from."""
    return str(labels["split"]).startswith(("calibration", "train"))


def _verdict(
    until: Sequence[str], page: str | Path | None, slides: pd.DataFrame, sensor: Sensor
) -> "Verdict | None":
    if not until and page is None:
        return None
    # What calibrates a map and draws is of the train extra.
    from softslide.experiments.acquisition.error_so_far import atlas_to_calibrate
    from softslide.experiments.acquisition.verdict import Verdict

    # Before anything is recorded: where none is at hand it takes minutes.
    return Verdict(until, None if page is None else Path(page), slides, atlas_to_calibrate(sensor))


def _drive_in_the_air(stage: Stage, start: Sequence[float], end: Sequence[float]) -> None:
    stage.place(start, -CLEAR_MM)
    stage.slide(end, TRAVEL_MM_S)
    stage.finish()


def _described(labels: pd.Series) -> str:
    """A slide in words: what the stage is set to."""
    if labels["split"] == BASE_SPLIT:
        return f"lean the robot over in all directions for {_motion_s(labels):g} s, nothing touches"
    text = (
        f"from x {labels.start_x_mm:g}, y {labels.start_y_mm:g} mm, direction {labels.direction_deg:g} deg, "
        f"{labels.travel_mm:g} mm at {labels.speed_mm_s:g} mm/s"
    )
    return text if math.isnan(labels.depth_mm) else f"{text}, depth {labels.depth_mm:g} mm"


def _motion_s(labels: pd.Series) -> float:
    """How long the motion takes, s."""
    moves_s = labels.travel_mm / labels.speed_mm_s + RAMP_S
    return BASE_S if labels["split"] == BASE_SPLIT and math.isnan(moves_s) else moves_s


def _slide(name: str, labels: pd.Series, bench: Bench) -> Recording | None:
    """One slide that the operator keeps; None if it is skipped.

    Raises:
        _Stopped: the operator stops.
        InputError, CheckFailed: as `record`.
    """
    operator, times, sensor = bench.operator, bench.times, bench.sensor
    phases = Phases(times.rest, times.start, _motion_s(labels))
    of_base, failed = labels["split"] == BASE_SPLIT, 0
    begin = (
        "Let the robot begin" if of_base else "Set the stage" if bench.stage is None else "The stage is set"
    )
    while True:
        _wait(bench)
        if _answer(bench, f"{begin}. Enter records, s skips, q stops:") == "s":
            return None
        try:
            slide = _captured(name, labels, phases, bench)
        except Lost as reason:
            failed += 1
            operator.say(f"{name} is not kept: {reason}")
            if operator.absent and failed == ATTEMPTS:
                raise CheckFailed(f"{name} failed {ATTEMPTS} times: {reason}; what is kept stays") from None
            continue
        for remark in remarks(slide, sensor, phases, touched=not of_base):
            operator.say(f"  {remark}")
        answer = _answer(bench, "Keep it? Enter keeps, a records again, s skips, q stops:")
        if answer != "a":
            return None if answer == "s" else slide


def _captured(name: str, labels: pd.Series, phases: Phases, bench: Bench) -> Recording:
    """The slide, driven by the stage if there is one.

    Raises:
        Lost: as `capture`, or the output is not of the stage's motion; the ball is lifted before.
        InputError: as the methods of `Stage`, or the output left its range.
    """
    show, stage = _shower(bench.operator, phases, bench.stage is not None), bench.stage
    if stage is None:
        return capture(bench.listener, bench.sensor, name, phases, bench.times.timeout, show)
    start, end = ends(labels)
    most_v = LARGEST_TILT_G * max(each.sensitivity_v_per_g for each in bench.sensor.accelerometers)
    waiting = [True]

    def show_and_drive(recorded_s: float, level_v: float) -> None:
        show(recorded_s, level_v)
        if level_v > most_v:
            raise InputError(
                f"{name}: the output is {level_v:.2f} V off its rest, more than {most_v:.2f} V: the stage was stopped; "
                "see what it touches"
            )
        if waiting and recorded_s >= phases.rest_s:
            waiting.clear()
            stage.slide(end, labels["speed_mm_s"])

    stage.place(start, labels["depth_mm"])
    try:
        slide = capture(bench.listener, bench.sensor, name, phases, bench.times.timeout, show_and_drive)
        if reason := stray(slide, bench.sensor, phases):
            raise Lost(reason)
    except Lost:
        stage.lift()
        raise
    stage.lift()
    return slide


def _answer(bench: Bench, question: str) -> str:
    level = Level(bench.sensor.sample_rate_hz)
    answer = bench.operator.ask(question, lambda: level_bar(level.of(bench.listener.take())))
    if answer == "q":
        raise _Stopped
    return answer


def _wait(bench: Bench) -> None:
    """Returns once samples come.

    Raises:
        InputError: none came within times.wait.
    """
    listener, source, times = bench.listener, bench.source, bench.times
    begun_s, said = time.monotonic(), ""
    while listener.trouble or listener.silent_s > times.timeout:
        reason = listener.trouble or "nothing comes"
        if reason != said:
            bench.operator.say(f"waiting for {source}: {reason}")
            said = reason
        if time.monotonic() - begun_s > times.wait:
            raise InputError(
                f"{source}: nothing came for {times.wait:g} s; what is recorded is kept, run the same command to go on"
            )
        time.sleep(POLL_S)


def _shower(operator: Operator, phases: Phases, driven: bool) -> Callable[[float, float], None]:
    """Says to the operator what to do as a recording goes on, with the level. driven: a stage does it."""
    ends = (
        (phases.rest_s, "rest: hands off"),
        (phases.rest_s + phases.start_s, "the stage goes" if driven else "go: start the stage now"),
        (phases.whole_s - phases.rest_s, "motion"),
        (math.inf, "rest: hands off until the end"),
    )
    said: list[str] = []

    def show(recorded_s: float, level_v: float) -> None:
        end, phase = next((end, phase) for end, phase in ends if recorded_s < end)
        if phase not in said:
            said.append(phase)
            operator.say(f"  {phase}")
        left_s = min(end, phases.whole_s) - recorded_s
        operator.show(f"  {level_bar(level_v)}  {max(left_s, 0.0):4.0f} s")

    return show


def read_plan(path: Path, sensor: Sensor) -> pd.DataFrame:
    """The slides by name, with `split` and the manifest's labels as columns; those not given are NaN.

    Slides without a name are called p01, p02, ...; without a split they are `calibration`. Rows of the split `base`, of
    a robot that moves, need no label.

    Raises:
        InputError: no such file, no rows, a label that a stage needs is missing, a cell is wrong, or a row is of a base
            that the sensor has not.
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
    for column in NEEDED:
        if (empty := plan[column].isna() & ~of_base).any():
            row = int(empty.to_numpy().argmax())
            raise InputError(
                f"{path}: row {row + 1} ({plan.index[row]}), {column} is empty; a stage needs it, write it"
            )
    return plan[["split", *LABELS]]
