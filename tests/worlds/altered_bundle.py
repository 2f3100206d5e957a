"""A bundle that may have been altered: what it answers, or that it is refused."""

from pathlib import Path
from typing import Any

from streams import pass_over, still, stream

from softslide.features.errors import InputError
from softslide.serve.localizer import Localizer

VOLTS = stream(still(0.6), pass_over(1.0), still(0.4))


def answers(bundle: Path, unsigned: bool = False) -> list[Any]:
    return [repr(estimate) for estimate in Localizer.load(bundle, unsigned=unsigned).push(VOLTS)]


def taken(bundle: Path, unsigned: bool = False) -> list[Any] | None:
    """What the bundle answers; None where it is refused with one line that names it."""
    try:
        return answers(bundle, unsigned)
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    assert str(bundle) in said
    assert len(said) < 500 + len(str(bundle))
    return None
