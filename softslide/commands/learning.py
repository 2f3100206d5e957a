"""Subcommands around models: demo, train, evaluate, export, recalibrate, article, compare."""

import json
import shlex
import sys
from pathlib import Path
from typing import Any

import softslide
from softslide.commands.arguments import Parser, Run
from softslide.features.errors import InputError


def demo(parser: Parser) -> Run:
    """the whole path on the recordings that ship with the project

    Trains the article's interpolation, trees and the CNN on a sample of
    emulated bench recordings, evaluates each against the article's bounds,
    prints the errors (deg, %, mm), and says where everything lies. Takes
    minutes on two cores.

        softslide demo --out demo
    """
    parser.out("where everything goes")

    def run(out: Path) -> None:
        print(softslide.demo(out))

    return run


def train(parser: Parser) -> Run:
    """train a model, tracked in MLflow, and export it

    Uses the splits whose names begin with calibration or train, of a sensor with a
    [base] also the split base, and no other.
    The run is kept in sqlite:///mlflow.db, or where MLFLOW_TRACKING_URI says.
    A folder without labelled recordings trains cnn from the sensor's design.
    trees, mlp and gp learn from recorded slides and from slides drawn from the
    response map that these calibrate; [training] recorded_share in FILE says
    how many are recorded. Says how many recordings were used, and why the
    others were not. The calibrated map is kept in the user's cache folder; a
    second training of the same recordings starts from it, to the same bytes.

        softslide train --recordings my-recordings --out my-model
        softslide train --recordings my-recordings --model trees --out my-trees
        softslide train --recordings my-recordings --recordings more --out my-model
        softslide train --from-run 5f0c3b8e9d5f4a0f8c1d2e3f4a5b6c7d --out again
    """
    from softslide.models import registry

    several = "what to learn from; several folders of one sensor, or the option again, are pooled"
    parser.existing("--recordings", "DIR", several, nargs="+")
    again = "train again with the settings and recordings of a run of the store (--recordings: where these are now); "
    again += "exit status 1: a file of the bundle differs from the one made then"
    parser.add_argument("--from-run", metavar="RUN", help=again)
    weight = (
        "how much a folder's slides count in the response map, once for each folder (default: 1, all alike)"
    )
    parser.add_argument("--weight", type=float, action="append", default=[], help=weight)
    parser.atlas("the design's response atlas, from 'simulate'")
    parser.existing("--init", "BUNDLE", "a bundle of the same model to start from (warm start)")
    models = f"{', '.join(registry.MODELS)} (default: %(default)s)"
    parser.add_argument("--model", default=registry.DEFAULT, metavar="NAME", help=models)
    changes = "TOML with changes to the model's defaults, or configuration.json of a run"
    parser.existing("--config", "FILE", changes)
    template = "print the configuration of --model, each key with its default, to start FILE from"
    parser.flag("--config-template", template)
    parser.flag("--design-alone", "use no recording, the design alone")
    parser.flag("--register", "register the bundle, as the next version of models:/softslide")
    parser.flag("--fresh", "calibrate the response map anew, even where one is kept")
    parser.out("where the bundle goes", metavar="BUNDLE", required=False)

    def run(
        recordings: list[Path] | None,
        from_run: str | None,
        out: Path | None,
        config_template: bool,
        **given: Any,
    ) -> int:
        if config_template:
            from softslide.experiments.configuration import configuration_template

            print(configuration_template(given["model"]), end="")
            return 0
        if not out:
            raise InputError("is needed; name where the bundle goes", "out")
        if from_run:
            found = softslide.train_from_run(from_run, out, recordings or ())
            for name, difference in found.items():
                print(f"{name}: {difference or 'the same to the byte'}")
            return int(any(found.values()))
        if not recordings:
            raise InputError("is needed, or --from-run; name a folder", "recordings")
        done = softslide.train(recordings, out, **given)
        print(f"softslide train: {done.run.place}", file=sys.stderr)
        model, folder = shlex.quote(str(done.bundle)), shlex.quote(str(recordings[0]))
        for line in (
            f"softslide evaluate --model {model} --recordings {folder} --out {model}-results",
            f"softslide predict --model {model} slide.csv",
            f"softslide serve --model {model} --source slide.csv --page 8000",
        ):
            print(f"next: {line}", file=sys.stderr)
        print(done.bundle)
        return 0

    return run


def evaluate(parser: Parser) -> Run:
    """score a bundle on a folder of recordings against the article's bounds

    Runs the exported bundle over recordings with the device's own runtime.
    Writes predictions.csv (deg, mm/s, mm), metrics.json and report.html.
    Recordings with their truth next to them (slides/NAME.truth.csv) are
    followed over time as well: errors of place, direction and speed, by split.
    Slides along calibration lines are scored apart. For a bundle with a
    response map, errors are shown relative to its Cramer-Rao bound too. The same command
    goes on where it was stopped. Exit status 1: a bound of the article is not met, or
    nothing tests it (see --allow-untested).

        softslide evaluate --model my-model --recordings my-recordings --out results
        softslide evaluate --model my-model --recordings paths \\
            --split track-line track-curve --out tracks
    """
    parser.model()
    parser.recordings("what to score on")
    splits = "splits to score, by their full names (default: all that begin with test)"
    parser.add_argument("--split", nargs="+", action="extend", metavar="NAME", help=splits)
    parser.out("where the results go")
    parser.flag("--allow-untested", "a bound that no recording tests does not count as not met")
    no_report = "draw no report.html, which takes seconds"
    parser.add_argument("--no-report", dest="report", action="store_false", help=no_report)
    parser.number("--jobs", "N", "recordings at a time", 2)
    parser.scheduler()

    def run(out: Path, report: bool, allow_untested: bool, **given: Any) -> int:
        result = softslide.evaluate(out=out, report=report, **given)
        written = "report.html" if report else "metrics.json"
        print(f"softslide evaluate: wrote {out}/{written}", file=sys.stderr)
        print("\n".join(result.lines()))
        if result.untested and not allow_untested:
            gaps = f"{result.untested} of {len(result.verdicts)} bounds are not tested, and so not met"
            print(f"softslide evaluate: {gaps}; --allow-untested lets them pass", file=sys.stderr)
        return 0 if result.met(allow_untested) else 1

    return run


def export(parser: Parser) -> Run:
    """other formats of a bundle: ORT, C99, a folder for a model hub

    ort: ONNX Runtime's own format, with the list of operators for
    a reduced build. c: model.c and model.h in C99 that need nothing but
    math.h, one function from a window to the estimate, with check.c that
    computes the card's example on the target; constants and static memory in
    kB are shown. hub: the bundle and a README.md for a model hub, which a
    licence is to be added to. Prints one JSON object.

        softslide export --model my-model --to c --out my-model-c
    """
    parser.model()
    parser.add_argument("--to", required=True, choices=("ort", "c", "hub"), help="the format")
    parser.out("the bundle to write")

    def run(out: Path, **given: Any) -> None:
        print(json.dumps(softslide.export(out=out, **given)))
        print(f"softslide export: wrote {out}", file=sys.stderr)

    return run


def recalibrate(parser: Parser) -> Run:
    """fit a bundle's gains to a few recordings, without training

    Fits the gain of each channel of the bundle's response map to labelled
    strokes or presses of another day: one is enough, and it takes seconds.
    The zero needs no fit: what a stream shows at rest is subtracted. A press
    is a recording with start_x_mm, start_y_mm, motion_start_s and
    motion_end_s, whose speed_mm_s (mm/s) is 0, or empty as direction_deg and
    travel_mm are. Uses every split but those that are for reporting, test...
    and track..., unless some are named. Prints one JSON object: the gains, and
    what is left of the recordings before and after, in the sensor's unit (V).

        softslide recalibrate --model my-model --recordings today --out my-model-today
    """
    parser.model()
    parser.recordings("a folder with a stroke or a press of the same sensor")
    splits = "beginnings of the names of the splits to use (default: all but test and track)"
    parser.add_argument("--split", nargs="+", metavar="NAME", help=splits)
    parser.out("where the new bundle goes", metavar="BUNDLE")

    def run(**given: Any) -> None:
        print(json.dumps(softslide.recalibrate(**given)))

    return run


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
    parser.recordings("slides along x and y, with their labels")
    parser.atlas("from 'simulate' (default: the shipped one for its design, else solved coarsely)")
    parser.out("where the page and its tables go")

    def run(**given: Any) -> None:
        made = softslide.article(**given)
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
    parser.recordings("folders, one sensor each", nargs="+")
    parser.out("where everything goes")
    models = "some of interpolation, trees, mlp, gp, cnn, inversion, or folders of bundles, which are read out as they "
    parser.add_argument(
        "--models", nargs="+", metavar="NAME", help=f"{models}are (default: all that have a name)"
    )
    parser.number("--jobs", "N", "recordings that a bundle reads at a time", 1)

    def run(out: Path, models: list[str] | None, **given: Any) -> None:
        named = {"models": models} if models else {}
        softslide.compare(out=out, **named, **given)
        print(out / "comparison.html")

    return run


COMMANDS = (demo, train, evaluate, export, recalibrate, article, compare)
