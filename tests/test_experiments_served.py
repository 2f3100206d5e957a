"""The champion served by MLflow answers what `softslide predict` prints, to the last digit."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from team_server import PATIENCE_S, answers, free_port

import softslide
from experiments.tracking.registry import make_champion
from pipeline.recordings.folder import SAMPLE, read_folder

CHAMPION = "models:/softslide@champion"


def posted(address: str, table: pd.DataFrame, **params: object) -> Any:
    """The predictions for a table of time and volts, as any client asks for them."""
    body = {"dataframe_split": table.to_dict(orient="split"), **({"params": params} if params else {})}
    request = urllib.request.Request(
        f"{address}/invocations",
        json.dumps(body).encode(),
        {"Content-Type": "application/json"},
    )
    with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
        return json.loads(answer.read())["predictions"]


@pytest.mark.long
def test_the_served_champion_answers_what_predict_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'store' / 'mlflow.db'}")
    command = ["train", "--recordings", SAMPLE, "--model", "trees", "--out", tmp_path / "bundle"]
    assert softslide.main([*map(str, command), "--register"]) == 0
    make_champion("1")
    folder = read_folder(SAMPLE).select("test")
    slides = []
    for name in folder.manifest["speed_mm_s"].nlargest(3).index:
        recording = folder.load(str(name))
        table = pd.DataFrame(recording.volts, columns=list(folder.sensor.channels))
        table.insert(0, "time_s", recording.time_s)
        table.to_csv(tmp_path / f"{name}.csv", index=False)
        slides.append((tmp_path / f"{name}.csv", table))
    port = free_port()
    words = ["models", "serve", "-m", CHAMPION, "--env-manager", "local", "--port", str(port)]
    # MLflow starts uvicorn by its name, as in an environment that was activated.
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    with (tmp_path / "log").open("wb") as log:
        running = subprocess.Popen(
            [sys.executable, "-m", "mlflow", *words],
            stdout=log,
            stderr=log,
            cwd=tmp_path,
            env=environment,
            start_new_session=True,
        )
    address = f"http://127.0.0.1:{port}"
    try:
        until = time.monotonic() + PATIENCE_S
        while not answers(f"{address}/ping"):
            assert running.poll() is None, (tmp_path / "log").read_text()
            assert time.monotonic() < until, (tmp_path / "log").read_text()
            time.sleep(0.2)
        for path, table in slides:
            for options, params in (([], {}), (["--track"], {"track": True})):
                capsys.readouterr()
                assert softslide.main(["predict", "--model", CHAMPION, *options, str(path)]) == 0
                told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
                for line in told:
                    del line["recording"], line["file"]
                assert posted(address, table, **params) == told
                assert any(line["valid"] for line in told)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
        running.wait(PATIENCE_S)
