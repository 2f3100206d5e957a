"""TOML to frozen dataclasses: a file's table becomes the dataclass whose fields it names, or one line says why not.

A field's type hint says what its key may hold: `float` (a whole number does), `int`, `bool`, `str`, another dataclass
(a table), `dict[str, X]` (a table of any keys), `tuple[X, ...]` and `tuple[X, Y]` (a list), and unions of these. A
field whose key in the file has another name carries it as `field(metadata={"key": NAME})`.
"""

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from softslide.features.errors import InputError
from softslide.features.regular_file import read_regular

# A hundred times the largest map or design that a person writes; beyond it the file is something else.
MOST_BYTES = 1 << 20
DEEPEST = 16
# TOML 1.0, "Integer": 64-bit signed; what does not fit is an error.
INTEGER_END = 1 << 63
# No quantity of a sensor or a training comes near it, and its square is finite.
LARGEST = 1e15
WORDS = {float: "a number", int: "a whole number", str: "a text in quotes", bool: "true or false"}

T = TypeVar("T")


def read_toml(path: Path, remedy: str = "name a TOML file") -> dict[str, Any]:
    """The file's table; all its numbers are finite, its integers fit 64 bits.

    remedy: what to do when there is no such file.

    Raises:
        InputError: no regular file, larger than `MOST_BYTES`, no TOML, nested deeper than `DEEPEST`, or a number
            that is not finite, or an integer beyond 64 bits.
    """
    content = read_regular(path, MOST_BYTES, remedy)
    try:
        table = tomllib.loads(content.decode("utf-8-sig"))
    except RecursionError:
        raise InputError(f"{path}: nested too deep; at most {DEEPEST} levels are read") from None
    except ValueError as error:  # of syntax, of encoding, or a number of thousands of digits
        raise InputError(f"{path}: not a TOML file ({error}); correct its syntax") from None
    for keys, value in _leaves(table):
        place = f"{path}: {': '.join(map(_bare, keys[:DEEPEST]))}"
        if len(keys) > DEEPEST:
            raise InputError(f"{place}: nested too deep; at most {DEEPEST} levels are read")
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{place} is {value}; write a finite number")
        if isinstance(value, int) and not -INTEGER_END <= value < INTEGER_END:
            raise InputError(f"{place} is an integer beyond 64 bits; write a smaller one")
    return table


def from_table(kind: type[T], table: Any, place: str, default: T | None = None, **given: Any) -> T:
    """A dataclass from a TOML table; `place` (the file, and the keys down to the table) opens an error's message.

    default: an instance whose values hold where the table has no key. given: fields that the program sets; for a file
    their keys are unknown.

    Raises:
        InputError: no table, an unknown or a missing key, a value of another type, or one that the dataclass
            refuses with a ValueError.
    """
    if not isinstance(table, Mapping):
        raise InputError(f"{place} is {_shown(table)}; write a table, its keys under a [heading]")
    known = {f.metadata.get("key", f.name): f for f in fields(kind) if f.name not in given}  # type: ignore[arg-type]
    for key in table:
        if key not in known:
            raise InputError(f"{place}: unknown key {key!r}; known are {', '.join(known) or 'none'}")
    for key, field in known.items():
        is_required = field.default is MISSING and field.default_factory is MISSING
        if key not in table and default is None and is_required:
            raise InputError(f"{place}: {key} is missing; add it")
    hints = get_type_hints(kind)
    values = {
        known[key].name: _value(
            hints[known[key].name], value, f"{place}: {key}", getattr(default, known[key].name, None)
        )
        for key, value in table.items()
    }
    try:
        return kind(**values, **given) if default is None else replace(default, **values, **given)  # type: ignore[type-var]
    except ValueError as error:
        raise InputError(f"{place}: {error}") from None


def changed(default: T, table: Any, place: str) -> T:
    """The default with the table's values in its place.

    Raises:
        InputError: as `from_table`.
    """
    return from_table(type(default), table, place, default)


def _value(hint: Any, value: Any, place: str, default: Any) -> Any:
    """The value as the hint's type; default: the field's value so far, or None."""
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return _one_of(args, value, place, default)
    if is_dataclass(hint) and isinstance(hint, type):
        return from_table(hint, value, place, default if isinstance(default, hint) else None)
    if origin is tuple and isinstance(value, list | tuple):
        if args[1:] == (...,):
            rows = is_dataclass(args[0])
            return tuple(
                _value(args[0], v, f"{place} {n}" if rows else place, None) for n, v in enumerate(value, 1)
            )
        if len(value) != len(args):
            count = {2: "two", 3: "three", 4: "four"}.get(len(args), len(args))
            raise InputError(f"{place} holds {len(value)}, not {len(args)}; write {count} values in brackets")
        return tuple(_value(h, v, place, None) for h, v in zip(args, value, strict=True))
    if origin is dict and isinstance(value, Mapping):
        return {key: _value(args[1], v, f"{place}.{_bare(key)}", None) for key, v in value.items()}
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        if abs(value) > LARGEST:
            raise InputError(f"{place} is {_shown(value)}; write a number below {LARGEST:g}")
        return float(value)
    if hint in (int, str, bool) and type(value) is hint:
        return value
    raise InputError(f"{place} is {_shown(value)}; write {_wish(hint, default)}")


def _one_of(hints: tuple[Any, ...], value: Any, place: str, default: Any) -> Any:
    """The value as the first of a union's types that takes it; a file has no None."""
    *others, last = [hint for hint in hints if hint is not NoneType]
    for hint in others:
        try:
            return _value(hint, value, place, default)
        except InputError:
            continue
    return _value(last, value, place, default)


def _wish(hint: Any, default: Any) -> str:
    """What a value should look like, in words."""
    if default is not None:
        return f"one like {_shown(default)}"
    if hint in WORDS:
        return WORDS[hint]
    if is_dataclass((get_args(hint) or (None,))[0]):
        return "tables, each under a [[heading]] of this name"
    return "a table" if get_origin(hint) is dict else "a list in brackets"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _bare(key: str) -> str:
    """A key as it stands in a file: without quotes if it needs none."""
    return key if key.replace("_", "").replace("-", "").isalnum() else repr(key)


def _leaves(table: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every value that is not a table or list, with its keys; without recursion, whatever the file's depth."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), table)]
    while waiting:
        keys, value = waiting.pop()
        if len(keys) > DEEPEST or not isinstance(value, dict | list):
            yield keys, value
        elif isinstance(value, dict):
            waiting += [((*keys, key), item) for key, item in value.items()]
        else:
            waiting += [((*keys, str(n)), item) for n, item in enumerate(value, 1)]
