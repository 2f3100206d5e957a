"""Settings of the models: what no training can be made with is refused before it, in one line."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import pytest

from softslide.features.errors import InputError
from softslide.models.registry import MODELS, model_named
from softslide.pipeline.toml_tables import changed

WRONG = (float("nan"), float("inf"), -1e300, 1e300)


def numbers(settings: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The keys of each number, or tuple of numbers, of a configuration, and its default."""
    for field in fields(settings):
        value = getattr(settings, field.name)
        if is_dataclass(value):
            yield from numbers(value, (*keys, field.name))
        elif not isinstance(value, str):
            yield (*keys, field.name), value


def table(keys: tuple[str, ...], value: Any) -> dict[str, Any]:
    for key in reversed(keys):
        value = {key: value}
    return value


@pytest.mark.parametrize("model", MODELS)
def test_no_setting_is_beyond_its_range(model: str) -> None:
    default = model_named(model).config()
    for keys, value in numbers(default):
        for wrong in WRONG:
            for given in (wrong, int(wrong)) if abs(wrong) == 1e300 else (wrong,):
                bad = [given] * len(value) if isinstance(value, tuple) else given
                with pytest.raises(InputError, match=keys[-1]):
                    changed(default, table(keys, bad), "settings")


@pytest.mark.parametrize(
    ("model", "settings"),
    [
        ("mlp", {"members": 0}),
        ("mlp", {"hidden": []}),
        ("mlp", {"hidden": [64, 0]}),
        ("trees", {"least_leaf": 0}),
        ("trees", {"seed": -1}),
        ("gp", {"search_rows": 0}),
        *(("gp", {"training": {"recorded_share": share}}) for share in (0.0, -0.1, 1.1)),
        ("cnn", {"training": {"steps": 0}}),
        ("cnn", {"training": {"average": 1.0}}),
        ("cnn", {"network": {"hidden": [96, -1]}}),
        ("cnn", {"synthesis": {"speed_mm_s": [60.0, 0.3]}}),
    ],
)
def test_what_cannot_be_learnt_with_is_refused(model: str, settings: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        changed(model_named(model).config(), settings, "settings")
