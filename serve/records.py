"""An estimate as a record for JSON."""

import math
from dataclasses import fields
from typing import Any

from features.estimate import Estimate

_NAMES = tuple(field.name for field in fields(Estimate))


def record(estimate: Estimate) -> dict[str, Any]:
    """Names with units and numbers; None where not estimated, since JSON knows no NaN."""
    return {name: _plain(getattr(estimate, name)) for name in _NAMES}


def _plain(value: Any) -> Any:
    if isinstance(value, str | bool | int):
        return value
    number = float(value)
    return number if math.isfinite(number) else None
