"""A simulated recording session: plan, record by a printer, check, train, evaluate, on a simulated skin.

OctoPrint's virtual printer takes the G-code; the ball goes where it says, over a simulated skin that streams over UDP
with noise, lag and a clock of its own. The same sensor is then recorded with labels made by hand, and scored alike.

    make lab
    python -m softslide.experiments.studies.lab --printer env/bin/python --out lab --fault corner
"""

import argparse
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import softslide
from softslide.experiments.demo import shortened
from softslide.experiments.evaluation.scoring import QUANTITIES
from softslide.experiments.studies.script import Part, count, parser, run
from softslide.features.errors import CheckFailed, InputError
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, read_atlas
from softslide.pipeline.sensor import Sensor, read_sensor, write_sensor
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.motion import Stroke
from softslide.pipeline.synthesis.paths.contact_path import ContactPath
from softslide.pipeline.synthesis.slide_plan import Slide
from softslide.pipeline.synthesis.specimen import draw_specimen
from softslide.pipeline.synthesis.synthesize import record

HERE = Path(__file__).parent
ORIGIN_MM = (110.0, 95.0, 31.5)
HEIGHT_MM, RAMP_S = 7.0, 0.05
SPEEDS_MM_S = (2.0, 4.0, 8.0)
# What is wrong, as options of skin.py, and errors of the printer.
FAULTS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "none": ((), ()),
    "resend": ((), ("20:checksum_mismatch", "31:resend", "44:linenumber_mismatch")),
    "corner": (("--wrong", "0.4", "-0.3", "2"), ()),
    "lost-step": (("--lost", "1"), ()),
    "stalled": (("--stalled",), ()),
    "drift": (("--drift", "0.01"), ()),
}


def lab(given: argparse.Namespace) -> Iterator[Part]:
    """Minutes of each part; errors at the end of the slides kept apart, with the printer's labels and with others."""
    out, seed = given.out, given.seed
    out.mkdir(parents=True, exist_ok=True)
    sensor = out / "sensor.toml"
    write_sensor(sensor, replace(read_sensor(DEFAULT_SENSOR), origin="synthetic"))
    begun_s = time.monotonic()
    planned = softslide.plan(
        sensor,
        given.slides,
        speeds_mm_s=SPEEDS_MM_S,
        tests=given.tests,
        paths=given.paths,
        out=out / "plan.csv",
    )
    plan = pd.read_csv(out / "plan.csv")
    yield "plan", {"slides": len(plan), "minutes": (time.monotonic() - begun_s) / 60}
    begun_s = time.monotonic()
    with simulated(given) as (source, stage):
        softslide.record(
            *(source, out / "plan.csv", out / "printer"),
            sensor=sensor,
            yes=True,
            stage=stage,
            origin_mm=ORIGIN_MM,
            until=given.until,
            page=out / "progress.html",
        )
    yield "record", {"minutes": (time.monotonic() - begun_s) / 60}
    report = softslide.check(out / "printer")
    for line in report.lines():
        print(line, file=sys.stderr)
    yield "check", {"findings": len(report.findings)}
    # What a fault costs shows next to the figures without it.
    others = () if given.fault != "none" else ("by-hand",)
    if others and not (out / "by-hand").exists():
        by_hand(plan, planned.paths, read_sensor(sensor), out / "by-hand", seed)
    for name in ("printer", *others):
        begun_s = time.monotonic()
        bundle = softslide.train(out / name, out / name / "bundle", change=shortened, track=False).bundle
        splits = sorted(set(plan["split"]) - {"calibration"})
        scored = softslide.evaluate(bundle, out / name, splits, out / name / "evaluation", track=False)
        end = scored.metrics["splits"]["test"]["1.0"]
        errors = {f"{q}_{kind}": end[q].get(kind, np.nan) for q in QUANTITIES for kind in ("mean", "max")}
        valid = {"valid": end["valid_share"], "minutes": (time.monotonic() - begun_s) / 60}
        yield name, errors | valid
        for split, track in scored.metrics.get("tracks", {}).items():
            found = {"valid": track["valid_share"], "wrong": track["wrong_share"]}
            found["place_mm"] = track["position"]["median"]
            yield f"{name}, {split}", {key: np.nan if v is None else v for key, v in found.items()}
    print(f"report: {out / 'printer' / 'evaluation' / 'report.html'}", file=sys.stderr)


@contextmanager
def simulated(given: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """The skin's source and the stage's address, of a printer and a skin that run until the block ends."""
    wrong, errors = FAULTS[given.fault]
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    haste = str(given.haste)
    to_printer = [str(given.printer), str(HERE / "printer.py"), str(given.out), haste, *errors]
    to_skin = [sys.executable, "-m", f"{__package__}.skin", "--port", str(port), "--haste", haste]
    to_skin += ["--origin", *map(str, ORIGIN_MM), "--seed", str(given.seed), *wrong]
    with ExitStack() as running:
        # Unbuffered: the first line is read here, the others by the skin.
        printer = running.enter_context(subprocess.Popen(to_printer, stdout=subprocess.PIPE, bufsize=0))
        running.callback(printer.kill)
        assert printer.stdout is not None
        if not (terminal := printer.stdout.readline().decode().strip()):
            raise InputError(f"{given.printer}: has no OctoPrint; see the Makefile", "printer")
        skin = running.enter_context(subprocess.Popen(to_skin, stdin=printer.stdout))
        running.callback(skin.kill)
        yield f"udp://:{port}", f"serial://{terminal}?firmware=marlin"


def by_hand(plan: pd.DataFrame, paths: Sequence[ContactPath], sensor: Sensor, out: Path, seed: int) -> None:
    """The same slides and paths of the same specimen, synthesized with exact labels."""
    distribution, atlas = Distribution(height_mm=HEIGHT_MM), read_atlas()
    specimen, random = draw_specimen(sensor, distribution, seed), np.random.default_rng([seed, 8])
    slides = [
        Slide(
            row["direction_deg"],
            row["offset_mm"],
            (row["start_x_mm"], row["start_y_mm"]),
            Stroke(row["travel_mm"], row["speed_mm_s"], RAMP_S),
            row["depth_mm"],
            sensor.pressure_mpa,
            HEIGHT_MM,
            name=row["recording"],
            split=row["split"],
            gain=1 + distribution.repeatability * random.standard_normal(),
        )
        for row in plan[plan["travel_mm"].notna()].to_dict("records")
    ]
    contacts: list[Slide | ContactPath] = [*slides, *paths]
    manifest = pd.DataFrame([contact.labels() for contact in contacts])
    softslide.write_folder(out, sensor, manifest, (record(c, specimen, atlas, random) for c in contacts))


def main() -> int:
    """The study."""
    options = parser("lab", __doc__)
    add = options.add_argument
    add("--printer", type=Path, required=True, metavar="PYTHON", help="that has OctoPrint 1.11")
    add("--out", type=Path, default=Path("lab"), metavar="DIR", help="(default: %(default)s)")
    count(options, "--slides", 24, "to calibrate with")
    count(options, "--tests", 12, "kept apart")
    count(options, "--paths", 9, "that bend, stop, press, are put down or lifted", least=0)
    count(options, "--seed", 0, "of the skin", least=0)
    add("--haste", type=float, default=6.0, metavar="X", help="times real time (default: 6)")
    add("--until", nargs="+", default=[], metavar="ERROR", help="as of 'record'")
    add("--fault", choices=FAULTS, default="none", help="what is wrong (default: none)")
    try:
        return run(options, lab)
    except CheckFailed as error:
        print(f"{options.prog}: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
