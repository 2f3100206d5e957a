"""A bundle that is not what its card says is refused with one line."""

import json
from pathlib import Path

import pytest
from small_bundle import write_small_bundle, write_table
from streams import a_sensor

from features.errors import InputError
from serve.localizer import Localizer


def damaged(bundle: Path, **changes: object) -> Path:
    """The bundle with a changed card, whose hash fits it."""
    write_table(bundle, json.loads((bundle / "model.json").read_text()) | changes)
    return bundle


OUTPUTS = ["direction_cos", "direction_sin", "log_speed", "offset_mm", "along_mm"]
FIELDS = (
    *({"format": "other"}, {"version": 2}, {"more": 1}, {"input": "features"}, {"sensor": {}}),
    *({"sample_rate_hz": 10.0}, {"sample_rate_hz": -1}, {"reference_mm": [1.0]}, {"golden": 3}),
    *({"conditioning": {"trigger_blocks": 2.5}}, {"conditioning": {"block_s": True}}),
    *({"validity": {"speed_mm_s": ["0", "1"]}}, {"intervals": {"offset_mm": {"scale": "1", "floor": 0.0}}}),
    *({"golden": {"inputs": {}, "estimate": []}}, {"graph_sha256": "0" * 64}),
)
NAMES = (
    {"channels": ["a0_vx", "a0_vz", "a0_vy"]},
    {"channels": [f"a{n}_v{axis}" for n in range(2) for axis in "xyz"]},
    {"outputs": OUTPUTS[:4]},
    {"outputs": [*OUTPUTS[:3], "log_speed", "along_mm"]},
    {"outputs": [*OUTPUTS[:2], "depth_mm", *OUTPUTS[3:]]},
)


@pytest.mark.parametrize("changes", [*FIELDS, *NAMES], ids=str)
def test_an_altered_card_is_refused(tmp_path: Path, changes: dict) -> None:
    bundle = damaged(write_small_bundle(tmp_path / "b", a_sensor()), **changes)
    with pytest.raises(InputError) as refusal:
        Localizer.load(bundle)
    assert "\n" not in str(refusal.value)
    assert str(bundle) in str(refusal.value)


@pytest.mark.parametrize("size", [0, 1, 100, -1])
@pytest.mark.parametrize("name", ["model.json", "model.onnx"])
def test_a_truncated_bundle_is_refused(tmp_path: Path, name: str, size: int) -> None:
    path = write_small_bundle(tmp_path / "b", a_sensor()) / name
    # The card's last bytes are a brace and an end of line.
    path.write_bytes(path.read_bytes()[: size if size >= 0 else -2])
    with pytest.raises(InputError, match=name):
        Localizer.load(path.parent)


def test_another_graph_with_a_fitting_hash_and_a_missing_bundle_are_refused(tmp_path: Path) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor())
    other = write_small_bundle(tmp_path / "c", a_sensor(2))
    (bundle / "model.onnx").write_bytes((other / "model.onnx").read_bytes())
    card = json.loads((other / "model.json").read_text())
    with pytest.raises(InputError, match="its card says"):
        Localizer.load(damaged(bundle, graph_sha256=card["graph_sha256"]))
    with pytest.raises(InputError, match="no such file"):
        Localizer.load(tmp_path / "nothing")
