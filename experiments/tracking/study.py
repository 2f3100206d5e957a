"""A study as runs: one of the whole, and below it one for each of its parts."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

from experiments.tracking.run import Run, finite, tracked

# Logs a part: its name, what was set in it, and its figures.
Part = Callable[[str, Mapping[str, Any], Mapping[str, float]], None]


@contextmanager
def tracked_study(
    command: str,
    name: str,
    configuration: Mapping[str, Any],
    beside: Path,
    *,
    tags: Mapping[str, str] | None = None,
    store: str | None = None,
) -> Iterator[tuple[Run, Part]]:
    """The run of a study, and what logs a part of it as a run below. Arguments are those of `tracked`."""
    own = {**(tags or {}), "study": uuid4().hex}
    with tracked(command, name, configuration, beside, tags=own, store=store) as run:

        def part(of: str, settings: Mapping[str, Any], figures: Mapping[str, float]) -> None:
            parent = {"study": own["study"], "command": command}
            with tracked(
                f"{command} part", of, settings, beside, tags=own, parent=parent, store=store
            ) as child:
                child.metrics(finite(figures))

        yield run, part
