"""Configuration files: a frozen dataclass with a model's defaults, and the TOML that changes some of them."""

import tomllib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from features.errors import InputError

Config = TypeVar("Config")


def configured(default: Config, path: Path | None) -> Config:
    """The default with the file's values in its place; a table of the file is a dataclass inside `default`.

    Raises:
        InputError: no such file, no TOML, an unknown key, a value of another type or out of range.
    """
    return default if path is None else changed(default, read_toml(path), str(path))


def read_toml(path: Path) -> dict[str, Any]:
    """The file's table.

    Raises:
        InputError: no such file, no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); name a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file ({error}); mend its syntax") from None


def changed(default: Config, table: Mapping[str, Any], place: str) -> Config:
    """The default with the table's values in its place; `place` opens the message of an error.

    Raises:
        InputError: as in `configured`.
    """
    known = {field.name: field for field in fields(default)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in known:
            raise InputError(f"{place}: unknown key '{key}'; known are {', '.join(known) or 'none'}")
        any_length = Ellipsis in get_args(known[key].type)
        values[key] = _fitting(getattr(default, key), value, f"{place}: {key}", any_length)
    try:
        return replace(default, **values)  # type: ignore[type-var]
    except ValueError as error:
        raise InputError(f"{place}: {error}") from None


def _fitting(default: Any, value: Any, place: str, any_length: bool = False) -> Any:
    """The value, of the default's type; a whole number does for a float, a list for a tuple.

    any_length: a list need not be as long as the default, whose first item then says what it holds.
    """
    if is_dataclass(default) and isinstance(value, Mapping):
        return changed(default, value, place)
    if isinstance(default, tuple) and isinstance(value, list):
        if any_length:
            return tuple(_fitting(default[0], v, place) for v in value)
        if len(value) != len(default):
            raise InputError(f"{place} holds {len(value)}, not {len(default)}; write as many as in {default}")
        return tuple(_fitting(d, v, place) for d, v in zip(default, value, strict=True))
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if default is not None and type(value) is not type(default):
        raise InputError(f"{place} is {value!r}; write one like {default!r}")
    return value
