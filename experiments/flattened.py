"""Tables within tables as one, whose keys say where each value stood."""

from collections.abc import Mapping
from typing import Any

import pandas as pd


def flattened(table: Mapping[str, Any], separator: str = ".") -> dict[str, Any]:
    """Nested keys joined by a separator."""
    (row,) = pd.json_normalize(dict(table), sep=separator).to_dict("records")
    return {str(key): value for key, value in row.items()}
