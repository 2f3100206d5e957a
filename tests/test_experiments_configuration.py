"""A configuration file changes what it names and refuses what it does not know."""

import re
from dataclasses import dataclass, field, fields
from pathlib import Path

import pytest

import softslide
from softslide.experiments.configuration import configured
from softslide.features.errors import InputError
from softslide.models.registry import MODELS, model_named


@dataclass(frozen=True)
class Inner:
    rate: float = 0.1
    sizes: tuple[int, int] = (3, 4)

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise ValueError(f"rate is {self.rate}; it must be positive")


@dataclass(frozen=True)
class Outer:
    steps: int = 10
    name: str = "n"
    layers: tuple[int, ...] = (64, 64)
    inner: Inner = field(default_factory=Inner)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "config.toml"
    path.write_text(text)
    return path


def test_a_file_changes_what_it_names(tmp_path: Path) -> None:
    path = written(tmp_path, "steps = 7\nlayers = [8]\n[inner]\nrate = 2\nsizes = [5, 6]\n")
    assert configured(Outer(), path, "outer") == Outer(7, "n", (8,), Inner(2.0, (5, 6)))
    assert configured(Outer(), None, "outer") == Outer()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("stepps = 7", "unknown key 'stepps'; known are steps, name, layers, inner"),
        ("[inner]\nrat = 7", "inner: unknown key 'rat'"),
        ("steps = 0.5", "steps is 0.5; write one like 10"),
        ("layers = [8, 'x']", "layers is 'x'"),
        ("steps = true", "steps is True"),
        ("name = 3", "name is 3"),
        ("inner = 3", "inner is 3"),
        ("[inner]\nrate = -1.0", "inner: rate is -1.0; it must be positive"),
        ("[inner]\nsizes = [1, 'x']", "sizes is 'x'"),
        ("[inner]\nsizes = [1]", "sizes holds 1, not 2"),
        ("steps = ", "not a TOML file"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, says: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        configured(Outer(), path, "outer")
    assert str(error.value).startswith(str(path))
    assert says in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        configured(Outer(), tmp_path / "none.toml", "outer")


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_template_is_the_default_of_every_key(
    tmp_path: Path, model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert softslide.main(["train", "--config-template", "--model", model]) == 0
    text = capsys.readouterr().out
    (tmp_path / "c.toml").write_text(text)
    default = model_named(model).config()
    assert configured(default, tmp_path / "c.toml", model) == default
    assert {f.name for f in fields(default)} <= set(re.findall(r"^\[?(\w+)", text, re.MULTILINE))
