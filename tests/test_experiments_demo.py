"""The demo: what it shortens, and the page that it keeps."""

import html
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from small_bundle import write_small_bundle
from trial_folder import SENSOR, a_folder

import softslide
from softslide.experiments import demo
from softslide.experiments.demo import DEMO_MODELS, shortened
from softslide.experiments.evaluate import evaluate
from softslide.models.registry import model_named


@pytest.mark.parametrize("model", DEMO_MODELS)
def test_the_demo_shortens_what_trains_in_steps_alone(model: str) -> None:
    default = model_named(model).config()
    changed = shortened(default)
    if model == "cnn":
        assert changed.training.steps < default.training.steps
        default = replace(default, training=changed.training)
    assert changed == default


def test_the_demo_keeps_its_table_and_the_way_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", SENSOR, offset_mm_per_v=50.0)
    lab = a_folder(tmp_path / "lab", one={}, two={"offset_mm": -8.0}).root
    done = evaluate(bundle, lab, None, tmp_path / "results", jobs=1, report=False, track=False)
    monkeypatch.setattr(demo, "train", lambda *_, **__: SimpleNamespace(bundle=bundle))
    monkeypatch.setattr(demo, "evaluate", lambda *_, **__: done)
    assert softslide.main(["demo", "--out", str(tmp_path / "demo")]) == 0
    table = capsys.readouterr().out.partition("\nsummary ")[0].splitlines()
    page = (tmp_path / "demo" / "summary.html").read_text(encoding="utf-8")
    shown = " ".join(html.unescape(re.sub("<[^>]*>", " ", page)).split())
    assert len(table) > 10
    assert not [line for line in table if " ".join(line.split()) not in shown]
    assert re.findall(r'href="([^"]+)"', page) == [f"{model}/evaluation/report.html" for model in DEMO_MODELS]
    assert f"--model {tmp_path / 'demo'}/cnn/bundle" in page
