"""What numbers settings may be: what lies outside fails later, in a library's words, or never ends."""

import math
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

# What random generators of numpy, scikit-learn and torch take alike.
SEED = (0, 2**32 - 1)
SHARE = (0.0, 1.0)
# A quantity of any unit that is not zero, and one that may be.
POSITIVE = (1e-12, 1e12)
SIZE = (0.0, 1e12)


def check_ranges(settings: Any, **ranges: tuple[float, float]) -> None:
    """Sees that settings, and each number of those that are tuples, lie within their bounds, both included.

    Raises:
        ValueError: the first that does not.
    """
    for name, (low, high) in ranges.items():
        value = getattr(settings, name)
        for each in value if isinstance(value, tuple) else (value,):
            if not low <= each <= high:
                raise ValueError(f"{name} is {each}; it must lie between {low:g} and {high:g}")


def check_positive(settings: Any, *names: str) -> None:
    """Sees that these settings, and each number of those that are tuples, are above 0.

    Raises:
        ValueError: the first that is not.
    """
    for name in names:
        value = getattr(settings, name)
        if not all(each > 0 for each in (value if isinstance(value, tuple) else (value,))):
            shown = list(value) if isinstance(value, tuple) else value
            raise ValueError(f"{name} is {shown}; it must be positive")


def check_one_of(known: Sequence[str], **settings: str) -> None:
    """Sees that each setting is one of these words.

    Raises:
        ValueError: the first that is not.
    """
    for name, value in settings.items():
        if value not in known:
            raise ValueError(f"{name} is '{value}'; it must be one of {', '.join(known)}")


def check_pairs(settings: Any, least: float = -math.inf) -> None:
    """Sees that every tuple of a dataclass rises, or stays, from at least `least`.

    Raises:
        ValueError: the first that does not.
    """
    for field in fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, tuple) and not (value[0] >= least and value[0] <= value[-1]):
            below = "" if least < 0 else " and not be negative"
            raise ValueError(f"{field.name} is {list(value)}; it must rise{below}")
