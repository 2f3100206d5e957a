"""softslide: where is it, which way, how fast? One command, a subcommand for each job.

Each subcommand is a function in commands/. Here is what holds for all of them: exit statuses, and errors in one line.
`import softslide` offers some of these jobs as functions (docs/api.md).
"""

import os
import sys

# `python -m softslide` puts the current folder first, where features/ may be anybody's.
if __name__ == "__main__" and sys.path[0] == os.getcwd() != os.path.dirname(os.path.abspath(__file__)):
    del sys.path[0]

import argparse
import errno
from collections.abc import Sequence
from importlib import import_module
from typing import Any

try:
    from features.errors import CheckFailed, InputError, printable
except ImportError as error:
    # A folder of a lab next to it, say, which Python finds first.
    import features

    found = getattr(features, "__file__", None) or next(iter(features.__path__))
    text = f"softslide: another package 'features' ({found}) is in the way; run it from another folder"
    raise (SystemExit if __name__ == "__main__" else ImportError)(text) from error

__version__ = "0.2.0"

# What `import softslide` offers, and where it is. Each is imported when it is first asked for.
OFFERED = {
    "SAMPLE": "pipeline.recordings.folder",
    "Estimate": "features.estimate",
    "Evaluation": "experiments.evaluate",
    "Folder": "pipeline.recordings.folder",
    "Localizer": "serve.localizer",
    "Recording": "pipeline.recordings.folder",
    "evaluate": "experiments.evaluate",
    "examine": "pipeline.checks.findings",
    "predict": "serve.predict",
    "read_folder": "pipeline.recordings.folder",
    "read_sensor": "pipeline.sensor",
    "synthesize": "pipeline.synthesis.synthesize",
    "train": "experiments.train",
    "write_folder": "pipeline.recordings.folder",
}

# The extra that a subcommand needs beyond the base install. Device commands need one for some of their options only,
# which the package that is missing decides: so does a package of another extra than the subcommand's own.
COMMAND_EXTRA = {
    "check": "io",
    "import": "io",
    "synthesize": "io",
    "predict": "io",
    "serve": "io",
    "record": "io",
}
PACKAGE_EXTRA = {
    **dict.fromkeys(("fastapi", "serial", "uvicorn", "websockets"), "live"),
    **dict.fromkeys(("dask", "distributed"), "cluster"),
    **dict.fromkeys(("matplotlib", "mlflow", "numba"), "train"),
}
# A disk that is full, over its quota or read-only, and places that may not be written.
NO_PLACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM)
OWN = ("commands", "experiments", "features", "models", "pipeline", "serve")


def __getattr__(name: str) -> Any:
    """A name of OFFERED, from its room."""
    if name not in OFFERED:
        raise AttributeError(f"softslide has no '{name}'; it offers {', '.join(OFFERED)}")
    return getattr(import_module(OFFERED[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *OFFERED})


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one subcommand.

    Returns 0 on success, 2 on bad usage or input, 1 on a bound not met or a failed check, 130 on Ctrl-C.
    """
    from commands.arguments import located

    argv = sys.argv[1:] if argv is None else argv
    name = next((word for word in argv if not word.startswith("-")), "")
    try:
        given = parser().parse_args(argv)
        with located(given):
            status = given.run(given) or 0
        # Here and not at the interpreter's end, so that a full disk is an error like others.
        sys.stdout.flush()
        return status
    except InputError as error:
        return _said(name, _with_option(error), 2)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in ("", *OWN):
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
    from commands import data, device, lab, learning, studies
    from commands.arguments import add_commands

    top = argparse.ArgumentParser(prog="softslide", description=(__doc__ or "").partition("\n")[0])
    top.add_argument(
        "--version", action="version", version=f"softslide {__version__}", help="show the version and exit"
    )
    add_commands(
        top, (*learning.COMMANDS, *device.COMMANDS, *data.COMMANDS, *lab.COMMANDS, *studies.COMMANDS)
    )
    return top


def _with_option(error: InputError) -> str:
    """The error's message; a parameter that it begins with is shown as the option of that name."""
    if not error.parameter:
        return str(error)
    return "--" + error.parameter.replace("_", "-") + str(error).removeprefix(error.parameter)


def _said(command: str, text: str, status: int) -> int:
    print(f"softslide {command}: {text}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
