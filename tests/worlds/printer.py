"""A printer on a pseudo-terminal that speaks as Marlin or GRBL does, and moves in time. It keeps what it did."""

import os
import re
import threading
import time
import tty
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from operator import xor

import numpy as np

from softslide.experiments.acquisition.gcode import CLEAR_MM

ORIGIN = (110.0, 95.0, 31.5)  # mm from where it is homed: the ball touches the skin's middle
HURRIED = 20.0  # times haste, from and to where it is clear of the skin


@dataclass
class Printer:
    """firmware: marlin or grbl. haste: times real time. damaged: numbers of lines that arrive damaged once. fails: the
    line that it answers with an error; highest_mm: soft limit of x; pulled: after so many lines nothing is answered.
    acceleration: mm/s2, to and from a stop in each move.

    moves: (from, to) mm and mm/s of each; log: s of the monotonic clock, and the place; stopped: set by an emergency
    stop, once it has arrived; after: lines that came after it.
    """

    firmware: str = "marlin"
    haste: float = 5.0
    damaged: tuple[int, ...] = ()
    fails: str = ""
    highest_mm: float = np.inf
    pulled: float = np.inf
    moves: list[tuple[np.ndarray, np.ndarray, float]] = field(default_factory=list)
    acceleration: float = np.inf
    log: list[tuple[float, ...]] = field(default_factory=list)
    stopped: threading.Event = field(default_factory=threading.Event)
    after: list[str] = field(default_factory=list)

    def place_at(self, moment_s: np.ndarray) -> np.ndarray:
        """(n, 3) mm where it was at (n,) s of the monotonic clock."""
        known = np.array(self.log)
        return np.column_stack([np.interp(moment_s, known[:, 0], column) for column in known[:, 1:].T])

    def __enter__(self) -> "Printer":
        own, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        # As a file: once it is closed, its number is another printer's.
        self._port = os.fdopen(own, "r+b", buffering=0)
        self.url = f"serial://{os.ttyname(self._theirs)}?firmware={self.firmware}"
        self.place, self.moving, self.lines = np.zeros(3), False, list[str]()
        self._last, self._seen, self._motion = 0, set[int](), threading.Thread()
        self._motion.start()
        threading.Thread(target=self._run, daemon=True).start()
        return self

    def __exit__(self, *of_no_interest: object) -> None:
        self._port.close()
        with suppress(OSError):
            os.close(self._theirs)

    def _run(self) -> None:
        text = ""
        while True:
            try:
                text += self._port.read(1024).decode()
            except (OSError, ValueError):
                return
            if "\x18" in text:
                self.stopped.set()
                text = text.rpartition("\x18")[2]
            while "?" in text:
                text = text.replace("?", "", 1)
                state = "Run" if self.moving else "Idle"
                self._say(
                    f"<{state}|WPos:{self.place[0]:.3f},{self.place[1]:.3f},{self.place[2]:.3f}|FS:0,0>"
                )
            while "\n" in text:
                line, _, text = text.partition("\n")
                self._take(line)

    def _say(self, text: str) -> None:
        if len(self.lines) <= self.pulled:
            with suppress(OSError, ValueError):
                self._port.write(f"{text}\n".encode())

    def _take(self, line: str) -> None:
        if line == "M112":
            self.stopped.set()
            return
        if self.stopped.is_set():
            self.after.append(line)
            return
        if self.firmware == "marlin":
            text, _, checksum = line.rpartition("*")
            number = int(text.split()[0][1:])
            damaged = number in self.damaged and number not in self._seen
            self._seen.add(number)
            if damaged or reduce(xor, text.encode()) != int(checksum):
                self._say(f"Error:checksum mismatch, Last Line: {self._last}\nResend: {self._last + 1}\nok")
                return
            self._last, line = number, text.partition(" ")[2]
        self.lines.append(line)
        if self.fails and line.startswith(self.fails):
            self._say("Error:Homing failed" if self.firmware == "marlin" else "ALARM:9")
            return
        words = {key: float(value) for key, value in re.findall(r"([A-Z])(-?[\d.]+)", line)}
        if line.startswith(("G92", "G28", "$H")):
            self.place = np.zeros(3)
        elif line.startswith("G1 "):
            self._move(words)
        elif line.startswith(("M400", "G4 ")):
            self._motion.join()
            time.sleep(words.get("P", 0.0) / (1000 if self.firmware == "marlin" else 1) / self.haste)
        elif line == "M503" and self.acceleration < np.inf:
            self._say(
                f"echo:  M201 X3000.00 Y3000.00 Z3000.00 E9000\necho:  M204 P{self.acceleration:.2f} T500"
            )
        elif line == "$$" and self.acceleration < np.inf:
            self._say("\n".join(f"${n}={self.acceleration:.3f}" for n in (120, 121, 122)))
        elif line == "M114":
            self._say("X:{:.2f} Y:{:.2f} Z:{:.2f} E:0.00 Count X:0 Y:0 Z:0".format(*self.place))
        self._say("ok")

    def _move(self, words: dict[str, float]) -> None:
        """Is acknowledged as it begins, as in both firmwares; the next waits for its end."""
        self._motion.join()
        to = np.array([words.get(axis, at) for axis, at in zip("XYZ", self.place, strict=True)])
        to[0] = min(to[0], self.highest_mm)
        begin, speed = self.place, words["F"] / 60
        self.moves.append((begin, to, speed))
        way = float(np.linalg.norm(to - begin))
        self.moving = True
        self._motion = threading.Thread(
            target=self._carry, args=(begin, to, way, min(speed, (way * self.acceleration) ** 0.5))
        )
        self._motion.start()

    def _carry(self, begin: np.ndarray, to: np.ndarray, way: float, speed: float) -> None:
        ramp_s = speed / self.acceleration
        seconds = way / speed + ramp_s if way else 0.0
        clear = max(begin[2], to[2]) > ORIGIN[2] + CLEAR_MM - 1e-3
        begun_s, haste = time.monotonic(), self.haste * (HURRIED if clear else 1.0)
        while (at_s := (time.monotonic() - begun_s) * haste) < seconds:
            from_end_s = min(at_s, seconds - at_s)
            gone = (
                speed * (from_end_s - ramp_s / 2)
                if from_end_s > ramp_s
                else self.acceleration * from_end_s**2 / 2
            )
            self.place = begin + (gone if at_s < seconds / 2 else way - gone) / way * (to - begin)
            self.log.append((time.monotonic(), *self.place))
            time.sleep(0.002)
        self.place, self.moving = to, False
        self.log.append((time.monotonic(), *self.place))
