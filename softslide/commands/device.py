"""Subcommands that a device has, with the base install alone: predict, serve."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import softslide
from softslide.commands.arguments import Parser, Run
from softslide.features.errors import InputError


def predict(parser: Parser) -> Run:
    """one JSON line a recording

    The estimate at each recording's end as a line of JSON: angles in degrees
    (deg), lengths in mm, speed in mm/s, time in s; lo and hi bound a 90 %
    interval; null where nothing is estimated. A file that cannot be read is a
    line on standard error, the others go on, and the exit status is 2. With
    --presses: where and how hard something presses, from the solved skin. Read
    from the strongest 0.2 s that begin 0.3 s after the touch of a recording that
    rests at its start: place and depth in mm, force in mN, and the radius (mm)
    that holds the place with 90 %: one accelerometer leaves many places, several
    leave one.

        softslide predict --model my-model slide.csv
        softslide predict --model my-model --presses --height 7.1 press.csv
        softslide predict --model my-model --map map.toml lab/slide.txt
        softslide predict --model my-model --track path.csv > path.jsonl
        softslide predict --model my-model --whole-contact curve.csv > curve.jsonl
    """
    parser.model()
    whole = "as --track, but each moment's estimate is from its whole contact, what comes after it included: sharper "
    whole += "on curves; with a cnn of a skin that is touched anywhere, as of magnetometers"
    parser.flag("--track", "every estimate of each recording, one a block (20 ms)")
    parser.flag("--whole-contact", whole)
    parser.flag("--presses", "a press in each recording (needs the io extra and --height)")
    parser.atlas("with --presses, of the sensor's design (default: the one that ships, or solved now)")
    parser.of_bundle()
    raw = "what the files mean, as in 'import', where they are a lab's own (needs the io extra)"
    parser.existing("--map", "MAP.toml", raw)
    kinds = "CSV with time_s (s) and a0_vx, a0_vy, a0_vz, ... (V), or Parquet (needs the io extra)"
    parser.existing("files", "FILE", kinds, nargs="+")

    def run(files: list[Path], map: Path | None, presses: bool, atlas: Path | None, **given: Any) -> None:
        bad: list[InputError] = []
        with ExitStack() as stack:
            if map:
                from softslide.pipeline.importers.run import volts_of

                scratch = stack.enter_context(TemporaryDirectory(prefix="softslide-"))
                files = volts_of(files, map, Path(scratch) / "volts")
            if presses:
                model, height_mm, unsigned = (given[name] for name in ("model", "height_mm", "unsigned"))
                lines = _presses(model, files, atlas, height_mm, unsigned, bad.append)
            else:
                lines = softslide.predict(files=files, refused=bad.append, **given)
            for line in lines:
                print(json.dumps(line, allow_nan=False), flush=True)
        for error in bad[:-1]:
            print(f"softslide predict: {error}", file=sys.stderr)
        if bad:
            raise bad[-1]

    return run


def _presses(
    model: Path,
    files: list[Path],
    atlas: Path | None,
    height_mm: float | None,
    unsigned: bool,
    refused: Callable[[InputError], None],
) -> Iterator[dict[str, Any]]:
    """The press in each file, by the solved skin of the bundle's sensor.

    Raises:
        InputError: the bundle or the atlas is not valid, or no height is named.
    """
    from softslide.pipeline.atlas.library import atlas_of
    from softslide.pipeline.atlas.presses import press_in
    from softslide.pipeline.sensor import sensor_of
    from softslide.serve.bundle import open_bundle
    from softslide.serve.files import read_recording

    card, _ = open_bundle(model, unsigned)
    if height_mm is None:
        raise InputError(
            "is needed: a press is read at a height of the inflated skin; name it in mm", "height"
        )
    sensor = sensor_of(card.sensor, f"{model / 'model.json'}: sensor")
    solved = atlas_of(sensor, atlas)
    for path in files:
        try:
            volts = read_recording(path, sensor.channels, sensor.sample_rate_hz)
        except InputError as error:
            refused(error)
            continue
        yield {"recording": path.stem, "file": str(path), **press_in(volts, sensor, solved, height_mm)}


def serve(parser: Parser) -> Run:
    """stream estimates from a live source

    Estimates of a live stream, one every 20 ms: angles in degrees (deg),
    lengths in mm, speed in mm/s, time in s; lo and hi bound a 90 % interval;
    null where nothing is estimated. Ends with the source, or on SIGINT or
    SIGTERM. Other machines can connect only where HOST says so.

        softslide serve --model my-model --source slide.csv --page 8000
        softslide serve --model my-model --source udp://:9000 --log run.mcap
        softslide serve --model my-model --source udp://:9000 --sink udp://127.0.0.1:9001
    """
    parser.model()
    parser.add_argument(
        "--source",
        required=True,
        help="FILE.csv or FILE.parquet (needs the io extra) plays a recording; '-' reads standard input; "
        "udp://HOST:PORT; serial:///dev/PORT?BAUD (needs the live extra); ros2://TOPIC, std_msgs/Float64MultiArray "
        "of volts (V), or ros2+imu://TOPIC, sensor_msgs/Imu (m/s2), both need rclpy",
    )
    parser.add_argument(
        "--sink",
        action="append",
        help="'-' writes JSON lines on standard output (default); udp://HOST:PORT one JSON object a datagram; "
        "ros2://TOPIC positions in m, velocities in m/s with their covariance, and estimates; may be given again",
    )
    parser.form()
    parser.of_bundle()
    log = "a new MCAP file for what comes (V) and goes out, as Foxglove and Rerun open it; 'import' reads its volts "
    parser.add_argument("--log", type=Path, metavar="FILE.mcap", help=f"{log}(needs the live extra)")
    rate = "sample rate of a live source (default: as in the bundle's calibration); a recording has its own clock"
    parser.number("--rate", "HZ", rate)
    lag = "give each estimate so many s later, at most 2, from later samples as well: sharper, and valid "
    parser.number("--lag", "S", f"{lag}more often (cnn alone)", default=0.0)
    parser.flag("--fast", "play a recording as fast as it goes")
    parser.add_argument(
        "--page",
        metavar="[HOST:]PORT",
        help="show the stream on a live page as well (needs the live extra); without HOST this machine alone "
        "reaches it, port 0 is any that is free; open it before a recording is played: it waits and comes back",
    )

    def run(source: str, **given: Any) -> None:
        print(f"softslide serve: {source}; stop with Ctrl-C", file=sys.stderr)
        written = softslide.serve(source=source, **given)
        print(f"softslide serve: {written} estimates", file=sys.stderr)

    return run


COMMANDS = (predict, serve)
