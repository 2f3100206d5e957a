"""What numbers settings may be: what lies outside fails later, in a library's words, or never ends."""

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
