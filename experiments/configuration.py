"""Configuration files: a frozen dataclass with a model's defaults, and the TOML that changes some of them."""

from pathlib import Path
from typing import TypeVar

from pipeline.toml_tables import changed, read_toml

Config = TypeVar("Config")


def configured(default: Config, path: Path | None) -> Config:
    """The default with the file's values in its place; a table of the file is a dataclass inside `default`.

    Raises:
        InputError: no such file, no TOML, an unknown key, a value of another type or out of range.
    """
    return default if path is None else changed(default, read_toml(path), str(path))
