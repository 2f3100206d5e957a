"""softslide: where is it, which way, how fast? One command, a subcommand for each job."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from features.errors import InputError


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one subcommand. Returns 0 on success, 2 on bad usage or input, 1 on a bound not met or a failure."""
    arguments = _parser().parse_args(argv)
    try:
        return arguments.run(arguments)
    except InputError as error:
        print(f"softslide {arguments.command}: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="softslide", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    check = commands.add_parser("check", help="validate a folder of recordings")
    check.add_argument("folder", type=Path, metavar="DIR", help="sensor.toml, manifest.csv, slides/*.parquet")
    check.set_defaults(run=_check)

    return parser


def _check(arguments: argparse.Namespace) -> int:
    from pipeline.recordings import check_folder, read_folder

    recordings = read_folder(arguments.folder)
    check_folder(recordings)
    print(f"{arguments.folder}: {len(recordings)} recordings are well")
    return 0


if __name__ == "__main__":
    sys.exit(main())
