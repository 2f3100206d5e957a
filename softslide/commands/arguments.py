"""What the subcommands share: how one is declared, paths that have to exist, and the options that several of them have.

A subcommand is a function of its parser: it declares its arguments and returns what runs them. Its name is the
command's, its docstring the text of `--help`. The rooms are imported when it runs, not before.
"""

import argparse
import inspect
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from softslide.features.errors import InputError

UNITS = ("DEG", "HZ", "MM", "MM_S", "S")


class Parser(argparse.ArgumentParser):
    """With the options that several commands have."""

    def flag(self, name: str, help: str) -> None:
        """An option without a value: it is given or not."""
        self.add_argument(name, action="store_true", help=help)

    def of_bundle(self) -> None:
        """How the bundle is read: `--height`, for one over heights, and `--unsigned`, for those of release 0.1."""
        self.add_argument(
            "--height",
            dest="height_mm",
            type=float,
            metavar="MM",
            help="of the inflated skin, mm, for a bundle trained at several (default: as the static output shows it)",
        )
        self.flag("--unsigned", "also a bundle whose card has no hash, which shows no changes")

    def form(self) -> None:
        """--format csv, f32 or cobs"""
        self.add_argument(
            "--format",
            choices=("csv", "f32", "cobs"),
            default="csv",
            help="of bytes from outside: csv, lines of volts (V) with or without a time (s) before them; f32, "
            "little-endian float32 frames, one number a channel; cobs, frames with a checksum that can be joined "
            "anywhere (default: %(default)s; over a serial port take csv or cobs)",
        )

    def existing(self, name: str, metavar: str, help: str, **options: Any) -> None:
        """An argument for a path that has to exist, or for several: given again, all are kept."""
        action = "extend" if "nargs" in options else "store"
        added = self.add_argument(name, type=Path, action=action, metavar=metavar, help=help, **options)
        self.set_defaults(existing=[*(self.get_default("existing") or ()), added.dest])

    def model(self) -> None:
        """--model BUNDLE"""
        help = "a bundle from 'train', or models:/softslide@champion (needs the train extra)"
        self.existing("--model", "BUNDLE", help, required=True)

    def recordings(self, help: str, **options: Any) -> None:
        """--recordings DIR"""
        self.existing("--recordings", "DIR", help, required=True, **options)

    def sensor(self, help: str, **options: Any) -> None:
        """--sensor sensor.toml"""
        self.existing("--sensor", "sensor.toml", help, **options)

    def atlas(self, help: str) -> None:
        """--atlas ATLAS"""
        self.existing("--atlas", "ATLAS", help)

    def number(
        self, name: str, metavar: str, help: str, default: Any = None, *also: str, **further: Any
    ) -> None:
        """A number, or several; of the default's type, else a float. Its help ends with the default. also: older names.

        What it is kept as ends with the unit, as the function's parameter does.
        """
        shown = f"{help} (default: %(default)s)" if isinstance(default, int | float) else help
        unit = f"_{metavar.lower()}" if metavar in UNITS else ""
        kept = {"type": float if default is None else type(default), "default": default}
        kept["dest"] = name.strip("-") + unit
        self.add_argument(name, *also, metavar=metavar, help=shown, **(kept | further))

    def picture(self, metavar: str, help: str) -> None:
        """--picture FILE"""
        text = f"{help}: .svg, .png or .pdf (needs the train extra)"
        self.add_argument("--picture", type=Path, metavar=metavar, help=text)

    def out(self, help: str, metavar: str = "DIR", required: bool = True) -> None:
        """--out DIR"""
        self.add_argument("--out", type=Path, required=required, metavar=metavar, help=help)

    def scheduler(self) -> None:
        """--scheduler ADDRESS"""
        help = "tcp://HOST:PORT of a Dask scheduler (needs the cluster extra): its workers do the work, with this "
        help += "program and the same files in the same places (default: processes of this computer do)"
        self.add_argument("--scheduler", default="", metavar="ADDRESS", help=help)


# Runs with the values of the arguments by name; returns the exit status, None for 0.
Run = Callable[..., int | None]
Command = Callable[[Parser], Run]


def add_commands(parser: Parser, commands: Sequence[Command]) -> None:
    """Adds a subcommand for each function; `arguments.command` is its name and `arguments.run` what runs it."""
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in commands:
        text = inspect.getdoc(command) or ""
        subparser = subparsers.add_parser(
            command.__name__.rstrip("_").replace("_", "-"),
            help=text.partition("\n")[0].replace("%", "%%"),
            description=text,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        subparser.set_defaults(run=command(subparser))


@contextmanager
def located(given: argparse.Namespace) -> Iterator[None]:
    """Sees that the paths that have to exist do, before anything that takes time is imported; fetches what `models:/`
    names from the registry, for as long as the block runs.

    Raises:
        InputError: there is no such file, folder or registered bundle, nothing can be written where the output is to
            go, or a picture of this kind is not drawn.
    """
    for name in getattr(given, "existing", ()):
        value = getattr(given, name)
        for path in value if isinstance(value, list) else [value]:
            if path is not None and not is_registered(path) and not path.exists():
                raise InputError(f"{path}: no such file or folder; name one that exists")
    if out := getattr(given, "out", None):
        _check_place(out)
    picture = getattr(given, "picture", None)
    if picture is not None and picture.suffix not in (".svg", ".png", ".pdf"):
        raise InputError(f"{picture}: name a .svg, .png or .pdf", "picture")
    with ExitStack() as stack:
        if is_registered(getattr(given, "model", None)):
            from softslide.experiments.tracking import fetched

            scratch = stack.enter_context(tempfile.TemporaryDirectory(prefix="softslide-"))
            given.model = fetched(str(given.model), Path(scratch))
        yield


def _check_place(out: Path) -> None:
    """Sees that something can be written there, before the work and not after it."""
    from softslide.pipeline.staging import writing

    if out.is_symlink() and not out.exists():
        raise InputError(f"{out}: is a link to what there is not; remove it, or name another place", "out")
    above = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    if above == out and not above.is_dir():
        above = out.absolute().parent
    with writing(out, "name another place"), tempfile.TemporaryFile(dir=above):
        pass


def options(given: argparse.Namespace) -> dict[str, Any]:
    """The values of a command's arguments by name, which what runs it is called with."""
    return {name: value for name, value in vars(given).items() if name not in ("command", "run", "existing")}


def is_registered(value: object) -> bool:
    """Whether a bundle is named by its place in the registry, as in `models:/softslide@champion`."""
    return isinstance(value, Path) and str(value).startswith("models:/")
