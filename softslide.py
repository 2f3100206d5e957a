"""softslide: where is it, which way, how fast? One command, a subcommand for each job."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from features.errors import InputError


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one subcommand. Returns 0 on success, 2 on bad usage or input, 1 on a bound not met or a failure, and
    130 on Ctrl-C."""
    arguments = _parser().parse_args(argv)
    try:
        return arguments.run(arguments)
    except InputError as error:
        print(f"softslide {arguments.command}: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print(f"softslide {arguments.command}: interrupted", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="softslide", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser(
        "demo",
        help="the main job end to end on what ships with the project",
        description="Trains the article's interpolation, trees and the CNN on a sample of emulated bench recordings, "
        "evaluates each against the article's bounds, prints the table, and says where everything lies.",
    )
    demo.add_argument("--out", type=Path, required=True, metavar="DIR", help="where everything goes")
    demo.set_defaults(run=_demo)

    check = commands.add_parser(
        "check",
        help="validate a folder of recordings",
        description="Validates a folder and judges its health: clock, clipping, wiring, noise (g/sqrt(Hz)), mains, "
        "drift, labels, splits, marks of made-up data; each finding with its figure and limit. Exit status 2 on an "
        "error, 0 with warnings alone.",
    )
    check.add_argument("folder", type=Path, metavar="DIR", help="sensor.toml, manifest.csv, slides/*.parquet")
    check.add_argument("--json", action="store_true", help="the findings as one JSON object")
    check.set_defaults(run=_check)

    load = commands.add_parser(
        "import",
        help="turn a lab's files into a folder of recordings",
        description="Reads CSV, Parquet, HDF5, TDMS, MATLAB, ROS 1, ROS 2 and MCAP files as a map says (volts, g, "
        "m/s2 or counts; s, ms, us, ns or timestamps), converts them to volts on an even clock, and says which signs "
        "were flipped and why. An interrupted import resumes; bad input leaves nothing.",
    )
    load.add_argument("sources", nargs="*", type=Path, metavar="SOURCE", help="files, or folders to search")
    load.add_argument(
        "--map", type=Path, metavar="MAP.toml", help="what the files mean: columns, units, labels"
    )
    load.add_argument("--out", type=Path, metavar="DIR", help="the folder of recordings to write")
    load.add_argument(
        "--map-template",
        metavar="KIND",
        help="print a commented map to start from: csv, parquet, hdf5, tdms, mat (both kinds), ros (1, 2, MCAP)",
    )
    load.set_defaults(run=_import)

    simulate = commands.add_parser(
        "simulate",
        help="solve the skin: the response atlas of a sensor design",
        description="Slides an indenter over the inflated skin along lines in both axes and both ways, at each "
        "depth (mm) and skin height (mm) or effective pressure (MPa) of the design, and writes what every board "
        "reads. An interrupted solve resumes from the lines it finished.",
    )
    simulate.add_argument(
        "--sensor", type=Path, metavar="sensor.toml", help="the design (default: the article's sensor)"
    )
    simulate.add_argument("--out", type=Path, required=True, metavar="ATLAS", help="the .npz to write")
    simulate.add_argument(
        "--coarse", action="store_true", help="minutes instead of an hour, for a first look"
    )
    simulate.add_argument(
        "--depth", type=float, nargs="+", metavar="MM", help="contact depths in mm (default: 0.2 0.6 1.2)"
    )
    simulate.add_argument(
        "--workers", type=int, default=2, metavar="N", help="processes (default: %(default)s)"
    )
    simulate.add_argument(
        "--backend", choices=("loky", "dask"), default="loky", help="who runs them (default: %(default)s)"
    )
    simulate.set_defaults(run=_simulate)

    synthesize = commands.add_parser(
        "synthesize",
        help="write a folder of recordings from an atlas",
        description="Slides along straight lines at any angle, offset (mm), speed (mm/s), depth (mm) and pressure "
        "(MPa) over one device drawn from the seed: volts with the accelerometer's noise and bandwidth, mains, "
        "vibration, the skin's lag. Of every ten slides, five are of split calibration (along x and y), two of "
        "calibration-diagonal (any direction), two of test and one of test-diagonal, on lines that are not taught. "
        "The same seed writes the same files; synthesis.json says what they were drawn from.",
    )
    synthesize.add_argument(
        "--atlas", type=Path, metavar="ATLAS", help="from 'simulate' (default: the article's sensor's)"
    )
    synthesize.add_argument(
        "--sensor",
        type=Path,
        metavar="sensor.toml",
        help="names, places and electronics of the atlas's design (default: the article's electronics)",
    )
    synthesize.add_argument(
        "--slides", type=int, default=0, metavar="N", help="how many slides along straight lines"
    )
    synthesize.add_argument(
        "--paths",
        type=int,
        default=0,
        metavar="N",
        help="how many contacts along any path, with their truth: lines, curves, changing speed, stops, turns back, "
        "touch-downs, lifts, changing depth, presses; splits track-KIND",
    )
    synthesize.add_argument(
        "--seed", type=int, default=0, metavar="S", help="of all that is random (default: %(default)s)"
    )
    synthesize.add_argument("--out", type=Path, required=True, metavar="DIR", help="the folder to write")
    synthesize.set_defaults(run=_synthesize)

    train = commands.add_parser(
        "train",
        help="train a model, tracked in MLflow, and export it",
        description="Uses the splits whose names begin with calibration or train and no other. The run is kept in "
        "sqlite:///mlflow.db, or where MLFLOW_TRACKING_URI says.",
    )
    train.add_argument("--recordings", type=Path, required=True, metavar="DIR", help="what to learn from")
    train.add_argument(
        "--atlas", type=Path, metavar="ATLAS", help="what the sensor's design says, from 'simulate'"
    )
    train.add_argument("--init", type=Path, metavar="BUNDLE", help="a bundle of the same model to go on from")
    train.add_argument(
        "--model",
        default="cnn",
        metavar="NAME",
        help="interpolation, trees, mlp, gp or cnn (default: %(default)s)",
    )
    train.add_argument(
        "--config", type=Path, metavar="FILE", help="TOML with changes to the model's defaults"
    )
    train.add_argument("--out", type=Path, required=True, metavar="BUNDLE", help="where the bundle goes")
    train.set_defaults(run=_train)

    sweep = commands.add_parser(
        "sweep",
        help="a tracked hyperparameter search",
        description="Searches a model's settings for the least errors on calibration lines held out of the fit; test "
        "splits are never read. FILE names model, recordings, atlas (if any), a table budget (trials, seconds of one "
        "call, workers), a table settings that holds in every trial, and a table space: the settings' keys, each "
        "{ low, high, log } or a list of choices. Prints the best settings as TOML for 'train --config'. Trials are "
        "kept beside FILE, as .journal, and in MLflow; stopped at any moment, the same command goes on.",
    )
    sweep.add_argument("--config", type=Path, required=True, metavar="FILE", help="the sweep as TOML")
    sweep.set_defaults(run=_sweep)

    evaluate = commands.add_parser(
        "evaluate",
        help="score a bundle on a folder of recordings against the article's bounds",
        description="Runs the exported bundle over recordings with the device's own runtime. Writes "
        "predictions.csv, metrics.json and report.html. Exit status 1: a bound of the article is not met.",
    )
    evaluate.add_argument("--model", type=Path, required=True, metavar="BUNDLE", help="a bundle from 'train'")
    evaluate.add_argument("--recordings", type=Path, required=True, metavar="DIR", help="what to score on")
    evaluate.add_argument(
        "--split",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="splits to score, by their full names (default: all that begin with test)",
    )
    evaluate.add_argument("--out", type=Path, required=True, metavar="DIR", help="where the results go")
    evaluate.add_argument(
        "--jobs", type=int, default=2, metavar="N", help="recordings at a time (default: %(default)s)"
    )
    evaluate.set_defaults(run=_evaluate)

    predict = commands.add_parser(
        "predict",
        help="one JSON line a recording",
        description="The estimate at each recording's end as a line of JSON: angles in degrees (deg), lengths in "
        "mm, speed in mm/s, time in s; lo and hi bound a 90 %% interval; null where nothing is estimated.",
    )
    predict.add_argument("--model", type=Path, required=True, metavar="BUNDLE", help="a bundle from 'train'")
    predict.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="CSV with time_s (s) and a0_vx, a0_vy, a0_vz, ... (V), or Parquet (needs the io extra)",
    )
    predict.set_defaults(run=_predict)

    serve = commands.add_parser(
        "serve",
        help="stream estimates from a live source",
        description="Estimates of a live stream, one every 20 ms: angles in degrees (deg), lengths in mm, speed in "
        "mm/s, time in s; lo and hi bound a 90 % interval; null where nothing is estimated. Ends with the source, "
        "or on SIGINT or SIGTERM. Nothing is listened to from other machines unless HOST says so.",
    )
    serve.add_argument("--model", type=Path, required=True, metavar="BUNDLE", help="a bundle from 'train'")
    serve.add_argument(
        "--source",
        required=True,
        help="FILE.csv or FILE.parquet (needs the io extra) plays a recording; '-' reads standard input; "
        "udp://HOST:PORT; serial:///dev/PORT?BAUD (needs the live extra); ros2://TOPIC (needs rclpy)",
    )
    serve.add_argument(
        "--sink",
        action="append",
        help="'-' writes JSON lines on standard output (default); udp://HOST:PORT one JSON object a datagram; "
        "ros2://TOPIC positions in m and estimates; may be given again",
    )
    serve.add_argument(
        "--format",
        choices=("csv", "f32"),
        default="csv",
        help="of bytes from outside: csv, lines of volts (V) with a time (s) before them or none; f32, little-endian "
        "float32 frames, one number a channel (default: %(default)s)",
    )
    serve.add_argument(
        "--smooth",
        action="store_true",
        help="pass place, direction and speed through a Kalman filter: a fifth of the jitter, no further accuracy",
    )
    serve.add_argument("--fast", action="store_true", help="play a recording as fast as it goes")
    serve.add_argument(
        "--page",
        metavar="[HOST:]PORT",
        help="show the stream on a live page as well (needs the live extra); without HOST this machine alone "
        "reaches it, port 0 is any that is free; open it before a recording is played: it waits and comes back",
    )
    serve.set_defaults(run=_serve)

    export = commands.add_parser(
        "export",
        help="other shapes of a bundle",
        description="int8: weights of convolutions and dense layers in 8 bits, refused where it costs accuracy; the "
        "errors of both, in degrees (deg), percent (%) and mm, are shown. ort: ONNX Runtime's own format, with the "
        "list of operators for a reduced build. c: model.c and model.h in C99 that needs nothing but math.h, one "
        "function from a window to the estimate, with check.c that works the card's example on the target; constants "
        "and static memory in kB are shown. Prints one JSON object.",
    )
    export.add_argument("--model", type=Path, required=True, metavar="BUNDLE", help="a bundle from 'train'")
    export.add_argument("--to", required=True, choices=("int8", "ort", "c"), help="the shape")
    export.add_argument("--out", type=Path, required=True, metavar="DIR", help="the bundle to write")
    export.set_defaults(run=_export)

    bench = commands.add_parser(
        "bench",
        help="the benchmark suite",
        description="Without a bundle, the skin: the solver against FElupe, a slide, two workers, the synthetic signal "
        "(positions a core-second, times real time; minutes). With one, the device's runtime: one decision (20 ms of "
        "samples in, an estimate out) in us, at rest (of one and of four accelerometers) and in a slide, each beside a "
        "call of a one-node graph; import and first estimate in s; memory above numpy with ONNX Runtime in MB, all and "
        "without pages of code; the bundle's size in kB. One thread. The last line is one JSON object.",
    )
    bench.add_argument(
        "--model", type=Path, metavar="BUNDLE", help="a bundle from 'train' (default: the skin)"
    )
    bench.add_argument(
        "--decisions",
        type=int,
        default=300,
        metavar="N",
        help="times each is measured (default: %(default)s)",
    )
    bench.add_argument(
        "--page",
        action="store_true",
        help="what the live page costs instead (needs the live extra): share of a core, ms that estimates and frames "
        "are late, for the stream alone and with 0, 1 and 4 viewers, each over N estimates",
    )
    bench.set_defaults(run=_bench)

    return parser


def _demo(arguments: argparse.Namespace) -> int:
    from experiments.demo import demo
    from models.export.bundle import ParityError

    try:
        print(demo(arguments.out))
    except ParityError as error:
        print(f"softslide demo: {error}", file=sys.stderr)
        return 1
    return 0


def _check(arguments: argparse.Namespace) -> int:
    import json

    from pipeline.checks.findings import as_json, examine
    from pipeline.recordings.folder import read_folder

    recordings = read_folder(arguments.folder)
    findings = examine(recordings)
    errors = [finding for finding in findings if finding.level == "error"]
    if arguments.json:
        print(json.dumps(as_json(recordings, findings), indent=1, allow_nan=False))
    else:
        for finding in findings:
            print(finding.line())
        print(f"{len(recordings)} recordings, {len(errors)} errors, {len(findings) - len(errors)} warnings")
    if errors:
        raise InputError(
            f"{arguments.folder}: {len(errors)} errors, first {errors[0].line()}; mend or drop these"
        )
    return 0


def _import(arguments: argparse.Namespace) -> int:
    from pipeline.importers.import_map import KINDS, read_map, template

    if arguments.map_template:
        if arguments.map_template not in KINDS:
            raise InputError(f"--map-template {arguments.map_template}: name one of {', '.join(KINDS)}")
        print(template(arguments.map_template), end="")
        return 0
    if not (arguments.sources and arguments.map and arguments.out):
        raise InputError("give SOURCE..., --map MAP.toml and --out DIR, or --map-template KIND")
    from pipeline.importers.run import import_recordings

    done = import_recordings(arguments.sources, read_map(arguments.map), arguments.out)
    for note in done.notes:
        print(note, file=sys.stderr)
    resumed = f", {done.resumed} of them finished before" if done.resumed else ""
    print(f"{done.out}: {done.recordings} recordings imported{resumed}")
    return 0


def _train(arguments: argparse.Namespace) -> int:
    from experiments.train import train
    from models.export.bundle import ParityError

    try:
        done = train(
            arguments.recordings,
            arguments.out,
            arguments.model,
            atlas=arguments.atlas,
            init=arguments.init,
            config=arguments.config,
        )
    except ParityError as error:
        print(f"softslide train: {error}; nothing was written", file=sys.stderr)
        return 1
    print(f"softslide train: run {done.run.identifier} in {done.run.store}", file=sys.stderr)
    print(done.bundle)
    return 0


def _sweep(arguments: argparse.Namespace) -> int:
    from experiments.sweep.search import sweep

    print(sweep(arguments.config), end="")
    return 0


def _evaluate(arguments: argparse.Namespace) -> int:
    from experiments.evaluate import evaluate

    result = evaluate(
        arguments.model, arguments.recordings, arguments.split, arguments.out, jobs=arguments.jobs
    )
    print(f"softslide evaluate: wrote {arguments.out}/report.html", file=sys.stderr)
    print("\n".join(verdict.line() for verdict in result.verdicts))
    return 0 if result.met else 1


def _predict(arguments: argparse.Namespace) -> int:
    import json

    from serve.predict import predict

    for line in predict(arguments.model, arguments.files):
        print(json.dumps(line, allow_nan=False), flush=True)
    return 0


def _serve(arguments: argparse.Namespace) -> int:
    from serve.stream.live import serve

    print(f"softslide serve: {arguments.source}; stop with Ctrl-C", file=sys.stderr)
    written = serve(
        arguments.model,
        arguments.source,
        arguments.sink or ["-"],
        arguments.format,
        arguments.fast,
        arguments.page,
        arguments.smooth,
    )
    print(f"softslide serve: {written} estimates", file=sys.stderr)
    return 0


def _export(arguments: argparse.Namespace) -> int:
    import json

    from models.export.formats import export

    print(json.dumps(export(arguments.model, arguments.to, arguments.out)))
    print(f"softslide export: wrote {arguments.out}", file=sys.stderr)
    return 0


def _bench(arguments: argparse.Namespace) -> int:
    import json

    if arguments.model is None:
        if arguments.page:
            raise InputError("--page: name a bundle with --model")
        from experiments.bench.skin import run_all

        print(json.dumps(run_all()))
        return 0
    if arguments.decisions < 1:
        raise InputError(f"--decisions {arguments.decisions}: measure at least one")
    if arguments.page:
        from serve.bench.page import bench_page

        print(json.dumps(bench_page(arguments.model, arguments.decisions)))
        return 0
    from serve.bench.runtime import bench

    print(json.dumps(bench(arguments.model, arguments.decisions)))
    return 0


def _simulate(arguments: argparse.Namespace) -> int:
    from pipeline.atlas.solve import simulate

    simulate(
        arguments.sensor,
        arguments.out,
        arguments.coarse,
        arguments.depth,
        arguments.workers,
        arguments.backend,
    )
    return 0


def _synthesize(arguments: argparse.Namespace) -> int:
    from pipeline.synthesis.synthesize import synthesize

    folder = synthesize(
        arguments.atlas,
        arguments.sensor,
        arguments.slides,
        arguments.seed,
        arguments.out,
        paths=arguments.paths,
    )
    counts = folder.manifest["split"].value_counts(sort=False)
    print(f"{folder.root}: {', '.join(f'{count} {split}' for split, count in counts.items())}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
