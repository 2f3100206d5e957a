"""Write next to the place, then rename: a reader sees the whole output or none of it.

A process that is killed leaves its folder behind; the next one that writes the same output removes it.
"""

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from glob import escape
from pathlib import Path

from softslide.features.errors import InputError

# A folder next to `out` holds `new` while that is written, and `old` while `out` is replaced.
UNFINISHED = ".unfinished-"
FULL = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def writing(place: Path, instead: str = "name another folder") -> Iterator[None]:
    """The block writes `place`. instead: what to do where it cannot be written.

    Raises:
        InputError: it cannot be written, whatever space there is.
        OSError: its disk is full, which is not the input's fault.
    """
    try:
        yield
    except OSError as error:
        if error.errno in FULL:
            raise OSError(error.errno, os.strerror(error.errno), str(place)) from None
        raise InputError(f"{place}: cannot be written ({error.strerror}); {instead}") from None


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A file next to `path` that becomes `path` when the block ends well, and vanishes when not."""
    scratch = path.with_name(f".{path.name}.partial")
    # What another process left there, or a link to elsewhere.
    scratch.unlink(missing_ok=True)
    try:
        yield scratch
        scratch.replace(path)
    finally:
        scratch.unlink(missing_ok=True)


@contextmanager
def staged(out: Path) -> Iterator[Path]:
    """A temporary folder next to `out` that becomes `out` when the block ends well, and vanishes when not.

    An `out` that exists already is replaced, so that a command can be run again, but only if it holds nothing
    that the new one does not.

    Raises:
        InputError: `out` is a file or holds other files, or its parent cannot be written.
    """
    check_replaceable(out)
    with ExitStack() as stack:
        with writing(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            with locked(out.parent):
                _clear_leftovers(out)
                room = Path(tempfile.mkdtemp(prefix=f".{out.name}{UNFINISHED}", dir=out.parent))
                stack.enter_context(locked(room))
        stack.callback(_remove, room, out)
        new = room / "new"
        with writing(out):
            new.mkdir()
        yield new
        # Another process may replace the same output at the same time.
        with locked(out.parent):
            if out.exists():
                check_replaceable(out, {path.name for path in new.iterdir()})
                os.replace(out, room / "old")
            os.replace(new, out)


def check_replaceable(out: Path, names: Collection[str] | None = None) -> None:
    """Sees that `out` can be written, and that nothing would be lost if it became a folder of these names (of any, if
    None). Long work asks this before it begins.

    Raises:
        InputError: `out` is where nothing can be written, a file, or a folder that holds anything else: it was named by
            mistake.
    """
    above = next((folder for folder in out.absolute().parents if folder.exists()), out)
    if not (above.is_dir() and os.access(above, os.W_OK)):
        raise InputError(f"{out}: cannot be written; name another folder")
    try:
        # Looked at once: another process may replace it between two looks.
        folder = stat.S_ISDIR(out.stat().st_mode)
    except OSError:
        return  # not there, or where nothing can be written either
    if not folder:
        raise InputError(f"{out}: a file of this name is in the way; name a folder")
    if names is not None:
        foreign = {path.name for path in out.iterdir()} - set(names)
        if foreign:
            raise InputError(f"{out}: holds other files ({min(foreign)}); name a new folder")


def _clear_leftovers(out: Path) -> None:
    """Removes what processes left that were killed."""
    for room in out.parent.glob(f".{escape(out.name)}{UNFINISHED}*"):
        with suppress(BlockingIOError), locked(room, wait=False) as is_ours:
            if is_ours:
                _remove(room, out)


def _remove(room: Path, out: Path) -> None:
    """Removes the folder; an `out` that was moved away and not yet replaced is put back."""
    if (room / "new").exists() and not out.exists():
        with suppress(FileNotFoundError):
            os.replace(room / "old", out)
    shutil.rmtree(room, ignore_errors=True)


@contextmanager
def locked(folder: Path, wait: bool = True) -> Iterator[bool]:
    """Keeps other processes from the block, until it or this process ends; gives whether there are such locks here (not
    on Windows and some network disks).

    Raises:
        BlockingIOError: another process has the folder, and this one does not wait.
    """
    try:
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield False
        return
    try:
        is_ours = True
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            raise
        except OSError:
            is_ours = False
        yield is_ours
    finally:
        os.close(descriptor)


@contextmanager
def alone(work: Path, out: Path) -> Iterator[None]:
    """The folder `work`, of what is done for `out`, for this process alone, where there are locks. It is made first,
    and removed where it is left empty.

    Raises:
        InputError: another process works on `out`, or the folder cannot be made.
    """
    if work.is_symlink():
        raise InputError(f"{work}: is a link, and work on {out} goes there; take it away")
    with writing(out):
        work.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        try:
            stack.enter_context(locked(work, wait=False))
        except BlockingIOError:
            raise InputError(
                f"{out}: another call is at work on it; wait for it, or name another folder"
            ) from None
        try:
            yield
        finally:
            with suppress(OSError):
                work.rmdir()
