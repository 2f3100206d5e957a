"""Configuration files: a model's defaults, a frozen dataclass, and the file that changes some of them."""

import inspect
import json
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from softslide.features.errors import InputError
from softslide.features.regular_file import read_regular
from softslide.models.registry import model_named
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
    content = read_regular(path, MOST_BYTES, "name a run's configuration.json")
    try:
        table = json.loads(content)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not a JSON file; name a run's configuration.json") from None
    if not isinstance(table, dict):
        raise InputError(f"{path}: no table; name a run's configuration.json")
    return table


def configuration_template(model: str) -> str:
    """A model's whole configuration as TOML, each key with its default, below what the code says of each table.

    Raises:
        InputError: no such model.
    """
    return f"# softslide train --model {model} --config THIS.toml; leave out what stays.\n" + "\n".join(
        _table(model_named(model).config(), ())
    )


def _table(settings: Any, keys: tuple[str, ...]) -> list[str]:
    """The lines of one table and of those inside it. A value that is None, "as the code finds it", is left out."""
    values = {f.name: getattr(settings, f.name) for f in fields(settings)}
    inside = {name: value for name, value in values.items() if is_dataclass(value)}
    plain = {n: value for n, value in values.items() if n not in inside and value is not None}
    says = (inspect.getdoc(settings) or "").partition("\n\nRaises:")[0]
    lines = ["", *(f"# {line}".rstrip() for line in says.splitlines())]
    lines += [f"[{'.'.join(keys)}]"] * bool(keys) + tomli_w.dumps(plain).splitlines()
    return lines + [line for name, value in inside.items() for line in _table(value, (*keys, name))]
