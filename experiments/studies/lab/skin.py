"""A simulated skin under the printer's ball, in a process of its own: samples as text over UDP, as they fall due.

Reads the printer's moves from standard input, as `printer.py` prints them. Where the ball is follows from them, and
from what is wrong with the stage.

    python -m softslide.experiments.studies.lab.skin --port 9000 --origin 110 95 31.5 < moves
"""

import argparse
import json
import socket
import sys
import threading
import time
from collections import deque

import numpy as np

from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.simulated_skin import SimulatedSkin

PACKET_S = 0.02
CLOCK = 1 + 5e-5  # the skin's own: a crystal's
FAULT_AFTER_MM = 400.0  # of way


class Ball:
    """Where the ball is over the skin, from the stage's moves.

    wrong: x and y of the stage's origin in mm and its turn in deg, as the skin sees them. lost_mm: steps that x loses
    after FAULT_AFTER_MM of way. stalled: y stops there for good.
    """

    def __init__(
        self, origin_mm: list[float], wrong: list[float], lost_mm: float = 0.0, stalled: bool = False
    ) -> None:
        turn = np.deg2rad(wrong[2])
        self._turn = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        self._shift, self._origin = np.array(wrong[:2]), np.array(origin_mm)
        self._lost_mm, self._stalled, self._way = lost_mm, stalled, 0.0
        self._moves = deque[tuple[float, float, np.ndarray, np.ndarray]]()
        self._at, self._held = np.zeros(3), np.nan

    def add(self, move: dict) -> None:
        """A move that begins."""
        begin, end = (np.array(move[name], float) for name in ("from", "to"))
        self._moves.append((move["at_s"], max(move["took_s"], 1e-9), begin, end))

    def places(self, at_s: np.ndarray) -> np.ndarray:
        """(n, 3) mm at moments (n,) s that follow those before: x and y from the chamber's middle, z over the skin."""
        raw = np.tile(self._at, (len(at_s), 1))
        while self._moves and self._moves[0][0] <= at_s[-1]:
            begun_s, took_s, begin, end = self._moves[0]
            later = at_s >= begun_s
            raw[later] = begin + np.clip((at_s[later, None] - begun_s) / took_s, 0, 1) * (end - begin)
            if at_s[-1] < begun_s + took_s:
                break
            self._moves.popleft()
            self._way += float(np.linalg.norm(end[:2] - begin[:2]))
            raw[at_s >= begun_s + took_s] = end
        self._at = raw[-1].copy()
        place = raw - self._origin
        if self._way >= FAULT_AFTER_MM:
            place[:, 0] -= self._lost_mm
            if self._stalled:
                self._held = place[0, 1] if np.isnan(self._held) else self._held
                place[:, 1] = self._held
        place[:, :2] = place[:, :2] @ self._turn.T + self._shift
        return place


def main() -> None:
    """Streams until standard input ends."""
    parser = argparse.ArgumentParser(
        prog="python -m softslide.experiments.studies.lab.skin", description=__doc__
    )
    parser.add_argument("--port", type=int, required=True)
    parser.add_argument("--origin", type=float, nargs=3, required=True)
    parser.add_argument("--wrong", type=float, nargs=3, default=[0.0, 0.0, 0.0], help="mm, mm, deg")
    parser.add_argument("--lost", type=float, default=0.0, help="mm")
    parser.add_argument("--stalled", action="store_true")
    parser.add_argument("--drift", type=float, default=Distribution.drift_g, help="g in a minute")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--haste", type=float, default=1.0, help="times real time")
    given = parser.parse_args()
    skin = SimulatedSkin(given.seed, distribution=Distribution(drift_g=given.drift))
    ball, ended = Ball(given.origin, given.wrong, given.lost, given.stalled), threading.Event()

    def listen() -> None:
        for line in sys.stdin:
            ball.add(json.loads(line))
        ended.set()

    threading.Thread(target=listen, daemon=True).start()
    rate, count, begun_s = skin.sensor.sample_rate_hz, 0, time.monotonic()
    size = max(1, round(PACKET_S * rate * given.haste))
    with socket.socket(type=socket.SOCK_DGRAM) as mouth:
        while not ended.is_set():
            samples = np.arange(count, count + size)
            count += size
            time.sleep(max(0.0, begun_s + count / rate / given.haste - time.monotonic()))
            volts = skin.push(ball.places(begun_s + samples / rate / given.haste))
            rows = np.column_stack([samples / rate * CLOCK, volts])
            text = "".join(f"{t:.6f}," + ",".join(f"{v:.4f}" for v in row) + "\n" for t, *row in rows)
            mouth.sendto(text.encode("ascii"), ("127.0.0.1", given.port))


if __name__ == "__main__":
    main()
