"""`softslide record` where samples are no numbers, and a dry run of a path that does not leave its place."""

import time
from collections.abc import Iterator

import numpy as np
import pytest
from printer import ORIGIN, Printer
from streams import a_sensor

from softslide.experiments.acquisition import capture as module
from softslide.experiments.acquisition import stage
from softslide.experiments.acquisition.capture import Level, Listener, Lost, Phases, capture
from softslide.experiments.acquisition.driven import drive_in_the_air
from softslide.experiments.acquisition.gcode import CLEAR_MM
from softslide.serve.stream.framing import Chunk


def test_a_sample_that_is_no_number_costs_the_slide_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As lost packets leave it; the level goes on without it."""

    def chunks(name: str, columns: int, form: str) -> Iterator[Chunk]:
        for n in range(1000):
            time.sleep(0.02)
            yield np.full((20, columns), 1.65 if n < 20 else np.nan), 0.02 * n + np.arange(20) / 1000

    monkeypatch.setattr(module, "open_live", chunks)
    shown, listener = list[float](), Listener("udp://:1", a_sensor(), "csv", 0.5)
    try:
        with pytest.raises(Lost, match="no finite number"):
            capture(listener, "one", Phases(0.2, 0.2, 2.0), lambda recorded_s, level_v: shown.append(level_v))
    finally:
        listener.close()
    assert shown
    assert np.isfinite(shown).all()
    level, good = Level(20), (np.full((20, 3), 1.65), None)
    assert level.of([good, (np.full((20, 3), np.nan), None)]) == 0.0
    assert level.of([(np.full((20, 3), 1.75), None)]) == pytest.approx(0.1)


def test_a_dry_run_of_a_press_stays_over_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stage, "WAKE_S", 0.05)
    press = np.array([(0, 3, 2, -8), (0.5, 3, 2, 0.4), (0.9, 3, 2, 0.4), (1.5, 3, 2, -8)], float)
    with Printer(haste=100.0) as printer, stage.Stage(printer.url, ORIGIN) as mover:
        drive_in_the_air(mover, press)
    assert printer.place == pytest.approx([113.0, 97.0, 31.5 + CLEAR_MM])
    assert min(end[2] for _, end, _ in printer.moves) >= 31.5 + CLEAR_MM
