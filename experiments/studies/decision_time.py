"""Cost of a bundle's runtime, with one thread: time of a decision, start-up, memory, size.

Prints times of a decision (20 ms of samples in, an estimate out) in us, mean, median and 99th percentile, at rest, in
the slides of recordings, and of the graph alone; p99_ratio is the percentile over the median. Other work slows some of
the calls: a decision's time is the least of three passes over the same samples, in alternation with a call of a graph
of one node; ratio is the mean over that call's median. Then s to the first estimate; MB above numpy with ONNX Runtime
as they are imported, and above these once a graph of one node has run; and the bundle's kB. Needs the base install
alone where the recordings are CSV.

    python -m softslide.experiments.studies.decision_time --model my-model --slides slide.csv --json device.json
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle, islice
from pathlib import Path
from timeit import timeit

import numpy as np

from softslide.experiments.studies.script import Part, bundle, count, parser, run
from softslide.features.errors import InputError
from softslide.features.stream.tracker import SlideState
from softslide.serve.bundle import open_bundle, open_session
from softslide.serve.files import read_recording
from softslide.serve.localizer import DRIFT_BLOCKS, Localizer

PASSES = 3
# A graph of one Identity over one float32 (opset 18), serialized, so that only ONNX Runtime is needed: its call is the
# unit in which times are compared between computers.
ONE_NODE = (
    b'\x08\x08:7\n\x10\n\x01x\x12\x01y"\x08Identity\x12\x01oZ\x0f\n\x01x\x12\n\n\x08\x08\x01\x12\x04\n\x02\x08\x01'
    b"b\x0f\n\x01y\x12\n\n\x08\x08\x01\x12\x04\n\x02\x08\x01B\x04\n\x00\x10\x12"
)
START = """
import json, os, sys, time
from pathlib import Path
begun = time.perf_counter()
import numpy, onnxruntime
resident = lambda: int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
bare = resident()
# What ONNX Runtime itself takes once it runs any graph.
onnxruntime.InferenceSession(bytes.fromhex(sys.argv[2])).run(None, {"x": numpy.zeros(1, "f4")})
running = resident()
from softslide.serve.localizer import Localizer
localizer = Localizer.load(Path(sys.argv[1]))
localizer.push(numpy.zeros((localizer.card.samples_per_block, len(localizer.card.columns))))
took_s = time.perf_counter() - begun
above = {"memory_above_libraries_mb": resident() - bare, "memory_above_running_mb": resident() - running}
print(json.dumps({"first_estimate_s": took_s, **above}))
"""


def costs(bundle: Path, slides: Sequence[Path], decisions: int) -> Iterator[Part]:
    """The figures of one bundle; of one that reads a base, without it. slides: recordings of its sensor. decisions:
    that are timed at rest.

    Raises:
        InputError: the bundle does not work, a recording is not of its sensor, or no slide is found in any.
    """
    card, graph = open_bundle(bundle)
    localizer = Localizer(replace(card, base=None), graph)
    session = open_session(ONE_NODE, Path("one node"))
    bare = partial(session.run, None, {"x": np.zeros(1, np.float32)})
    volts = [read_recording(path, card.channels, card.sample_rate_hz) for path in slides]
    in_slides = _in_slides(localizer, bare, volts)
    yield "decision_at_rest", _us(*_at_rest(localizer, bare, decisions))
    yield "decision_in_a_slide", _us(in_slides[0], in_slides[2])
    yield "inference_alone", _us(in_slides[1], in_slides[2])
    words = [sys.executable, "-c", START, str(bundle.resolve()), ONE_NODE.hex()]
    root, env = Path(__file__).parents[2], os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(words, cwd=root, env=env, capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"{bundle}: does not start ({done.stderr.strip().splitlines()[-1]})")
    yield from json.loads(done.stdout).items()
    yield "bundle_kb", sum(path.stat().st_size for path in bundle.iterdir()) / 1e3


def _at_rest(localizer: Localizer, bare: Callable[[], object], decisions: int) -> np.ndarray:
    """Seconds (2, decisions) of a block at rest, long after the start, and of the one-node call."""
    zero = np.repeat([each["zero_g_v"] for each in localizer.card.sensor["accelerometers"]], 3)
    noise = np.random.default_rng(0).normal(
        0.0, 0.005, (DRIFT_BLOCKS, localizer.card.samples_per_block, len(zero))
    )
    localizer.reset()
    for _ in range(2 * localizer.card.conditioning.rest_blocks // DRIFT_BLOCKS):
        localizer.push((zero + noise).reshape(-1, len(zero)))

    def once() -> list[list[float]]:
        blocks = islice(cycle(zero + noise), decisions)
        return [[timeit(call, number=1) for call in (partial(localizer.push, b), bare)] for b in blocks]

    return np.min([once() for _ in range(PASSES)], axis=0).T


def _in_slides(localizer: Localizer, bare: Callable[[], object], recordings: list[np.ndarray]) -> np.ndarray:
    """Seconds (3, decisions) of a block in a slide, of its graph alone, and of the one-node call."""
    size = localizer.card.samples_per_block

    def once() -> Iterator[list[float]]:
        for volts in recordings:
            localizer.reset()
            for block in np.split(volts, range(size, len(volts), size)):
                pushed = timeit(partial(localizer.push, block), number=1)
                window = localizer.window()
                if window is not None and localizer.state is SlideState.SLIDE:
                    inferred = timeit(partial(localizer.infer, localizer.inputs(window)), number=1)
                    yield [pushed, inferred, timeit(bare, number=1)]

    times = np.min([list(once()) for _ in range(PASSES)], axis=0).T
    if not times.size:
        raise InputError("no slide is found in the recordings; name others", "slides")
    return times


def _us(seconds: np.ndarray, bare: np.ndarray) -> dict[str, float]:
    mean, (median, tail) = seconds.mean(), np.quantile(seconds, [0.5, 0.99])
    figures = (1e6 * mean, 1e6 * median, 1e6 * tail, tail / median, mean / np.median(bare))
    return dict(zip(("mean_us", "median_us", "p99_us", "p99_ratio", "ratio"), figures, strict=True))


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("decision_time", __doc__)
    bundle(words)
    words.add_argument(
        "--slides", type=Path, nargs="+", required=True, metavar="FILE", help="recordings, CSV or Parquet"
    )
    count(words, "--decisions", 6 * DRIFT_BLOCKS, "that are timed at rest")
    return run(words, lambda given: costs(given.model, given.slides, given.decisions), argv)


if __name__ == "__main__":
    sys.exit(main())
