"""Subcommands that compare and measure: article, compare, few, drift, false-alarms, sensitivity, bench."""

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from commands import arguments
from commands.arguments import Parser, Run
from features.errors import InputError


def article(parser: Parser) -> Run:
    """the article's figures and claims on a folder of recordings

    Makes the figures of Trinh et al. (Sensors 2019, 19, 2036) again, 6, 9 to 11
    and 14 to 26, from the slides along x and y and from the atlas, each next to
    what the article says; holds its claims against them; and fits its method
    as published and at its best. Errors are in deg, % and mm, of slides that
    were not fitted. Writes article.html, and the numbers as CSV: claims.csv,
    variants.csv, figure-NN.csv. Prints the claims. Pressures and a laser's
    readings of the skin's height (skin_height_mm) are shown where the folder
    has them; the page names what is missing.

        softslide article --recordings my-recordings --out article
        softslide synthesize --protocol article --out protocol
        softslide article --recordings protocol --out article-protocol
    """
    arguments.recordings(parser, "slides along x and y, with their labels")
    arguments.atlas(parser, "from 'simulate' (default: the shipped one for its design, else solved coarsely)")
    arguments.out(parser, "where the page and its tables go")

    def run(given: argparse.Namespace) -> None:
        from experiments.article.article import article

        made = article(given.recordings, given.atlas, given.out)
        print("\n".join(made.lines()))
        print(made.page)

    return run


def compare(parser: Parser) -> Run:
    """models side by side, fitted and scored on the same slides

    Fits the article's interpolation, trees, a small network and a Gaussian
    process on features, the default model and the inverted response map to
    the same calibration slides and scores all on the same test slides:
    errors in degrees (deg), percent (%) and mm, time of a window in ms, and
    each model's differences from the default (or the first named) on the
    same slides, with 95 % confidence intervals over lines. Writes
    comparison.html, comparison.csv and paired.csv; the bundles are kept in
    DIR, below a folder for each folder of recordings.

        softslide compare --recordings bench-a bench-d --out comparison
        softslide compare --recordings lab --models my-model other-model --out which
    """
    arguments.recordings(parser, "folders, one sensor each", nargs="+")
    arguments.out(parser, "where everything goes")
    parser.add_argument(
        "--models",
        nargs="+",
        metavar="NAME",
        help="some of interpolation, trees, mlp, gp, cnn, inversion, or folders of bundles, which are read "
        "out as they are (default: all that have a name)",
    )
    arguments.jobs(parser, 1, "recordings that a bundle reads at a time")

    def run(given: argparse.Namespace) -> None:
        from experiments.comparison.compare import MODELS, compare

        compare(given.recordings, given.out, given.models or MODELS, given.jobs)
        print(given.out / "comparison.html")

    return run


def few(parser: Parser) -> Run:
    """how few calibration recordings will do

    Calibrates the response map with so many of the calibration slides, drawn
    at random, and inverts it by least squares on every test slide; no network
    is trained. Prints one JSON object a draw: mean and largest errors at the
    end of the stroke in degrees (deg), percent (%) and mm. Logged in MLflow.

        softslide few --recordings my-recordings --slides 4 12
        softslide few --recordings my-recordings --plan plan.csv
    """
    arguments.recordings(parser, "a folder of one sensor")
    parser.add_argument(
        "--slides",
        type=int,
        nargs="+",
        default=[0, 4, 12, 24, 48],
        metavar="N",
        help="how many calibration slides (default: %(default)s)",
    )
    parser.add_argument(
        "--draws", type=int, default=3, metavar="N", help="random draws of each (default: %(default)s)"
    )
    arguments.existing(
        parser, "--plan", "plan.csv", "from 'plan --candidates': take its recordings instead of random draws"
    )
    parser.add_argument(
        "--split",
        nargs="+",
        default=["test"],
        metavar="NAME",
        help="beginnings of the names of the splits to score (default: %(default)s)",
    )

    def run(given: argparse.Namespace) -> None:
        from experiments.studies.few_recordings import few

        for row in few(given.recordings, given.slides, given.draws, given.split, given.plan):
            print(json.dumps(row), flush=True)

    return run


def drift(parser: Parser) -> Run:
    """how much a sensor's drift costs a bundle

    Reads the test splits as they are and with a drift added by calculation:
    zero shifted by 50 mV, gain up by 5 %, gravity tilted by 5 deg, 5 % of the
    samples lost. Prints one JSON object: for each its mean errors at the end
    of the recording in degrees (deg), percent (%) and mm. Logged in MLflow.

        softslide drift --model my-model --recordings my-recordings
    """
    arguments.model(parser)
    arguments.recordings(parser, "its test splits are used")
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="every Nth recording only (default: %(default)s)"
    )

    def run(given: argparse.Namespace) -> None:
        from experiments.studies.sensor_drift import drift

        print(json.dumps(drift(given.model, given.recordings, given.every), indent=1))

    return run


def false_alarms(parser: Parser) -> Run:
    """how often a bundle takes for a contact what is none

    Reads synthetic streams of a sensor that nothing touches, of 13 kinds: at
    rest; the device tilted, rocked and swayed; its pressure changed; waves,
    bumps, chirps, random walks, drifts, steps and taps of 5 to 300 mV. V_z
    stays in every second stream of the latter. Prints one JSON object: for
    each kind the time (s) for which something seemed to slide, the share of
    it (%) with a valid estimate, and how many streams have one. A second of
    signal takes about 50 ms. Logged in MLflow.

        softslide false-alarms --model my-model --recordings my-recordings
    """
    arguments.model(parser)
    arguments.recordings(parser, "of the bundle's sensor: its static output is used")
    parser.add_argument(
        "--streams", type=int, default=12, metavar="N", help="streams of each kind (default: %(default)s)"
    )
    parser.add_argument(
        "--seconds", type=float, default=25.0, metavar="S", help="of each signal (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of all that is random (default: %(default)s)"
    )
    arguments.jobs(parser, 1, "streams that are read at a time")

    def run(given: argparse.Namespace) -> None:
        from experiments.studies.false_alarms import false_alarms

        figures = false_alarms(
            given.model, given.recordings, given.streams, given.seconds, given.seed, given.jobs
        )
        print(json.dumps({kind: _rounded(found, 3) for kind, found in figures.items()}, indent=1))

    return run


def sensitivity(parser: Parser) -> Run:
    """what each assumption about the skin moves

    Changes one number of a design at a time (friction, height, depth, skin,
    chamber, board, moduli, bond to the base, prestretch, ball or edge, mesh),
    solves a line along x forth and back, 10 mm beside the first accelerometer,
    and prints one JSON object each: distance of V_x's extremes, width and
    hysteresis in mm, static tilt in deg, largest V_x in mg, largest normal
    force in mN. Minutes on one core. Logged in MLflow.

        softslide sensitivity --picture sensitivity.svg
    """
    arguments.sensor(parser, "the design (default: the article's sensor)")
    parser.add_argument(
        "--picture", type=Path, metavar="sensitivity.svg", help="draw it too: .svg, .png or .pdf"
    )

    def run(given: argparse.Namespace) -> None:
        from experiments.studies.skin_sensitivity import sensitivity

        if given.picture and given.picture.suffix not in (".svg", ".png", ".pdf"):
            raise InputError(f"{given.picture}: name a .svg, .png or .pdf", "picture")
        for row in sensitivity(given.sensor, given.picture):
            print(json.dumps(_rounded(row, 4)), flush=True)

    return run


def bench(parser: Parser) -> Run:
    """the benchmark suite

    Without a bundle, the skin: the solver against FElupe, a slide, two
    workers, the synthetic signal (positions a core-second, times real time;
    minutes), and the features of a window beside those of other packages
    (core-ms; their environment is built in the user's cache folder). With a
    bundle, the device's runtime: one decision (20 ms of samples in, an
    estimate out) in us, at rest (of one and of four accelerometers) and in a
    slide, each beside a call of a one-node graph; import and first estimate in
    s; memory above numpy with ONNX Runtime in MB, all and without pages of
    code; the bundle's size in kB. One thread. The last line is one JSON
    object.

        OMP_NUM_THREADS=1 softslide bench
        softslide bench --model my-model
    """
    arguments.model(parser, required=False, help="a bundle from 'train' (default: measure the skin)")
    parser.add_argument(
        "--decisions",
        type=int,
        default=300,
        metavar="N",
        help="how often each is measured (default: %(default)s)",
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="what the live page costs instead (needs the live extra): share of a core, ms that estimates and frames "
        "are late, for the stream alone and with 0, 1 and 4 viewers, each over N estimates",
    )

    def run(given: argparse.Namespace) -> None:
        if given.model is None and given.page:
            raise InputError("measures a bundle; name one with --model", "page")
        if given.decisions < 1:
            raise InputError(f"{given.decisions}: measure at least one", "decisions")
        print(json.dumps(_measured(given)))

    return run


def _rounded(row: Mapping[str, Any], digits: int) -> dict[str, Any]:
    """A row for JSON, which has no NaN."""
    return {
        key: None if value != value else round(value, digits) if isinstance(value, float) else value
        for key, value in row.items()
    }


def _measured(given: argparse.Namespace) -> dict[str, Any]:
    """What `bench` measures: the skin, a bundle's runtime, or its live page."""
    if given.model is None:
        from experiments.bench.skin import run_all

        return run_all()
    if given.page:
        from serve.bench.page import bench_page

        return bench_page(given.model, given.decisions)
    from serve.bench.runtime import bench

    return bench(given.model, given.decisions)


COMMANDS = (article, compare, few, drift, false_alarms, sensitivity, bench)
