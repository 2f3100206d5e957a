"""Subcommands that make and check data: import, check, simulate, synthesize, export-recordings."""

import sys
from json import dumps
from pathlib import Path
from typing import Any

import softslide
from softslide.commands.arguments import Parser, Run
from softslide.features.errors import InputError


def check(parser: Parser) -> Run:
    """validate a folder of recordings

    Checks a folder's format and its health: clock, clipping, wiring, noise
    (g/sqrt(Hz)), mains, drift, labels, splits, signs of made-up data; each
    finding with its figure and its limit, of all recordings in one pass.
    Where it has several pressures (MPa) or a laser's readings (skin_height_mm),
    the skin's height (mm) at each, by the article's formula and by the solved
    design, from the static tilts. Says what the calibration slides do not cover:
    directions, lines, speeds (deg, mm, mm/s), speed and heading confounded.
    Exit status 2 on an error, 0 with warnings alone.

        softslide check my-recordings
        softslide check my-recordings --json
        softslide check my-recordings --picture coverage.svg
    """
    parser.existing("folder", "DIR", "holds sensor.toml, manifest.csv, slides/*.parquet")
    parser.atlas("of the sensor's design (default: the one that ships, or was solved earlier)")
    parser.flag("--json", "the report as one JSON object")
    parser.picture("coverage.svg", "draw what the slides cover")

    def run(folder: Path, json: bool, **given: Any) -> None:
        report = softslide.check(folder, **given)
        if json:
            print(dumps(report.as_json(), indent=1, allow_nan=False))
        elif not report.unreadable:
            print(*report.lines(), sep="\n")
        if report.unreadable:
            raise InputError(report.unreadable)
        if errors := report.level("error"):
            first = errors[0].line()
            raise InputError(f"{folder}: {len(errors)} errors, first {first}; correct or remove these")

    return run


def import_(parser: Parser) -> Run:
    """turn a lab's files into a folder of recordings

    Reads CSV, Excel, Parquet, HDF5, TDMS, MATLAB, ROS 1, ROS 2 and MCAP files as a
    map says (volts, g, m/s2 or counts; s, ms, us, ns or timestamps), converts
    them to volts (V) at an even sample rate (Hz), and reports which signs it
    changed and why. An interrupted import resumes; bad input leaves nothing.
    A map with kind = "grid" puts slides together from presses on a grid.

        softslide import --sensor-template > sensor.toml
        softslide import --guess lab > map.toml
        softslide import --map-template csv > map.toml
        softslide import lab/*.csv --map map.toml --out my-recordings
    """
    from softslide.pipeline.importers.readers.registry import READERS

    kinds = ", ".join(f"{kind} ({reader.title})" for kind, reader in READERS.items())
    parser.existing("sources", "SOURCE", "files, or folders to search", nargs="*")
    parser.existing("--map", "MAP.toml", "what the files mean: columns, units, labels")
    parser.out("the folder of recordings to write", required=False)
    printed = "print a commented {} to start from".format
    parser.add_argument("--map-template", metavar="KIND", help=f"{printed('map')}: {kinds}, grid")
    guess = "print a map guessed from delimited text files and their names; what is unsure is marked"
    parser.flag("--guess", guess)
    parser.flag("--sensor-template", printed("sensor.toml"))

    def run(map_template: str | None, guess: bool, sensor_template: bool, **given: Any) -> None:
        from softslide.pipeline.importers.import_map import template

        if sensor_template:
            print(template("sensor"), end="")
            return
        if map_template:
            if map_template not in (*READERS, "grid"):
                raise InputError(f"{map_template}: name one of {', '.join(READERS)}, grid", "map_template")
            print(template(map_template), end="")
            return
        if guess and given["sources"]:
            from softslide.pipeline.importers.guess import guess_map

            print(guess_map(given["sources"]), end="")
            return
        if not all(given.values()):
            raise InputError(
                "give SOURCE..., --map MAP.toml and --out DIR, or SOURCE... --guess, or --map-template KIND, or "
                "--sensor-template"
            )
        done = softslide.import_recordings(**given)
        print(*done.notes, sep="\n", end="\n" if done.notes else "", file=sys.stderr)
        resumed = f", {done.resumed} of them finished before" if done.resumed else ""
        print(f"{done.out}: {done.recordings} recordings imported{resumed}")

    return run


def simulate(parser: Parser) -> Run:
    """solve the skin: the response atlas of a sensor design

    Slides an indenter over the inflated skin along lines in both axes and
    both directions, at each contact depth (mm) and each skin height (mm) or
    effective pressure (MPa) of the design, and writes what every
    accelerometer reads (V). An interrupted solve resumes from the lines it
    has finished.

        softslide simulate --sensor sensor.toml --coarse --out atlas.npz
    """
    parser.sensor("the design (default: the article's sensor)")
    parser.out("the .npz file to write", metavar="ATLAS")
    parser.flag("--coarse", "minutes instead of an hour, for a first look")
    parser.number("--depth", "MM", "contact depths in mm (default: 0.2 0.6 1.2)", nargs="+")
    parser.number("--jobs", "N", "processes", 2, "--workers", dest="jobs")
    runs = "what runs them (default: %(default)s)"
    parser.add_argument("--backend", choices=("loky", "dask"), default="loky", help=runs)
    parser.scheduler()

    def run(**given: Any) -> None:
        softslide.simulate(**given)

    return run


def synthesize(parser: Parser) -> Run:
    """write a folder of synthetic recordings from an atlas

    Slides along straight lines at any angle, offset (mm), speed (mm/s),
    contact depth (mm) and pressure (MPa) over one sensor drawn from the seed:
    volts (V) with the accelerometer's noise and bandwidth, mains, vibration
    and the skin's lag. Of every ten slides five are of split calibration
    (along x and y), two of calibration-diagonal (any direction), two of test
    and one of test-diagonal, on lines that are not in calibration. The same
    seed writes the same files; synthesis.json says what they were drawn from.

        softslide synthesize --slides 100 --seed 5 --out synthetic
        softslide synthesize --slides 100 --config deeper.toml --out deeper
        softslide synthesize --paths 40 --out paths
        softslide synthesize --paths 40 --solved --out solved
        softslide synthesize --protocol article --out protocol
    """
    parser.atlas("from 'simulate' (default: the article's sensor's)")
    names = "names, places and electronics of the atlas's design"
    parser.sensor(f"{names} (default: the article's electronics)")
    parser.number("--slides", "N", "how many slides along straight lines", 0)
    kinds = "lines, curves, changing speed, stops, turns back, touch-downs, lifts, changing depth, presses"
    paths = f"how many contacts along any path, with their truth: {kinds}; splits track-KIND"
    parser.number("--paths", "N", paths, 0)
    solved = (
        "solve each path on the skin, step by step, instead of reading it from the atlas: truer friction and "
    )
    parser.flag("--solved", f"{solved}touch-downs, at some seconds a path")
    protocol = "the article's 512 slides along x and y, split calibration (default: none)"
    parser.add_argument("--protocol", choices=("article",), help=protocol)
    parser.number("--seed", "N", "of all that is random", 0)
    keys = "height_mm, pressure_share, depth_mm, offset_mm, speed_mm_s, [electronics] noise and more (docs/format.md)"
    parser.existing("--config", "FILE", f"a TOML file that changes what slides and sensor are like: {keys}")
    parser.out("the folder to write")

    def run(**given: Any) -> None:
        folder = softslide.synthesize(**given)
        counts = folder.manifest["split"].value_counts(sort=False)
        print(f"{folder.root}: {', '.join(f'{count} {split}' for split, count in counts.items())}")

    return run


def export_recordings(parser: Parser) -> Run:
    """write recordings, with their estimates, as a LeRobot data set

    In LeRobot's format v3.0, which robot policies are trained on: a recording is
    an episode, 20 ms a frame at 50 Hz. observation.volts is the mean output (V);
    with --model also observation.estimate: place x, y (mm), velocity (mm/s),
    depth and offset (mm), and observation.valid; where it is false the estimate
    is 0. The manifest's names are in meta/episodes. Prints where it is.

        softslide export-recordings --recordings my-recordings --to lerobot --out my-dataset
        softslide export-recordings --recordings my-recordings --model my-model \\
            --out my-dataset
    """
    parser.recordings("what to export")
    parser.add_argument(
        "--to", choices=("lerobot",), default="lerobot", help="the format (default: %(default)s)"
    )
    bundle = "a bundle from 'train': its estimates are exported too (default: volts alone)"
    parser.existing("--model", "BUNDLE", bundle)
    parser.add_argument("--split", nargs="+", metavar="NAME", help="the splits to export (default: all)")
    parser.out("the data set to write")

    def run(out: Path, **given: Any) -> None:
        info = softslide.export_recordings(out=out, **given)
        print(f"{out}: {info['total_episodes']} episodes, {info['total_frames']} frames")

    return run


COMMANDS = (check, import_, simulate, synthesize, export_recordings)
