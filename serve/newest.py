"""A queue whose reader may be slow: the newest are kept, and whoever writes never waits."""

from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TypeVar

T = TypeVar("T")


def put_newest(waiting: SimpleQueue[T], item: T, most: int) -> bool:
    """Puts an item where at most so many wait, the oldest dropped for it; whether one was."""
    full = waiting.qsize() >= most
    if full:
        with suppress(Empty):
            waiting.get_nowait()
    waiting.put(item)
    return full
