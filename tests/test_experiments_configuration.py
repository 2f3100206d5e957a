"""A configuration file changes what it names and refuses what it does not know."""

import re
from dataclasses import fields, replace
from pathlib import Path

import pytest
from front_door import call

from softslide.experiments.configuration import configured
from softslide.features.errors import InputError
from softslide.models.registry import MODELS, model_named

DEFAULT = model_named("cnn").config()


def of_file(tmp_path: Path, text: str) -> object:
    path = tmp_path / "config.toml"
    path.write_text(text)
    return configured(DEFAULT, path, "cnn")


def test_a_file_changes_what_it_names(tmp_path: Path) -> None:
    found = of_file(tmp_path, "[training]\nsteps = 7\n")
    assert found == replace(DEFAULT, training=replace(DEFAULT.training, steps=7))
    assert configured(DEFAULT, None, "cnn") == DEFAULT


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[trainin]\nsteps = 7", ": unknown key 'trainin'; known are "),
        ("[training]\nsteps = 0.5", f": training: steps is 0.5; write one like {DEFAULT.training.steps}"),
        ("[training]\nsteps = 0", ": training: steps "),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, says: str) -> None:
    """More of this is tested where tables are read (test_pipeline_toml_tables.py)."""
    with pytest.raises(InputError) as error:
        of_file(tmp_path, text)
    assert str(error.value).startswith(f"{tmp_path / 'config.toml'}{says}")
    assert "\n" not in str(error.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        configured(DEFAULT, tmp_path / "none.toml", "cnn")


@pytest.mark.parametrize("model", sorted(MODELS))
def test_the_template_is_the_default_of_every_key(
    tmp_path: Path, model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("train", "--config-template", "--model", model) == 0
    text = capsys.readouterr().out
    (tmp_path / "c.toml").write_text(text)
    default = model_named(model).config()
    assert configured(default, tmp_path / "c.toml", model) == default
    assert {f.name for f in fields(default)} <= set(re.findall(r"^\[?(\w+)", text, re.MULTILINE))
