"""Benchmarks of making data: the skin's solver beside FElupe, workers, memory, synthetic signal, features.

Every benchmark runs on one thread and returns its figures by name; `BENCHMARKS` lists them. The environment is to say
OMP_NUM_THREADS=1 before Python starts, so that no library takes more.
"""

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from experiments.bench.felupe_path import felupe_path
from pipeline.atlas.atlas import DEFAULT_SENSOR
from pipeline.sensor import MeshSize, Sensor, read_sensor
from pipeline.skin.lines import Line
from pipeline.skin.solved_line import skin_of, solve_line

# A line over the dome in steps of 1.25 mm, and its depth.
ALONG_MM = np.arange(-30.0, 30.1, 1.25)
DEPTH_MM = 0.6
SLIDING_MPA = 1e-3
WORKER_LINES = 6
# Positions of the line beside FElupe: before the first it is not counted, from the second on FElupe has SciPy's solver.
COUNTED = (6, 9, 12)
# FElupe takes seconds, which average over a machine's load; the solver tenths, of which the median is taken.
OWN_RUNS = 7
SLIDES = 120
WINDOWS, SAMPLES = 256, 2048


def solver_against_felupe() -> dict[str, float]:
    """The indenter slides onto the inflated skin of the article's sensor, and up to the board.

    Mesh, path, steps, traction, friction and tolerance are the same. FElupe uses this project's compiled contact
    (see `experiments.bench.felupe_path`) and its board is a stiff solid. The first positions are not counted: the
    skin is not touched there, and compilers and orderings do their work.
    """
    if not (find_spec("felupe") and find_spec("pypardiso")):
        print("FElupe or pypardiso is missing (pip install softslide[test]): not compared", file=sys.stderr)
        return {}
    from pypardiso import spsolve as mkl
    from scipy.sparse.linalg import spsolve as superlu

    sensor = read_sensor(DEFAULT_SENSOR)
    skin = skin_of(sensor)
    inflated = skin.inflate(SLIDING_MPA)
    first, middle, last = COUNTED
    centres = np.zeros((last, 3))
    centres[:, 0], centres[:, 1] = ALONG_MM[:last], 2.5
    centres[:, 2] = sensor.skin_thickness_mm + sensor.indenter_diameter_mm / 2 - DEPTH_MM
    times = np.empty((OWN_RUNS, len(COUNTED)))
    for own_run in times:
        for n, count in enumerate(COUNTED):
            began = time.process_time()
            skin.slide(inflated, SLIDING_MPA, centres[:count])
            own_run[n] = time.process_time() - began
    own = np.median(times, axis=0)
    marks = []
    solvers = [mkl] * middle + [superlu] * (last - middle)
    for _ in felupe_path(skin.mesh, skin.material, SLIDING_MPA, centres, mkl, solvers):
        marks.append(time.process_time())
    # The first mark is the inflated skin's.
    felupe = np.array(marks)[list(COUNTED)]
    a_second = np.diff(COUNTED) / np.diff([own, felupe])
    return {
        "positions_per_core_s_on_the_way_up": float((last - first) / (own[-1] - own[0])),
        "positions_per_core_s_felupe_pypardiso": float(a_second[1, 0]),
        "positions_per_core_s_felupe_scipy": float(a_second[1, 1]),
        "times_felupe_pypardiso": float(a_second[0, 0] / a_second[1, 0]),
        "times_felupe_scipy": float(a_second[0, 1] / a_second[1, 1]),
    }


def sliding() -> dict[str, float]:
    """Positions a core-second of one line of the article's sensor at 1 kPa, with contact and friction."""
    sensor = read_sensor(DEFAULT_SENSOR)
    inflated = skin_of(sensor).inflate(SLIDING_MPA)
    began = time.process_time()
    values, _ = solve_line(sensor, Line(0, 1, 2.5), ALONG_MM, DEPTH_MM, SLIDING_MPA, inflated)
    assert np.isfinite(values).all()
    return {"positions_per_core_s": len(ALONG_MM) / (time.process_time() - began)}


def two_workers() -> dict[str, float]:
    """Two processes against one, and a worker's memory.

    The efficiency is lines a second over twice those of one process, which a busy machine spoils; the share is
    core-seconds a line of one process over those of each of two: what they take from each other even there.
    """
    from joblib import Parallel, delayed

    sensor = read_sensor(DEFAULT_SENSOR)
    seconds, core_seconds = {}, {}
    for workers in (1, 2):
        with Parallel(n_jobs=workers, backend="loky", batch_size=1) as pool:
            # Each process imports, compiles and analyses before the clock starts.
            peaks = pool(delayed(_peak_mb)(sensor) for _ in range(2 * workers))
            began = time.perf_counter()
            core_seconds[workers] = sum(pool(delayed(_coarse_line)(sensor) for _ in range(WORKER_LINES)))
            seconds[workers] = time.perf_counter() - began
    return {
        "two_workers_efficiency": seconds[1] / (2 * seconds[2]),
        "two_workers_core_share": core_seconds[1] / core_seconds[2],
        "worker_resident_mb": max(peaks),
    }


def synthetic_signal() -> dict[str, float]:
    """Seconds of 1 kHz three-axis signal a core-second, with every effect of the default distribution."""
    # Imported here: workers, whose memory is measured, do not need it.
    from pipeline.synthesis.synthesize import synthetic_slides

    list(synthetic_slides(2, 0))
    began = time.process_time()
    made = sum(recording.time_s[-1] for _, recording in synthetic_slides(SLIDES, 1))
    return {"synthetic_times_real_time": float(made / (time.process_time() - began))}


def features_of_a_window() -> dict[str, float]:
    """Core-milliseconds a window of 3 x 2048 samples: averaged over the runtime's bins, then the feature vector.

    In batches; and, for what a batch and the bins save, the features of all samples, and of one window at a time.
    Beside them those of other packages, of all samples.
    """
    from experiments.bench.feature_peers import peers_ms
    from features.vector.feature_vector import feature_matrix
    from features.window import WINDOW_BINS

    s = np.linspace(0.0, 1.0, SAMPLES)
    pulse = 0.15 * np.sin(np.pi * s) ** 2
    slide = np.stack([-pulse * np.cos(np.pi * s), pulse, 0.1 * pulse])
    samples = slide + np.random.default_rng(0).normal(0.0, 1e-3, (WINDOWS, *slide.shape))
    elapsed_s = np.full(WINDOWS, 5.0)

    def binned(volts: np.ndarray) -> np.ndarray:
        return volts.reshape(*volts.shape[:2], WINDOW_BINS, -1).mean(axis=-1)

    def one_by_one() -> None:
        for volts in samples:
            feature_matrix(binned(volts[None]), elapsed_s[:1])

    return {
        "features_ms": _core_ms_a_window(lambda: feature_matrix(binned(samples), elapsed_s)),
        "features_of_all_samples_ms": _core_ms_a_window(lambda: feature_matrix(samples, elapsed_s)),
        "features_one_window_at_a_time_ms": _core_ms_a_window(one_by_one),
        **{f"features_{name}_ms": value for name, value in peers_ms(samples).items()},
    }


BENCHMARKS: dict[str, Callable[[], dict[str, float]]] = {
    "solver against FElupe": solver_against_felupe,
    "sliding": sliding,
    "two workers": two_workers,
    "synthetic signal": synthetic_signal,
    "features": features_of_a_window,
}


def _core_ms_a_window(call: Callable[[], object]) -> float:
    """Median over OWN_RUNS, after one that is not counted."""
    times = []
    for _ in range(OWN_RUNS + 1):
        began = time.process_time()
        call()
        times.append(time.process_time() - began)
    return 1e3 * float(np.median(times[1:])) / WINDOWS


def _coarse_line(sensor: Sensor) -> float:
    """Core-seconds of a line on a coarse mesh."""
    began = time.process_time()
    coarse = replace(sensor, mesh=MeshSize(5.0))
    skin = skin_of(coarse)
    solve_line(coarse, Line(0, 1, 5.0), ALONG_MM, DEPTH_MM, SLIDING_MPA, skin.inflate(SLIDING_MPA))
    return time.process_time() - began


def _peak_mb(sensor: Sensor) -> float:
    """The worker's largest resident memory after it has solved on the article's mesh, and then on a coarse one."""
    inflated = skin_of(sensor).inflate(SLIDING_MPA)
    solve_line(sensor, Line(0, 1, 2.5), ALONG_MM[:12], DEPTH_MM, SLIDING_MPA, inflated)
    _coarse_line(sensor)
    status = Path("/proc/self/status")
    if status.exists():
        # From /proc: a worker inherits the peak of `getrusage` from the process it was forked from.
        return int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run_all() -> dict[str, float]:
    """Every benchmark's figures, to four digits; says on standard error which one runs."""
    figures: dict[str, float] = {}
    for name, benchmark in BENCHMARKS.items():
        print(f"softslide bench: {name}", file=sys.stderr)
        figures |= benchmark()
    return {key: float(f"{value:.4g}") for key, value in figures.items()}
