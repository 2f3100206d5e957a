"""Cost of the runtime: time of a decision, start-up, memory, size; with one thread.

Each time is measured in alternation with a call of a graph of one node, so that a busy computer slows both alike.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from features.card import Card
from features.contact.calibration import encoded
from features.errors import InputError
from features.stream.tracker import SlideState
from serve.bundle import open_bundle, open_session
from serve.localizer import Localizer

# A graph of one Identity over one float32 (opset 18), serialized, so that only ONNX Runtime is needed.
ONE_NODE = (
    b'\x08\x08:7\n\x10\n\x01x\x12\x01y"\x08Identity\x12\x01oZ\x0f\n\x01x\x12\n\n\x08\x08\x01\x12\x04\n\x02\x08\x01'
    b"b\x0f\n\x01y\x12\n\n\x08\x08\x01\x12\x04\n\x02\x08\x01B\x04\n\x00\x10\x12"
)
_START = """
import json, sys, time
begun = time.perf_counter()
import numpy, onnxruntime
def memory():
    with open("/proc/self/statm") as file:
        _, resident, shared, *_ = map(int, file.read().split())
    return numpy.array([resident, resident - shared]) * {page} / 1e6
bare, bare_s = memory(), time.perf_counter() - begun
from pathlib import Path
from serve.localizer import Localizer
localizer = Localizer.load(Path(sys.argv[1]))
samples = localizer.card.samples_per_block
localizer.push(numpy.zeros((samples, len(localizer.card.columns))))
resident, private = (memory() - bare).round(2)
print(json.dumps({{"first_estimate_s": time.perf_counter() - begun, "libraries_s": bare_s,
                  "memory_above_libraries_mb": resident, "private_memory_above_libraries_mb": private}}))
"""


def bench(bundle: Path, decisions: int = 300) -> dict[str, Any]:
    """Figures of one bundle: times in us and as ratios to the one-node call; s, MB, kB, as the names say.

    Raises:
        InputError: the bundle cannot be opened.
    """
    card, graph = open_bundle(bundle)
    one, four, one_resting = _at_rest(
        [Localizer(_with_accelerometers(card, n), graph) for n in (1, 4)], decisions
    )
    sliding, inference, one_sliding = _in_slides(Localizer(replace(card, base=None), graph), decisions)
    return {
        "one_node": _us(np.concatenate([one_resting, one_sliding])),
        "decision_at_rest": _beside(one, one_resting),
        "decision_at_rest_of_four": _beside(four, one_resting),
        "decision_in_a_slide": _beside(sliding, one_sliding),
        "inference_alone": _beside(inference, one_sliding),
        **_start(bundle),
        "bundle_kb": sum(path.stat().st_size for path in bundle.iterdir()) / 1e3,
        "accelerometers": len(card.channels) // 3,
    }


def _with_accelerometers(card: Card, count: int) -> Card:
    """The card with `count` accelerometers like its first one and no base; at rest the graph is not run."""
    names = tuple(f"a{n}_{axis}" for n in range(count) for axis in ("vx", "vy", "vz"))
    accelerometers = [card.sensor["accelerometers"][0]] * count
    sensor, contact = {**card.sensor, "accelerometers": accelerometers}, card.contact
    if contact is not None:
        first = slice(len(card.conditioning.touch_axes))
        coefficients, scale_v = encoded(np.tile(contact.splines()[..., first], count))
        noise_v = contact.noise_v[first] * count
        inflation = contact.inflation_v_per_mm[first] * count
        contact = replace(
            contact,
            coefficients=coefficients,
            scale_v=scale_v,
            noise_v=noise_v,
            inflation_v_per_mm=inflation,
            static_v=(),
            static_covariance_v2=(),
        )
    return replace(card, channels=names, sensor=sensor, contact=contact, base=None)


def one_node() -> Callable[[], object]:
    """A call of a graph of one node, the unit of comparison."""
    return partial(open_session(ONE_NODE, Path("one node")).run, None, {"x": np.zeros(1, np.float32)})


def _at_rest(localizers: list[Localizer], decisions: int) -> np.ndarray:
    """Seconds (localizers + 1, decisions) of a block at rest, long after the start, and of the one-node call."""
    bare = one_node()
    blocks = [_blocks(localizer)[0] for localizer in localizers]
    for localizer, rest in zip(localizers, blocks, strict=True):
        for n in range(2 * localizer.card.conditioning.rest_blocks):
            localizer.push(rest[n % len(rest)])
    times = np.zeros((len(localizers) + 1, decisions))
    for n in range(decisions):
        for k, (localizer, rest) in enumerate(zip(localizers, blocks, strict=True)):
            times[k, n] = _seconds(partial(localizer.push, rest[n % len(rest)]))
        times[-1, n] = _seconds(bare)
    return times


def _in_slides(localizer: Localizer, decisions: int) -> np.ndarray:
    """Seconds (3, decisions) of a block in a slide, of its graph alone, and of the one-node call."""
    bare = one_node()
    times = np.zeros((3, decisions))
    rest, slide = _blocks(localizer)
    done = 0
    while done < decisions:
        before = done
        localizer.reset()
        for block in rest:
            localizer.push(block)
        for block in slide:
            seconds = _seconds(partial(localizer.push, block))
            window = localizer.window()
            if window is None or localizer.state is not SlideState.SLIDE or done == decisions:
                continue
            times[0, done] = seconds
            times[1, done] = _seconds(partial(localizer.infer, localizer.inputs(window)))
            times[2, done] = _seconds(bare)
            done += 1
        if done == before:
            raise InputError("the card's conditioning finds no slide in a pass of 0.15 V; train it again")
    return times


def _blocks(localizer: Localizer) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """A second of rest and three of a pass over every accelerometer, in blocks of the card's size (S, C) V."""
    card = localizer.card
    size, boards = card.samples_per_block, len(card.channels) // 3
    zero = np.repeat([board["zero_g_v"] for board in card.sensor["accelerometers"]], 3)
    generator = np.random.default_rng(0)

    def noisy(signal: np.ndarray) -> list[np.ndarray]:
        volts = zero + np.tile(signal, boards) + generator.normal(0.0, 0.005, (len(signal), 3 * boards))
        return [volts[n : n + size] for n in range(0, len(volts) - size + 1, size)]

    s = np.linspace(0.0, 1.0, 150 * size)[:, None]
    pulse = 0.15 * np.sin(np.pi * s) ** 2
    return noisy(np.zeros((50 * size, 3))), noisy(np.hstack([-pulse * np.cos(np.pi * s), pulse, 0.1 * pulse]))


def _start(bundle: Path) -> dict[str, float]:
    """In a process of its own: import and first estimate, s; memory above that of numpy and ONNX Runtime, MB.

    Private memory is without shared pages of code, most of which the first session of ONNX Runtime loads.
    """
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", _START.format(page=os.sysconf("SC_PAGE_SIZE")), str(bundle.resolve())],
        cwd=root,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise InputError(f"{bundle}: does not start ({done.stderr.strip().splitlines()[-1]})")
    return json.loads(done.stdout)


def _seconds(call: Callable[[], object]) -> float:
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def _us(seconds: np.ndarray) -> dict[str, float]:
    median, tail = np.quantile(seconds, [0.5, 0.99]) * 1e6
    return {
        "median_us": round(float(median), 2),
        "p99_us": round(float(tail), 2),
        "p99_ratio": round(float(tail / median), 2),
    }


def _beside(seconds: np.ndarray, bare: np.ndarray) -> dict[str, float]:
    """us; p99_ratio: 99th percentile over median; ratio: median over that of the one-node call."""
    return {**_us(seconds), "ratio": round(float(np.median(seconds) / np.median(bare)), 2)}
