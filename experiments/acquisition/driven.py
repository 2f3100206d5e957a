"""One recording that a stage drives: the ball goes along waypoints while samples come in."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from softslide.experiments.acquisition.capture import Listener, Lost, Phases, capture, stray
from softslide.experiments.acquisition.gcode import CLEAR_MM, TRAVEL_MM_S
from softslide.experiments.acquisition.stage import Stage
from softslide.experiments.acquisition.waypoints import speeds_mm_s
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Recording

# A skin is never tilted so far, by 49 degrees: a stage is stopped there.
LARGEST_TILT_G = 0.75
# That a stretch of a plan may take longer: Marlin waits up to 0.1 s before it begins, and lines take their time.
LONGER_S = 0.3


def driven(
    name: str,
    waypoints: np.ndarray,
    phases: Phases,
    stage: Stage,
    listener: Listener,
    show: Callable[[float, float], None],
) -> tuple[Recording, np.ndarray]:
    """The recording, and moments (m, 2) s of the waypoints' time and of the recording's; the ball is lifted after it.

    waypoints: (n, 4), as in waypoints.py. show: as of `capture`.

    Raises:
        Lost: as `capture`, or the output is not of the stage's motion, or this takes longer than planned.
        InputError: as the methods of `Stage`, or the output left its range: the stage was stopped.
    """
    most_v = LARGEST_TILT_G * max(each.sensitivity_v_per_g for each in listener.sensor.accelerometers)
    motion = list[Future[tuple[np.ndarray, float]]]()

    def show_and_drive(recorded_s: float, level_v: float) -> None:
        show(recorded_s, level_v)
        if level_v > most_v:
            raise InputError(
                f"{name}: the output is {level_v:.2f} V off its rest, more than {most_v:.2f} V: the stage was stopped; "
                "see what it touches"
            )
        if not motion and recorded_s >= phases.rest_s:
            motion.append(driver.submit(stage.follow, waypoints))
        if motion and motion[0].done():
            motion[0].result()

    stage.place(waypoints[0, 1:3].tolist(), waypoints[0, 3])
    try:
        with ThreadPoolExecutor(1) as driver:
            try:
                slide, clock = capture(listener, name, phases, show_and_drive)
            except Lost:
                raise
            except BaseException:
                stage.stop()
                raise
        moments_s, longer_s = motion[0].result()
        moments_s[:, 1] = np.polyval(clock, moments_s[:, 1])
        if longer_s > LONGER_S or moments_s[-1, 1] > slide.time_s[-1]:
            raise Lost(
                f"the stage took {longer_s:.1f} s longer than planned; see its limits of speed and acceleration"
            )
        if reason := stray(slide, listener.sensor, phases):
            raise Lost(reason)
    except Lost:
        stage.lift()
        raise
    stage.lift()
    return slide, moments_s


def drive_in_the_air(stage: Stage, waypoints: np.ndarray) -> None:
    """Carries the ball along the waypoints, fast, above the skin."""
    above = waypoints.copy()
    above[:, 0] *= speeds_mm_s(waypoints).max() / TRAVEL_MM_S
    above[:, 3] = -CLEAR_MM
    stage.place(above[0, 1:3].tolist(), -CLEAR_MM)
    stage.follow(above)
    stage.finish()
