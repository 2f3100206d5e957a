"""Configuration files: a model's defaults, a frozen dataclass, and the file that changes some of them."""

import json
from pathlib import Path
from typing import Any, TypeVar

from softslide.features.errors import InputError
from softslide.features.regular_file import read_regular
from softslide.pipeline.toml_tables import changed, read_toml

Config = TypeVar("Config")
# A run's configuration has some hundred numbers.
MOST_BYTES = 1 << 20


def configured(default: Config, path: Path | None, model: str) -> Config:
    """The default with the file's values in its place; a table of the file is a dataclass inside `default`.

    path: TOML with some of the values, or `configuration.json` of a run of this model, which holds all of them.

    Raises:
        InputError: no such file, another format, an unknown key, a value of another type or out of range, or a run of
            another model.
    """
    if path is None:
        return default
    if path.suffix != ".json":
        return changed(default, read_toml(path), str(path))
    run = read_configuration(path)
    if run.get("model") != model:
        raise InputError(
            f"{path}: of a run of {run.get('model')}, not {model}; train that model, or name another file"
        )
    return changed(default, run.get("settings"), f"{path}: settings")


def read_configuration(path: Path) -> dict[str, Any]:
    """What a run's `configuration.json` holds.

    Raises:
        InputError: no such file, or no JSON table.
    """
    try:
        table = json.loads(read_regular(path, MOST_BYTES, "name a run's configuration.json"))
    except InputError:
        raise
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not a JSON file; name a run's configuration.json") from None
    if not isinstance(table, dict):
        raise InputError(f"{path}: no table; name a run's configuration.json")
    return table
