"""Subcommands at the bench: record."""

import argparse

from commands import arguments
from commands.arguments import Parser, Run


def record(parser: Parser) -> Run:
    """record the slides of a plan into a folder of recordings

    Walks through a plan, slide by slide: says what the stage is to be set to
    (deg, mm, mm/s), counts down, shows the live level (mV), and asks whether
    to keep the slide. Each is written at once, so that the folder is whole at
    any time and the same command goes on where it stopped. A slide that a
    pulled cable or lost samples have broken is recorded again once the source
    is back. A recording is rest, the time to start the stage in, the motion
    (travel over speed and 1 s) and rest; the moments of motion stay empty.
    Answers may be piped in, a line each.

        softslide record --source serial:///dev/ttyACM0?115200 --sensor sensor.toml \\
            --plan plan.csv --out my-recordings
        softslide record --source udp://:9000 --plan plan.csv --out my-recordings
        softslide check my-recordings
    """
    parser.add_argument(
        "--source",
        required=True,
        help="serial:///dev/PORT?BAUD (needs the live extra); udp://HOST:PORT; ros2://TOPIC (needs rclpy)",
    )
    arguments.existing(
        parser, "--plan", "plan.csv", "from 'plan', or any CSV with a manifest's labels", required=True
    )
    arguments.sensor(parser, "the sensor, written into a new folder (default: the folder's own)")
    arguments.out(parser, "the folder to write or to go on with")
    parser.add_argument(
        "--format",
        choices=("csv", "f32"),
        default="csv",
        help="of the source's bytes, as in 'serve': csv, lines of volts (V) with or without a time (s) before them; "
        "f32, little-endian float32 frames (default: %(default)s; over a serial port take csv)",
    )
    for name, default, text in (
        ("--rest", 3.0, "rest before and after each motion"),
        ("--start", 3.0, "to start the stage in"),
        ("--timeout", 2.0, "silence that counts as a pulled cable"),
        ("--wait", 600.0, "how long to wait for the source to come back"),
    ):
        parser.add_argument(
            name, type=float, default=default, metavar="S", help=f"{text}, s (default: %(default)g)"
        )
    parser.add_argument("--yes", action="store_true", help="ask nothing: record and keep every slide")

    def run(given: argparse.Namespace) -> None:
        from experiments.acquisition.record import Times, record

        times = Times(given.rest, given.start, given.timeout, given.wait)
        folder, left = record(
            given.source, given.plan, given.out, given.sensor, given.format, times, given.yes
        )
        missing = f", {left} of the plan are left" if left else ""
        print(f"{folder.root}: {len(folder)} recordings{missing}")

    return run


COMMANDS = (record,)
