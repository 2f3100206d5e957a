"""The command line: a subcommand for each job, each a function in commands/.

Here is what holds for all of them: exit statuses, and errors in one line.
"""

import argparse
import errno
import os
import re
import sys
from collections.abc import Sequence

import softslide
from softslide.features.errors import CheckFailed, InputError, printable

# The extra that a subcommand needs beyond the base install. Device commands need one for some of their options only,
# which the package that is missing decides: so does a package of another extra than the subcommand's own.
COMMAND_EXTRA = dict.fromkeys(
    ("check", "import", "synthesize", "export-recordings", "predict", "serve", "record"), "io"
)
PACKAGE_EXTRA = {
    **dict.fromkeys(("fastapi", "mcap", "serial", "uvicorn", "websockets"), "live"),
    **dict.fromkeys(("dask", "distributed"), "cluster"),
    **dict.fromkeys(("matplotlib", "mlflow", "numba"), "train"),
}
# A disk that is full, over its quota or read-only, and places that may not be written.
NO_PLACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM)
# A name that no system takes, or a link that leads nowhere.
NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one subcommand.

    Returns 0 on success, 2 on bad usage or input, 1 on a bound not met or a failed check, 130 on Ctrl-C.
    """
    from softslide.commands.arguments import located, options

    argv = sys.argv[1:] if argv is None else argv
    name = next((word for word in argv if not word.startswith("-")), "")
    try:
        given = parser().parse_args(argv)
        with located(given):
            status = given.run(**options(given)) or 0
        # Here and not at the interpreter's end, so that a full disk is an error like others.
        sys.stdout.flush()
        return status
    except InputError as error:
        return _said(name, with_option(error), 2)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in ("", "softslide"):
            raise
        extra = PACKAGE_EXTRA.get(package) or COMMAND_EXTRA.get(name, "train")
        print(f"softslide {name} needs softslide[{extra}]: pip install 'softslide[{extra}]'", file=sys.stderr)
        return 2
    except CheckFailed as error:
        return _said(name, str(error), 1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        if error.errno in NO_NAME:
            return _said(name, printable(f"{error.filename}: {error.strerror}; name another place"), 2)
        if error.errno not in NO_PLACE:
            raise
        where = error.filename or "the output"
        if not error.filename:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        text = f"{where}: {error.strerror or error}; free some space, or name a place that can be written"
        return _said(name, printable(text), 1)
    except KeyboardInterrupt:
        return _said(name, "interrupted", 130)


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    from softslide.commands import data, device, lab, learning
    from softslide.commands.arguments import Parser, add_commands

    top = Parser(prog="softslide", description=(softslide.__doc__ or "").partition("\n")[0])
    top.add_argument(
        "--version",
        action="version",
        version=f"softslide {softslide.__version__}",
        help="show the version and exit",
    )
    add_commands(top, (*learning.COMMANDS, *device.COMMANDS, *data.COMMANDS, *lab.COMMANDS))
    return top


def with_option(error: InputError) -> str:
    """The error's message; a parameter that it begins with is shown as the option of that name, without its unit."""
    if not error.parameter:
        return str(error)
    option = re.sub("_(deg|hz|mm|mm_s|s)$", "", error.parameter).replace("_", "-")
    return f"--{option}" + str(error).removeprefix(error.parameter)


def _said(command: str, text: str, status: int) -> int:
    print(f"softslide {command}: {text}", file=sys.stderr)
    return status
