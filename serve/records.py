"""An estimate as a JSON record."""

import json
import math
from typing import Any

from softslide.features.estimate import RECORDED, Estimate


def record(estimate: Estimate) -> dict[str, Any]:
    """The estimate's fields by name; None: not estimated, since JSON has no NaN."""
    fields = {name: _plain(getattr(estimate, name)) for name in RECORDED if name != "places"}
    return {**fields, "places": [place._asdict() for place in estimate.places]}


def as_json(estimate: Estimate) -> str:
    """The record as a line of JSON."""
    return json.dumps(record(estimate), allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, str | bool | int):
        return value
    number = float(value)
    return number if math.isfinite(number) else None
