"""The champion: who becomes it, who does not, and that commands take it by its name."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_bundle import write_small_bundle
from trial_folder import SENSOR, a_folder

import softslide
from experiments.promote import QUANTITIES, compare

CHAMPION = "models:/softslide@champion"


@pytest.fixture(scope="module", autouse=True)
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path_factory.mktemp('promote') / 'mlflow.db'}")
        yield


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Slides along six lines, kept to choose a champion on."""
    rows = {f"r{n}": {"offset_mm": 4.0 + n, "start_y_mm": 4.0 + n, "split": "validation"} for n in range(6)}
    return a_folder(tmp_path_factory.mktemp("promote") / "lab", **rows).root


def promote(bundle: Path, lab: Path, *options: str) -> int:
    command = ["promote", "--model", bundle, "--recordings", lab, "--jobs", 1, *options]
    return softslide.main([str(word) for word in command])


def test_the_champion_refuses_a_worse_challenger_and_takes_a_better_one(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Slides go at 0 degrees and 14.5 mm/s; the models say always the same."""
    says = {
        "first": {"direction_deg": 10.0, "speed_mm_s": 13.0, "offset_mm": 10.0},
        "worse": {"direction_deg": 12.0, "speed_mm_s": 13.0, "offset_mm": 10.0},
        "hardly": {"direction_deg": 9.7, "speed_mm_s": 13.0, "offset_mm": 10.0},
        "better": {"direction_deg": 5.0, "speed_mm_s": 14.0, "offset_mm": 9.0},
    }
    for name, answer in says.items():
        write_small_bundle(tmp_path / name, SENSOR, **answer)
    statuses, told = {}, {}
    for name in says:
        statuses[name] = promote(tmp_path / name, lab)
        told[name] = capsys.readouterr().out.splitlines()
    assert statuses == {"first": 0, "worse": 1, "hardly": 1, "better": 0}
    assert told["first"] == ["no champion yet", f"{CHAMPION} is now version 1"]
    assert told["worse"][0] == "direction_deg: champion (version 1) 10, challenger 12"
    assert told["hardly"][-1] == f"{CHAMPION} stays version 1"
    assert told["better"][-1] == f"{CHAMPION} is now version 2"
    assert promote(tmp_path / "hardly", lab, "--margin", "0") == 1

    slide = pd.read_parquet(lab / "slides" / "r0.parquet")
    slide.to_csv(tmp_path / "slide.csv", index=False)
    capsys.readouterr()
    for model in (CHAMPION, "models:/softslide/2", str(tmp_path / "better")):
        assert softslide.main(["predict", "--model", model, str(tmp_path / "slide.csv")]) == 0
    first, *others = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert others == [first, first]
    assert first["direction_deg"] == pytest.approx(5.0, abs=1e-4)
    options = [
        "--recordings",
        str(lab),
        "--split",
        "validation",
        "--jobs",
        "1",
        "--out",
        str(tmp_path / "out"),
    ]
    softslide.main(["evaluate", "--model", CHAMPION, *options])
    assert json.loads((tmp_path / "out/metrics.json").read_text())["bundle"]["name"] == "softslide-champion"
    assert softslide.main(["export", "--model", CHAMPION, "--to", "ort", "--out", str(tmp_path / "ort")]) == 0


def test_a_name_that_is_not_registered_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert softslide.main(["predict", "--model", "models:/softslide@nobody", __file__]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "softslide predict: models:/softslide@nobody: not to be had from sqlite" in err


def errors(*rows: float) -> pd.DataFrame:
    return pd.DataFrame(dict.fromkeys(QUANTITIES, rows), index=[f"r{n}" for n in range(len(rows))])


def lines(*offsets: float) -> pd.DataFrame:
    index = [f"r{n}" for n in range(len(offsets))]
    return pd.DataFrame({"direction_deg": 0.0, "offset_mm": offsets}, index=index)


def test_a_gain_is_a_share_of_the_champions_errors() -> None:
    one, half = errors(1, 2, 3, 4, 5), errors(0.5, 1, 1.5, 2, 2.5)
    found = compare(one, half, lines(1, 2, 3, 4, 5))
    assert found.gain == pytest.approx(0.5)
    assert 0 < found.low < 0.5
    assert compare(half, one, lines(1, 2, 3, 4, 5)).gain == pytest.approx(-1.0)
    assert compare(one, one, lines(1, 2, 3, 4, 5)).low == 0


def test_slides_along_one_line_count_once() -> None:
    """Ten slides of one line that went well do not outvote four lines that went badly."""
    before, after = errors(*[1.0] * 14), errors(*[0.0] * 10, *[1.5] * 4)
    assert compare(before, after, lines(*[1.0] * 10, 2, 3, 4, 5)).gain == pytest.approx((1 - 4 * 0.5) / 5)
    assert compare(before, after, lines(*range(14))).gain == pytest.approx((10 - 4 * 0.5) / 14)


def test_silence_is_no_gain() -> None:
    """To abstain where the champion answers costs as much as an error twice the mean."""
    answered, silent = errors(1, 1, 1, 1, 1), errors(1, 1, 1, 1, np.nan)
    assert compare(answered, silent, lines(1, 2, 3, 4, 5)).gain == pytest.approx(-0.2)
    assert compare(silent, answered, lines(1, 2, 3, 4, 5)).gain == pytest.approx(0.2)


def test_luck_is_not_promoted() -> None:
    """No better on average: the lower bound exceeds 0 in one challenge of twenty, as the test's level says."""
    random = np.random.default_rng(3)
    manifest = lines(*range(8))
    lows = [
        compare(errors(*random.uniform(1, 2, 8)), errors(*random.uniform(1, 2, 8)), manifest).low
        for _ in range(400)
    ]
    assert 0.02 < np.mean(np.array(lows) > 0) < 0.09
