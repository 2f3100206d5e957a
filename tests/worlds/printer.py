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


@dataclass
class Printer:
    """firmware: marlin or grbl. haste: times real time. damaged: numbers of lines that arrive damaged once. fails: the
    line that it answers with an error; highest_mm: soft limit of x; pulled: after so many lines nothing is answered.

    moves: (from, to) mm and mm/s of each; began: when, s of the monotonic clock; stopped: by an emergency stop; after:
    lines that came after it.
    """

    firmware: str = "marlin"
    haste: float = 5.0
    damaged: tuple[int, ...] = ()
    fails: str = ""
    highest_mm: float = np.inf
    pulled: float = np.inf
    moves: list[tuple[np.ndarray, np.ndarray, float]] = field(default_factory=list)
    began: list[float] = field(default_factory=list)
    stopped: bool = False
    after: list[str] = field(default_factory=list)

    def place_at(self, moment_s: np.ndarray) -> np.ndarray:
        """(n, 3) mm where it was at (n,) s of the monotonic clock."""
        took = [np.linalg.norm(end - begin) / speed / self.haste for begin, end, speed in self.moves]
        known = np.column_stack([self.began, np.add(self.began, took)]).ravel()
        places = np.array([place for begin, end, _ in self.moves for place in (begin, end)])
        return np.column_stack([np.interp(moment_s, known, column) for column in places.T])

    def __enter__(self) -> "Printer":
        self._own, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.url = f"serial://{os.ttyname(self._theirs)}?firmware={self.firmware}"
        self.place, self.moving, self.lines = np.zeros(3), False, list[str]()
        self._last, self._seen, self._motion = 0, set[int](), threading.Thread()
        self._motion.start()
        threading.Thread(target=self._run, daemon=True).start()
        return self

    def __exit__(self, *of_no_interest: object) -> None:
        for end in (self._own, self._theirs):
            with suppress(OSError):
                os.close(end)

    def _run(self) -> None:
        text = ""
        while True:
            try:
                text += os.read(self._own, 1024).decode()
            except OSError:
                return
            if "\x18" in text:
                self.stopped, text = True, text.rpartition("\x18")[2]
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
            with suppress(OSError):
                os.write(self._own, f"{text}\n".encode())

    def _take(self, line: str) -> None:
        if line == "M112":
            self.stopped = True
            return
        if self.stopped:
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
        self.began.append(time.monotonic())
        seconds = float(np.linalg.norm(to - begin)) / speed / self.haste
        self.moving, self._motion = True, threading.Thread(target=self._carry, args=(begin, to, seconds))
        self._motion.start()

    def _carry(self, begin: np.ndarray, to: np.ndarray, seconds: float) -> None:
        begun_s = time.monotonic()
        while (share := (time.monotonic() - begun_s) / max(seconds, 1e-6)) < 1:
            self.place = begin + share * (to - begin)
            time.sleep(0.002)
        self.place, self.moving = to, False
