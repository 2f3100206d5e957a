"""Reads a file whole, if it is a regular one and not too large: a pipe would wait for ever, a device never ends."""

import os
import stat
from pathlib import Path

from softslide.features.errors import InputError


def read_regular(path: Path, most_bytes: int, remedy: str) -> bytes:
    """The file's content; links to regular files are followed. remedy: what an error's message says to do.

    Raises:
        InputError: no such file, not a regular file, more than `most_bytes`, or it cannot be read.
    """
    return _content(path, most_bytes, remedy, most_bytes + 1)


def check_regular(path: Path, most_bytes: int, remedy: str) -> None:
    """Refuses what `read_regular` would, for a library that reads the file itself.

    Raises:
        InputError: as `read_regular`.
    """
    _content(path, most_bytes, remedy, 0)


def _content(path: Path, most_bytes: int, remedy: str, count: int) -> bytes:
    """So many bytes of the file, fewer where it ends."""
    # Without waiting: to open a pipe that nobody writes to would block.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags)
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise InputError(f"{path}: not a regular file; {remedy}")
            content = b"" if status.st_size > most_bytes else _read(descriptor, count)
        finally:
            os.close(descriptor)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {remedy}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {remedy}") from None
    if max(status.st_size, len(content)) > most_bytes:
        raise InputError(f"{path}: larger than {most_bytes / 1e6:.3g} MB; {remedy}")
    return content


def _read(descriptor: int, count: int) -> bytes:
    parts, left = [], count
    while left and (part := os.read(descriptor, min(left, 1 << 20))):
        parts.append(part)
        left -= len(part)
    return b"".join(parts)
