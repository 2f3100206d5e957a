"""A sweep's TOML: model and data, budget, and the search space of its settings.

model = "trees"
recordings = "my-recordings"                # from the folder that the command runs in, as on the line
[budget]
trials = 40
[settings]                                  # as for `train --config`: they hold in every trial
seed = 1
[space]                                     # the same keys, each a range or a list of choices
trees = { low = 50, high = 400, log = true }
least_leaf = [2, 4, 8]
"""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from features.errors import InputError
from models.registry import model_named
from pipeline.toml_tables import changed, read_toml

KEYS = {"model": str, "recordings": str, "space": dict, "atlas": str, "budget": dict, "settings": dict}
NEEDED = ("model", "recordings", "space")


@dataclass(frozen=True)
class Budget:
    """trials: in all, those of an earlier call included. seconds: of one call, after which no trial begins.
    workers: processes. prune: whether trials of cnn that are hopeless at a third or two of their training are given up
    (experiments/sweep/trial.py)."""

    trials: int = 40
    seconds: float = 3600.0
    workers: int = 2
    prune: bool = True

    def __post_init__(self) -> None:
        if self.trials < 1 or self.workers < 1 or not self.seconds > 0:
            raise ValueError("budget needs at least one trial and one worker, and some seconds")


@dataclass(frozen=True)
class Sweep:
    """settings: a table as of `train --config`. space: by dotted key; a choice is the JSON text of its value."""

    place: str
    model: str
    recordings: Path
    atlas: Path | None
    budget: Budget
    settings: dict[str, Any]
    space: dict[str, BaseDistribution]

    def as_table(self) -> dict[str, Any]:
        """The search as JSON takes it: a run's configuration."""
        return {
            "model": self.model,
            "recordings": str(self.recordings),
            "atlas": None if self.atlas is None else str(self.atlas),
            "budget": asdict(self.budget),
            "settings": self.settings,
            "space": {key: repr(values) for key, values in self.space.items()},
        }

    def table(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """The settings with one trial's parameters among them, as a table of `train --config`."""
        merged = json.loads(json.dumps(self.settings))
        for key, value in parameters.items():
            *tables, last = key.split(".")
            inner = merged
            for name in tables:
                inner = inner.setdefault(name, {})
            inner[last] = json.loads(value) if isinstance(value, str) else value
        return merged

    def configuration(self, parameters: Mapping[str, Any]) -> Any:
        """The model's configuration in one trial.

        Raises:
            InputError: these values do not go together.
        """
        return changed(model_named(self.model).config(), self.table(parameters), self.place)


def read_sweep(path: Path) -> Sweep:
    """Reads and checks a sweep: every end of a range and every choice has to be one that the model takes.

    Raises:
        InputError: no such file, no TOML, an unknown or missing key, a value or a range that does not fit.
    """
    table = read_toml(path)
    if unknown := [key for key in table if key not in KEYS]:
        raise InputError(f"{path}: unknown key '{unknown[0]}'; known are {', '.join(KEYS)}")
    for key, kind in KEYS.items():
        if (key in NEEDED and not table.get(key)) or not isinstance(table.get(key, kind()), kind):
            wish = "a table" if kind is dict else "a text"
            raise InputError(f"{path}: '{key}' is missing or empty, or not {wish}; write one")
    default = changed(model_named(table["model"]).config(), table.get("settings", {}), f"{path}: settings")
    sweep = Sweep(
        place=str(path),
        model=table["model"],
        recordings=Path(table["recordings"]),
        atlas=Path(table["atlas"]) if "atlas" in table else None,
        budget=changed(Budget(), table.get("budget", {}), f"{path}: budget"),
        settings=table.get("settings", {}),
        space=_space(table["space"], default, f"{path}: space"),
    )
    for key, distribution in sweep.space.items():
        for value in _ends(distribution):
            sweep.configuration({key: value})
    return sweep


def _space(
    table: Mapping[str, Any], default: Any, place: str, prefix: str = ""
) -> dict[str, BaseDistribution]:
    space: dict[str, BaseDistribution] = {}
    for key, said in table.items():
        here = f"{place}: {prefix}{key}"
        if not hasattr(default, key):
            raise InputError(f"{here}: the model has no such setting; known are {', '.join(vars(default))}")
        value = getattr(default, key)
        if is_dataclass(value) and isinstance(said, Mapping):
            space |= _space(said, value, place, f"{prefix}{key}.")
        elif isinstance(said, list) and said:
            space[prefix + key] = CategoricalDistribution([json.dumps(choice) for choice in said])
        else:
            space[prefix + key] = _range(said, value, here)
    return space


def _range(said: Any, value: Any, place: str) -> BaseDistribution:
    wish = (
        "write { low = 1, high = 10 }, with log = true for equal steps of its logarithm, or a list of choices"
    )
    if not isinstance(said, Mapping) or {"low", "high"} - set(said) or set(said) - {"low", "high", "log"}:
        raise InputError(f"{place} is {said!r}; {wish}")
    low, high, log = said["low"], said["high"], said.get("log", False)
    kinds = int if isinstance(value, int) else int | float
    for number in (low, high):
        if isinstance(number, bool) or not isinstance(number, kinds) or not math.isfinite(number):
            raise InputError(f"{place} has {number!r} for an end; write a number like {value!r}")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{place} is no number but {value!r}; write a list of choices")
    if not isinstance(log, bool) or low > high or (log and low <= 0):
        raise InputError(f"{place}: low {low}, high {high}, log {log} is no range; {wish}")
    if isinstance(value, int):
        return IntDistribution(low, high, log=log)
    return FloatDistribution(float(low), float(high), log=log)


def _ends(distribution: BaseDistribution) -> tuple[Any, ...]:
    if isinstance(distribution, CategoricalDistribution):
        return distribution.choices
    assert isinstance(distribution, IntDistribution | FloatDistribution)
    return distribution.low, distribution.high
