"""Subcommands at the bench: design, plan, record."""

from pathlib import Path
from typing import Any

import softslide
from softslide.commands.arguments import Parser, Run


def design(parser: Parser) -> Run:
    """where to put the accelerometers, and what they can reach

    Solves the bare skin of a design (a minute on one core), and finds the
    places of so many boards at which the Cramer-Rao bound over the skin is
    least: the least errors in direction (deg), speed (%) and distance (mm) that
    any unbiased estimate can have. Writes design.html with a map of them,
    design.csv, and for each number of boards a sensor-N.toml to go on with
    ('simulate', 'plan'). Prints the table.

        softslide design --sensor sensor.toml --boards 1 2 3 4 --out design
        softslide design --sensor sensor.toml --boards 2 --height 9 --out design
    """
    parser.sensor("the design", required=True)
    boards = "numbers of accelerometers (default: 1 2 3 4)"
    parser.number("--boards", "N", boards, [1, 2, 3, 4], type=int, nargs="+")
    parser.number("--thickness", "MM", "of the skin, mm (default: the sensor's)")
    parser.number("--height", "MM", "of the inflated skin, mm (default: 7)")
    parser.number("--chamber", "MM", "along x and y, mm (default: the sensor's)", nargs=2)
    parser.number("--depth", "MM", "contact depth, mm", 0.5)
    parser.out("where the page, the table and the sensors go")

    def run(out: Path, **given: Any) -> None:
        table = softslide.design(out=out, **given)
        print(table.to_string(index=False, float_format="{:.3g}".format))
        print(out / "design.html")

    return run


def plan(parser: Parser) -> Run:
    """which slides to record

    Chooses the slides after which a calibrated response map misleads the
    estimates least: Bayesian design on the sensor's own map, over lines in all
    directions (deg) and offsets (mm), which take the speeds (mm/s) in turn.
    Writes a CSV for the stage and for 'record', the most useful slide first,
    in the manifest's columns: start and travel in mm, direction in deg, speed
    in mm/s. Prints what the map is expected to add to the errors in direction
    (deg), speed (%) and distance (mm), over the skin, without any slide and
    with these.

        softslide plan --sensor sensor.toml --slides 12 --out plan.csv --picture plan.svg
        softslide plan --sensor sensor.toml --slides 12 --out plan.csv --gcode plan.gcode
        softslide plan --sensor sensor.toml --slides 24 --paths 18 --out plan.csv
        softslide plan --sensor my-recordings/sensor.toml --slides 12 --out plan.csv \\
            --candidates my-recordings/manifest.csv
    """
    parser.sensor("the design", required=True)
    parser.number("--slides", "N", "how many slides", 12)
    parser.atlas("from 'simulate' (default: the shipped one for its design, else solved coarsely)")
    among = "choose among the calibration and train slides of a manifest (default: lines in all directions)"
    parser.existing("--candidates", "manifest.csv", among)
    directions = "directions that the stage can move in, deg (default: every 15)"
    parser.number("--directions", "DEG", directions, nargs="+")
    parser.number("--speeds", "MM_S", "speeds that the stage can move at, mm/s (default: 1 2 4)", nargs="+")
    parser.number("--depth", "MM", "contact depth, mm", 0.5)
    apart = "how many test slides to add, along other lines, so that each of the article's bounds is tested"
    parser.number("--tests", "N", apart, 0)
    others = "how many contacts to add that bend, stop, turn back, press, touch down or lift, for a stage to follow"
    parser.number("--paths", "N", others, 0)
    parser.out("the CSV to write", metavar="plan.csv")
    parser.picture("plan.svg", "draw the plan too")
    program = "G-code too, for a printer or a small CNC machine that moves the ball (docs/printer.md)"
    parser.add_argument("--gcode", type=Path, metavar="plan.gcode", help=program)
    firmware = "whose dialect it is in (default: %(default)s)"
    parser.add_argument("--firmware", choices=("marlin", "grbl"), default="marlin", help=firmware)

    def run(out: Path, **given: Any) -> None:
        print(*softslide.plan(out=out, **given).lines(), out, sep="\n")

    return run


def record(parser: Parser) -> Run:
    """record the slides of a plan into a folder of recordings

    Walks through a plan, slide by slide: says what the stage is to be set to
    (deg, mm, mm/s), counts down, shows the live level (mV), and asks whether
    to keep the slide. Each is written at once, so that the folder is whole at
    any time and the same command goes on where it stopped. A slide that a
    pulled cable or lost samples have broken is recorded again once the source
    is back. A recording is rest, the time to start the stage in, the motion
    (travel over speed and 1 s) and rest; the moments of motion stay empty.
    Answers may be piped in, a line each. With --stage a 3-D printer or a small
    CNC machine moves the ball, also along waypoints, and its acknowledgements
    give the moments of motion, as docs/printer.md says.

        softslide record --source serial:///dev/ttyACM0 --sensor sensor.toml \\
            --plan plan.csv --out my-recordings
        softslide record --source udp://:9000 --plan plan.csv --out my-recordings
        softslide record --source udp://:9000 --plan plan.csv --out my-recordings --yes \\
            --stage "serial:///dev/ttyUSB0?firmware=marlin" --origin 110 95 31.5 \\
            --until 0.4deg 0.7% 0.09mm --page progress.html
        softslide check my-recordings
    """
    parser.add_argument(
        "--source",
        required=True,
        help="serial:///dev/PORT?BAUD (needs the live extra); udp://HOST:PORT; ros2://TOPIC (needs rclpy)",
    )
    parser.existing("--plan", "plan.csv", "from 'plan', or any CSV with a manifest's labels", required=True)
    parser.sensor("the sensor, written into a new folder (default: the folder's own)")
    parser.out("the folder to write or to go on with")
    parser.form()
    parser.number("--rest", "S", "rest before and after each motion, s", 3.0)
    parser.number("--start", "S", "to start the stage in, s", 3.0)
    parser.number("--timeout", "S", "silence that counts as a pulled cable, s", 2.0)
    parser.number("--wait", "S", "how long to wait for the source to come back, s", 600.0)
    parser.flag("--yes", "ask nothing: record and keep every slide")
    moves = (
        "what moves the ball: serial:///dev/PORT?firmware=marlin&baud=115200, or grbl (needs the live extra)"
    )
    parser.add_argument("--stage", metavar="URL", help=f"{moves} (default: a person)")
    origin = (
        "where, after homing, the ball just touches the skin over the chamber's middle, mm (default: where it is now; "
        "--yes needs it)"
    )
    parser.number("--origin", "MM", origin, nargs=3)
    height = (
        "with --origin above the skin and the pressure off: find its height, by lowering so far at most, mm; "
        "not with --yes"
    )
    parser.number("--approach", "MM", height)
    parser.flag("--dry-run", "with --stage: drive the slides above the skin, and record nothing")
    enough = (
        "errors that are enough, 0.3deg, 0.7%% or 0.09mm: once the last eight slides are estimated so well by the "
        "map of those before, no more slides to learn from (needs the train extra; default: the whole plan)"
    )
    parser.add_argument("--until", nargs="+", default=[], metavar="ERROR", help=enough)
    meanwhile = "show slides done and to come and the error so far, in a browser (needs the train extra)"
    parser.add_argument("--page", type=Path, metavar="FILE.html", help=meanwhile)

    def run(**given: Any) -> None:
        folder, left = softslide.record(**given)
        missing = f", {left} of the plan are left" if left else ""
        print(f"{folder.root}: {len(folder)} recordings{missing}")

    return run


COMMANDS = (design, plan, record)
