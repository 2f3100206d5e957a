"""`softslide bench`: every figure is there and has its unit; no claim about this machine."""

import json
from pathlib import Path

import pytest
from small_bundle import write_small_bundle
from streams import a_sensor

import softslide


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


def test_a_missing_bundle_is_an_error_of_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert softslide.main(["bench", "--model", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
