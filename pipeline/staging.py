"""Write beside, then rename: a reader sees the whole output or none of it."""

import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from features.errors import InputError


@contextmanager
def staged(out: Path) -> Iterator[Path]:
    """A temporary folder beside `out` that becomes `out` when the block ends well, and vanishes when not.

    An `out` that exists already is replaced, so that a command can be run again, but only if it holds nothing
    that the new one does not.

    Raises:
        InputError: `out` is a file or holds other files, or its parent cannot be written.
    """
    check_replaceable(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror}); name another folder") from None
    scratch.chmod(0o755)
    try:
        yield scratch
        if out.exists():
            check_replaceable(out, {path.name for path in scratch.iterdir()})
            retired = Path(tempfile.mkdtemp(prefix=f".{out.name}.old.", dir=out.parent))
            os.replace(out, retired / out.name)
            os.replace(scratch, out)
            shutil.rmtree(retired)
        else:
            os.replace(scratch, out)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def check_replaceable(out: Path, names: Collection[str] | None = None) -> None:
    """Sees that nothing would be lost if `out` became a folder of these names (of any, if None).

    Raises:
        InputError: `out` is a file, or a folder that holds anything else: it was named by mistake.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: a file of this name is in the way; name a folder")
    if names is not None and out.exists():
        foreign = {path.name for path in out.iterdir()} - set(names)
        if foreign:
            raise InputError(f"{out}: holds other files ({min(foreign)}); name a new folder")
