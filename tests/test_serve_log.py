"""A stream kept as MCAP: its own reader finds every sample and estimate, and an import the volts."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from streams import a_sensor, write_csv

import softslide
from softslide.pipeline.recordings.folder import read_folder
from softslide.pipeline.sensor import write_sensor
from softslide.serve.stream.log import ESTIMATES, VOLTS

SAMPLES = 400
JSON_TYPES = {"number": (int, float), "null": type(None), "string": str, "boolean": bool, "array": list}


@pytest.fixture
def recorded(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """A recording as CSV and its volts."""
    volts = np.random.default_rng(0).normal([1.65, 1.65, 2.45], 0.005, (SAMPLES, 3))
    return write_csv(tmp_path / "a.csv", volts), volts


def served(bundle: Path, csv: Path, log: Path) -> int:
    words = ["serve", "--model", str(bundle), "--source", str(csv), "--fast", "--log", str(log)]
    return softslide.main(words)


def test_the_format_s_own_reader_finds_all(
    bundle: Path, recorded: tuple[Path, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert served(bundle, recorded[0], tmp_path / "run.mcap") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    with (tmp_path / "run.mcap").open("rb") as file:
        found = [
            (channel.topic, message.log_time, json.loads(message.data), json.loads(schema.data))
            for schema, channel, message in make_reader(file).iter_messages()
        ]
    estimates = [fields for topic, _, fields, _ in found if topic == ESTIMATES]
    assert estimates == lines
    volts = np.array([[f["a0_vx"], f["a0_vy"], f["a0_vz"]] for topic, _, f, _ in found if topic == VOLTS])
    np.testing.assert_array_equal(volts, recorded[1])
    begin_ns = found[0][1] - round(1e9 * found[0][2]["time_s"])
    for _, at_ns, fields, schema in found:
        assert abs(at_ns - begin_ns - 1e9 * fields["time_s"]) < 2
        assert fields.keys() == schema["properties"].keys()
        for name, value in fields.items():
            kinds = schema["properties"][name]["type"]
            known = [JSON_TYPES[kind] for kind in (kinds if isinstance(kinds, list) else [kinds])]
            assert any(isinstance(value, kind) for kind in known), name


def test_an_import_reads_the_volts_back(
    bundle: Path, recorded: tuple[Path, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "lab").mkdir()
    assert served(bundle, recorded[0], tmp_path / "lab" / "run.mcap") == 0
    capsys.readouterr()
    write_sensor(tmp_path / "sensor.toml", a_sensor())
    assert softslide.main(["import", "--map-template", "mcap"]) == 0
    (tmp_path / "map.toml").write_text(capsys.readouterr().out)
    softslide.import_recordings(tmp_path / "lab", tmp_path / "map.toml", tmp_path / "out")
    np.testing.assert_array_equal(read_folder(tmp_path / "out").load("run").volts, recorded[1])
    whole = (tmp_path / "lab" / "run.mcap").read_bytes()
    cut = [(whole[: int(share * len(whole))], "") for share in (0.0, 0.3, 0.9)]
    # Of the first channel, that of the volts, the file says how many messages it holds.
    counted, one_more = (struct.pack("<HQ", 1, count) for count in (SAMPLES, SAMPLES + 1))
    cut.append((whole.replace(counted, one_more), f": {SAMPLES} of {SAMPLES + 1} messages"))
    for data, says in cut:
        assert data != whole
        (tmp_path / "lab" / "run.mcap").write_bytes(data)
        with pytest.raises(ValueError, match=rf"run\.mcap{says}"):
            softslide.import_recordings(tmp_path / "lab", tmp_path / "map.toml", tmp_path / "again")


def test_a_log_is_never_written_over(
    bundle: Path, recorded: tuple[Path, np.ndarray], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.mcap").write_bytes(b"kept")
    assert served(bundle, recorded[0], tmp_path / "run.mcap") == 2
    assert "name a new file" in capsys.readouterr().err
    assert (tmp_path / "run.mcap").read_bytes() == b"kept"


def test_samples_of_another_rate_are_kept_at_their_times(bundle: Path, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "a.csv", np.tile([1.65, 1.65, 2.45], (SAMPLES, 1)), rate_hz=500.0)
    assert served(bundle, path, tmp_path / "run.mcap") == 0
    with (tmp_path / "run.mcap").open("rb") as file:
        kept = [json.loads(m.data)["time_s"] for _, _, m in make_reader(file).iter_messages(topics=[VOLTS])]
    assert kept == [n / 500 for n in range(SAMPLES)]
