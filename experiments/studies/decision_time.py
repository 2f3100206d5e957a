"""Cost of a bundle's runtime, with one thread: time of a decision, start-up, memory, size.

Prints times of a decision (20 ms of samples in, an estimate out) in us, median and 99th percentile, at rest, in a slide
and of the graph alone; p99_ratio is the latter over the former. Each is measured in alternation with a call of a graph
of one node, so that a busy computer slows both alike; ratio is the median over that call's. Then s to the first
estimate; MB above numpy with ONNX Runtime as they are imported, and above these once a graph of one node has run; and
the bundle's kB. Needs the base install alone.

    python -m softslide.experiments.studies.decision_time --model my-model --json device.json
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle
from pathlib import Path
from timeit import timeit

import numpy as np

from softslide.experiments.one_node import ONE_NODE, one_node
from softslide.experiments.studies.script import Part, bundle, count, parser, run
from softslide.features.errors import InputError
from softslide.features.stream.tracker import SlideState
from softslide.serve.bundle import open_bundle
from softslide.serve.localizer import Localizer

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


def costs(bundle: Path, decisions: int) -> Iterator[Part]:
    """The figures of one bundle; of one that reads a base, without it. Raises InputError where it does not work."""
    card, graph = open_bundle(bundle)
    localizer, bare = Localizer(replace(card, base=None), graph), one_node()
    at_rest, in_slides = _at_rest(localizer, bare, decisions), _in_slides(localizer, bare, decisions)
    yield "decision_at_rest", _us(*at_rest)
    yield "decision_in_a_slide", _us(in_slides[0], in_slides[2])
    yield "inference_alone", _us(in_slides[1], in_slides[2])
    words, one_thread = (
        [sys.executable, "-c", START, str(bundle.resolve()), ONE_NODE.hex()],
        {"OMP_NUM_THREADS": "1"},
    )
    root, env = Path(__file__).parents[2], os.environ | one_thread
    done = subprocess.run(words, cwd=root, env=env, capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"{bundle}: does not start ({done.stderr.strip().splitlines()[-1]})")
    yield from json.loads(done.stdout).items()
    yield "bundle_kb", sum(path.stat().st_size for path in bundle.iterdir()) / 1e3


def _at_rest(localizer: Localizer, bare: Callable[[], object], decisions: int) -> np.ndarray:
    """Seconds (2, decisions) of a block at rest, long after the start, and of the one-node call."""
    rest = cycle(_blocks(localizer)[0])
    for _ in range(2 * localizer.card.conditioning.rest_blocks):
        localizer.push(next(rest))
    calls = ((partial(localizer.push, next(rest)), bare) for _ in range(decisions))
    return np.array([[timeit(call, number=1) for call in both] for both in calls]).T


def _in_slides(localizer: Localizer, bare: Callable[[], object], decisions: int) -> np.ndarray:
    """Seconds (3, decisions) of a block in a slide, of its graph alone, and of the one-node call."""
    times: list[list[float]] = []
    rest, slide = _blocks(localizer)
    while len(times) < decisions:
        localizer.reset()
        localizer.push(np.concatenate(rest))
        for block in slide:
            pushed = timeit(partial(localizer.push, block), number=1)
            window = localizer.window()
            if window is not None and localizer.state is SlideState.SLIDE:
                inferred = timeit(partial(localizer.infer, localizer.inputs(window)), number=1)
                times.append([pushed, inferred, timeit(bare, number=1)])
        if not times:
            raise InputError("the card's conditioning finds no slide in a pass of 0.15 V; train it again")
    return np.array(times[:decisions]).T


def _blocks(localizer: Localizer) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """A second of rest and three of a pass over every accelerometer, in blocks of the card's size (S, C) V."""
    size, random = localizer.card.samples_per_block, np.random.default_rng(0)
    zero = np.repeat([each["zero_g_v"] for each in localizer.card.sensor["accelerometers"]], 3)
    s = np.linspace(0.0, 1.0, 150 * size)[:, None]
    pulse = 0.15 * np.sin(np.pi * s) ** 2
    signal = np.vstack(
        [np.zeros((50 * size, 3)), np.hstack([-pulse * np.cos(np.pi * s), pulse, 0.1 * pulse])]
    )
    volts = zero + np.tile(signal, len(zero) // 3) + random.normal(0.0, 0.005, (len(signal), len(zero)))
    return np.split(volts[: 50 * size], 50), np.split(volts[50 * size :], 150)


def _us(seconds: np.ndarray, bare: np.ndarray) -> dict[str, float]:
    median, tail = np.quantile(seconds, [0.5, 0.99])
    figures = (1e6 * median, 1e6 * tail, tail / median, median / np.median(bare))
    return dict(zip(("median_us", "p99_us", "p99_ratio", "ratio"), figures, strict=True))


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("decision_time", __doc__)
    bundle(words)
    count(words, "--decisions", 300)
    return run(words, lambda given: costs(given.model, given.decisions), argv)


if __name__ == "__main__":
    sys.exit(main())
