"""A bundle that was altered, by accident or on purpose: refused with one line, or it answers as before."""

import copy
import json
import os
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from altered_bundle import answers, taken
from small_bundle import write_table

from softslide.features.card import card_hash
from softslide.features.errors import InputError
from softslide.serve.localizer import Localizer

WRONG = (None, True, -1, 0, 1e300, 10**400, "1", "", [], [1.0, 2.0, 3.0], {}, {"a": 1}, [[]])
Keys = tuple[Any, ...]


def places(table: Any, keys: Keys = ()) -> Iterator[Keys]:
    """The keys that lead to each value of a table; of a list of numbers the first."""
    if keys:
        yield keys
    if isinstance(table, dict):
        for key, value in table.items():
            yield from places(value, (*keys, key))
    elif isinstance(table, list) and table:
        yield from places(table[0], (*keys, 0))


def edited(table: dict[str, Any], keys: Keys, value: Any) -> dict[str, Any]:
    changed = copy.deepcopy(table)
    inner: Any = changed
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return changed


def wrong_for(value: Any) -> list[Any]:
    """Wrong values; for a number also a slightly other one."""
    near = [value * 1.01 + 1e-3] if isinstance(value, float) else []
    return [*WRONG, *near]


def at(table: Any, keys: Keys) -> Any:
    for key in keys:
        table = table[key]
    return table


def test_no_edit_of_one_field_changes_an_answer(bundle: Path, mine: Path) -> None:
    table, wanted = json.loads((bundle / "model.json").read_text()), answers(bundle)
    edits = refused = 0
    for keys in places(table):
        for wrong in wrong_for(at(table, keys)):
            (mine / "model.json").write_text(json.dumps(edited(table, keys, wrong)))
            edits += 1
            answer = taken(mine)
            refused += answer is None
            assert answer in (None, wanted), (keys, wrong)
    assert edits > 1000
    # The same value again, and no more, is taken: True for 1 and the like.
    assert refused > 0.97 * edits


def test_a_card_without_a_hash_is_refused_unless_it_is_named_so_and_then_refused_or_runs(
    bundle: Path, mine: Path
) -> None:
    """Types and ranges alone: what such a card says may be wrong, but it never fails later than at loading."""
    table = json.loads((bundle / "model.json").read_text())
    del table["card_sha256"]
    (mine / "model.json").write_text(json.dumps(table))
    with pytest.raises(InputError, match=r"unsigned is needed .*no card_sha256"):
        answers(mine)
    assert answers(mine, unsigned=True) == answers(bundle)
    edits = [(keys, wrong) for keys in places(table) for wrong in WRONG]
    refused = 0
    for keys, wrong in random.Random(0).sample(edits, 300):
        (mine / "model.json").write_text(json.dumps(edited(table, keys, wrong)))
        refused += taken(mine, unsigned=True) is None
    assert refused > 150


def test_a_hash_does_not_depend_on_the_order_and_the_spaces(bundle: Path, mine: Path) -> None:
    table = json.loads((bundle / "model.json").read_text())
    shuffled = dict(reversed(table.items()))
    (mine / "model.json").write_text(json.dumps(shuffled, indent=7))
    assert answers(mine) == answers(bundle)
    assert card_hash(shuffled) == table["card_sha256"]


@pytest.mark.parametrize("name", ["model.json", "model.onnx"])
def test_no_flipped_bit_changes_an_answer(bundle: Path, mine: Path, name: str) -> None:
    content, wanted = (bundle / name).read_bytes(), answers(bundle)
    chance = random.Random(0)
    for _ in range(300):
        flipped = bytearray(content)
        flipped[chance.randrange(len(flipped))] ^= 1 << chance.randrange(8)
        (mine / name).write_bytes(flipped)
        assert taken(mine) in (None, wanted)


DEEP = ('{"a":' * 100_000, "[" * 100_000, "9" * 5000)


@pytest.mark.parametrize(
    "text",
    [*DEEP, '{"format": 1, "format": 1}', "NaN", "\ud800", "\0", "3", "[]"],
    ids=lambda text: ascii(text)[:12],
)
def test_text_that_is_not_a_card_is_refused(mine: Path, text: str) -> None:
    (mine / "model.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    assert taken(mine) is None


@pytest.mark.parametrize("name", ["model.json", "model.onnx"])
@pytest.mark.parametrize(
    "kind", ["pipe", "link to a pipe", "folder", "loop", "device", "giant", "unreadable"]
)
def test_what_is_not_a_file_of_a_bounded_size_is_refused_at_once(mine: Path, name: str, kind: str) -> None:
    path = mine / name
    path.unlink()
    if kind in ("pipe", "link to a pipe"):
        pipe = path if kind == "pipe" else mine / "pipe"
        os.mkfifo(pipe)
        if pipe is not path:
            path.symlink_to(pipe)
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "giant":
        with path.open("wb") as file:
            file.truncate(1 << 40)
    else:
        path.symlink_to("/proc/self/mem")
    # Of the processor: the clock would count other processes too. One that waits for ever ends at pytest's limit.
    begun = time.process_time()
    assert taken(mine) is None
    assert time.process_time() - begun < 2.0


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
def test_an_altered_card_is_refused(mine: Path, changes: dict) -> None:
    assert taken(damaged(mine, **changes)) is None


def test_another_graph_with_a_fitting_hash_and_a_missing_bundle_are_refused(
    mine: Path, two_boards: Path
) -> None:
    (mine / "model.onnx").write_bytes((two_boards / "model.onnx").read_bytes())
    card = json.loads((two_boards / "model.json").read_text())
    with pytest.raises(InputError, match="its card says"):
        Localizer.load(damaged(mine, graph_sha256=card["graph_sha256"]))
    with pytest.raises(InputError, match="no such file"):
        Localizer.load(mine / "nothing")
