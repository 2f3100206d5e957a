"""`softslide bench`: every figure is there and has its unit; no claim about this machine."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bump_map import bump_map
from small_bundle import write_small_bundle
from streams import a_sensor

import softslide
from models.response_map.card import contact_calibration
from serve.bench.runtime import _with_accelerometers
from serve.bundle import open_bundle
from serve.localizer import Localizer


@pytest.mark.parametrize("accelerometers", [1, 4])
def test_the_last_line_is_one_json_object(
    tmp_path: Path, capsys: pytest.CaptureFixture, accelerometers: int
) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor(accelerometers))
    assert softslide.main(["bench", "--model", str(bundle), "--decisions", "20"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    for name in (
        "decision_at_rest",
        "decision_at_rest_of_four",
        "decision_in_a_slide",
        "inference_alone",
    ):
        assert 0 < told[name]["median_us"] <= told[name]["p99_us"]
        assert told[name]["p99_ratio"] >= 1
        assert told[name]["ratio"] > 0
    assert told["accelerometers"] == accelerometers
    assert told["bundle_kb"] == sum(p.stat().st_size for p in bundle.iterdir()) / 1e3
    assert 0 < told["libraries_s"] < told["first_estimate_s"]


@pytest.mark.parametrize("count", [1, 4])
def test_a_card_that_tracks_contacts_takes_more_accelerometers(tmp_path: Path, count: int) -> None:
    card, graph = open_bundle(write_small_bundle(tmp_path / "b", a_sensor(1)))
    response = bump_map()
    known = {"noise_v": np.full(2, 1e-3), "drift_v": np.full(2, 5e-4), "floor_v": 5e-4, "gain_sd": 0.02}
    card = replace(card, contact=contact_calibration(replace(response, **known)))
    wider = _with_accelerometers(card, count)
    assert wider.contact is not None
    assert wider.contact.splines().shape[-1] == 2 * count
    assert len(Localizer(wider, graph).push(np.full((200, 3 * count), 1.65))) > 0


def test_a_missing_bundle_is_an_error_of_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert softslide.main(["bench", "--model", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
