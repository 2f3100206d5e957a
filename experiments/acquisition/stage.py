"""A 3-D printer (Marlin) or a small CNC machine (GRBL) as the stage: it carries the ball over the skin.

Never tried on hardware. A line is sent when the one before was acknowledged, to Marlin with number and checksum: a
damaged one is sent again. Places are in mm from the chamber's middle; the stage's own are these plus `origin_mm`.
"""

import re
import threading
import time
from collections.abc import Iterator, Sequence
from functools import reduce
from operator import xor
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pandas as pd

from softslide.experiments.acquisition.gcode import (
    CLEAR_MM,
    DOWN_MM_S,
    FIRMWARE,
    TRAVEL_MM_S,
    check_depth,
    check_height,
    move,
    pause,
)
from softslide.experiments.acquisition.waypoints import ramped, speeds_mm_s, stretches, waypoints_of
from softslide.features.errors import InputError
from softslide.pipeline.sensor import Sensor

BEYOND_MM = 20.0  # past the chamber's edge: nothing is driven farther out
REPLY_S = 10.0  # within which a stage acknowledges a line, unless it says that it is busy
MOTION_S = 600.0  # the longest motion, homing included
WRITE_S = 1.0  # within which a line is written
WAKE_S = 3.0  # opening the port restarts most boards
OFF_MM = 0.05  # between where the stage is and where it was sent: more is a limit of its own
AGAIN = 5  # times that a damaged line is sent again
# Acknowledged once all motion before it has ended.
ENDED = {"marlin": "M400", "grbl": "G4 P0.01"}


class Stage:
    """A stage on a serial port. url: serial:///dev/PORT?firmware=marlin|grbl&baud=115200.

    origin_mm: after homing, where the ball just touches the skin over the chamber's middle while the pressure is off: z
    counts from the flat skin's face; None: it is there now.
    As a context it is stopped at once where the block ends with an error, and closed.

    Raises:
        InputError: no such port or firmware, no answer, or the stage reports an error; also by every method.
    """

    def __init__(self, url: str, origin_mm: Sequence[float] | None = None) -> None:
        import serial

        parts = urlsplit(url)
        given = {key: values[-1] for key, values in parse_qs(parts.query).items()}
        self.firmware = given.pop("firmware", "marlin")
        baud = given.pop("baud", "115200")
        if parts.scheme != "serial" or self.firmware not in FIRMWARE or given or not baud.isdecimal():
            form = "serial:///dev/ttyUSB0?firmware=marlin&baud=115200 (or firmware=grbl)"
            raise InputError(f"{url}: write {form}", "stage")
        self.name, self._number = parts.path, 0
        self._stopped, self._writing = False, threading.Lock()
        try:
            self._port = serial.Serial(parts.path, int(baud), timeout=0.1)
        except OSError as error:
            raise InputError(f"{self.name}: {error}; name the stage's port", "stage") from None
        try:
            self._begin(origin_mm)
        except BaseException:
            self.stop()
            self._port.close()
            raise

    def __enter__(self) -> "Stage":
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        try:
            if kind is not None:
                self.stop()
        finally:
            self._port.close()

    def place(self, start: Sequence[float], depth_mm: float) -> None:
        """Carries the ball to a slide's start (x, y), above the skin, and lowers it to the depth; waits for it.

        depth_mm: below the flat skin's face; negative: above it.
        """
        self._to(TRAVEL_MM_S, z=CLEAR_MM)
        self._to(TRAVEL_MM_S, *start)
        self.lower(depth_mm)

    def lower(self, by_mm: float) -> None:
        """Lowers the ball where it is to so far below the flat skin's face, or lifts it above it; waits for it."""
        self._to(DOWN_MM_S, z=-by_mm)
        self.finish()

    def count_from(self, by_mm: float) -> None:
        """Takes the height so far below for the flat skin's face."""
        self._origin[2] -= by_mm

    def follow(self, waypoints: np.ndarray) -> tuple[np.ndarray, float]:
        """Carries the ball along waypoints (n, 4), as in waypoints.py, from the first, where it is, to the end.

        Returns (m, 2): s of the waypoints' time, and of the monotonic clock at which the stage was there; and how much
        longer (s) than planned a stretch between two rests took at most. Each is timed by the acknowledgement of its
        end, since a firmware may wait before it begins, with the ramps of the stage's acceleration at both ends.
        """
        moments, longer_s, at = list[np.ndarray](), 0.0, 0
        speeds = speeds_mm_s(waypoints)
        for first, last in stretches(waypoints):
            if first > at:
                self.send(pause(self.firmware, waypoints[first, 0] - waypoints[at, 0]), MOTION_S)
            begun_s, at = time.monotonic(), last
            for n in range(first, last):
                _, x, y, depth = waypoints[n + 1]
                self._to(speeds[n], x, y, -depth)
            self.send(ENDED[self.firmware], MOTION_S)
            own_s, s = ramped(waypoints[first, 0], waypoints[last, 0], self._ramps_s(waypoints, first, last))
            s += time.monotonic() - s[-1]
            longer_s = max(longer_s, s[0] - begun_s)
            moments.append(np.column_stack([own_s, np.maximum(s, begun_s)]))
        if at < len(waypoints) - 1:
            self.send(pause(self.firmware, waypoints[-1, 0] - waypoints[at, 0]), MOTION_S)
        return np.concatenate([np.empty((0, 2)), *moments]), longer_s

    def lost_s(self, waypoints: np.ndarray) -> float:
        """How much longer its ramps make a way along waypoints."""
        return sum(self._ramps_s(waypoints, *ends).sum() / 2 for ends in stretches(waypoints))

    def lift(self) -> None:
        """Waits for the end of all motion, and lifts the ball clear of the skin."""
        self.finish()
        self.lower(-CLEAR_MM)

    def finish(self) -> None:
        """Waits until nothing moves, and sees that the stage is where it was sent: it may have limits of its own."""
        self.send(ENDED[self.firmware], MOTION_S)
        at, sent = self.position(), self._sent
        if at is not None and (np.abs(at - sent) > OFF_MM).any():
            raise InputError(
                f"{self.name}: at {_listed(at)} mm and not at {_listed(sent)}; see the stage's own limits"
            )

    def position(self) -> np.ndarray | None:
        """(3,) mm, as the stage says it; None where it does not."""
        if self.firmware == "marlin":
            found = re.search(r"X:([-\d.]+) Y:([-\d.]+) Z:([-\d.]+)", " ".join(self.send("M114")))
        else:
            found = re.search(r"WPos:([-\d.]+),([-\d.]+),([-\d.]+)", self._status())
        return None if found is None else np.array([float(word) for word in found.groups()])

    def stop(self) -> None:
        """Emergency stop: the stage holds where it is and takes nothing until it is reset; nor is anything sent."""
        self._stopped = True
        # From another thread than the one that drives: not in the middle of its line, unless that hangs.
        free = self._writing.acquire(timeout=WRITE_S)
        try:
            self._port.write(b"M112\n" if self.firmware == "marlin" else b"!\x18")
            self._port.flush()
        except OSError:
            pass
        finally:
            if free:
                self._writing.release()

    def send(self, line: str, patience_s: float = REPLY_S) -> list[str]:
        """Sends a line, again where it arrived damaged, and waits for its acknowledgement; what came before that."""
        self._number += 1
        data = numbered(line, self._number) if self.firmware == "marlin" else f"{line}\n"
        replies, damaged, again = list[str](), False, 0
        self._write(data)
        coming = self._replies(line, patience_s)
        while True:
            reply = next(coming)
            if reply.startswith("ok"):
                if not damaged:
                    return [*replies, reply]
                again += 1
                if again > AGAIN:
                    raise InputError(f"{self.name}: '{line}' arrived damaged {again} times; see the cable")
                damaged = False
                self._write(data)
            elif asked := re.match(r"(?:resend|rs)\D*(\d+)", reply.lower()):
                # Of the line after this one: it was taken, and its acknowledgement was lost.
                damaged = int(asked[1]) <= self._number
            elif re.match("(error|alarm|!!)", reply.lower()) and not _is_harmless(reply):
                raise InputError(
                    f"{self.name}: the stage answers '{line}' with '{reply}'; see to it and begin again"
                )
            else:
                replies.append(reply)

    def _begin(self, origin_mm: Sequence[float] | None) -> None:
        time.sleep(WAKE_S)
        self._port.reset_input_buffer()
        if self.firmware == "marlin":
            self._number = -1
            self.send("M110 N0")
        for line in ("G21", "G90"):
            self.send(line)
        if origin_mm is None:
            self.send("G92 X0 Y0 Z0")
        else:
            self.send("G28" if self.firmware == "marlin" else "$H", MOTION_S)
        self._origin = np.zeros(3) if origin_mm is None else np.array(origin_mm, float)
        self._accelerates = self._accelerations()
        # Where it was last sent; after homing, what is not sent yet is where it is.
        at = self.position()
        self._sent = np.zeros(3) if at is None else at

    def _accelerations(self) -> np.ndarray:
        """Of x, y and z (3,) mm/s2, as the stage says them; infinite where it does not."""
        marlin = self.firmware == "marlin"
        text = " ".join(self.send("M503" if marlin else "$$"))
        words = [r"M201 X([\d.]+)", r"M201 .*?Y([\d.]+)", r"M201 .*?Z([\d.]+)"]
        words = words if marlin else [r"\$120=([\d.]+)", r"\$121=([\d.]+)", r"\$122=([\d.]+)"]
        found = [re.search(word, text) for word in [*words, r"M204 P([\d.]+)"]]
        *axes, most = [float(match[1]) if match and float(match[1]) > 0 else np.inf for match in found]
        return np.minimum(axes, most)

    def _ramps_s(self, waypoints: np.ndarray, first: int, last: int) -> np.ndarray:
        """How long it takes (2,) to the speed of a stretch's begin and from that of its end, by the slowest axis."""
        steps = np.diff(waypoints[[first, first + 1, last - 1, last]], axis=0)[[0, 2]]
        return (np.abs(steps[:, 1:]) / steps[:, :1] / self._accelerates).max(axis=1)

    def _to(
        self, speed_mm_s: float, x: float | None = None, y: float | None = None, z: float | None = None
    ) -> None:
        for axis, value in enumerate((x, y, z)):
            if value is not None:
                self._sent[axis] = value + self._origin[axis]
        own = (None if v is None else at for v, at in zip((x, y, z), self._sent, strict=True))
        self.send(move(speed_mm_s, *own), MOTION_S)

    def _status(self) -> str:
        """GRBL's report, <State|...>."""
        self._write("?")
        report = next(reply for reply in self._replies("?", REPLY_S) if reply.startswith("<"))
        if report.startswith(("<Alarm", "<Door")):
            raise InputError(f"{self.name}: the stage says '{report}'; see to it and begin again")
        return report

    def _write(self, data: str) -> None:
        with self._writing:
            if self._stopped:
                raise self._halted()
            try:
                self._port.write(data.encode("ascii"))
            except OSError as error:
                raise self._gone(error) from None

    def _replies(self, line: str, patience_s: float) -> Iterator[str]:
        """What the stage says to a line, for so long; and anew each time that it says that it is busy.

        Raises:
            InputError: the time is over.
        """
        until = time.monotonic() + patience_s
        while time.monotonic() < until:
            try:
                reply = self._port.readline().decode("ascii", "replace").strip()
            except OSError as error:
                raise self._gone(error) from None
            if self._stopped:
                raise self._halted()
            if "busy" in reply.lower():
                until = time.monotonic() + patience_s
            if reply:
                yield reply
        raise InputError(
            f"{self.name}: no answer to '{line}' in {patience_s:g} s; see firmware, baud rate and cable"
        )

    def _halted(self) -> InputError:
        return InputError(f"{self.name}: the stage was stopped; see to it and begin again")

    def _gone(self, error: OSError) -> InputError:
        return InputError(
            f"{self.name}: {error}; what is recorded is kept, see the cable and run the same command again"
        )


def numbered(line: str, number: int) -> str:
    """A line as Marlin checks it: with its number, and the exclusive or of its bytes."""
    text = f"N{number} {line}"
    return f"{text}*{reduce(xor, text.encode('ascii'))}\n"


def check_slides(slides: pd.DataFrame, sensor: Sensor) -> None:
    """Sees that no skin is too high, no slide or path too deep (`gcode`), and none goes BEYOND_MM past the chamber.

    Raises:
        InputError: one does, is of a moving robot, or has no depth; or the skin is.
    """
    check_height(sensor, "stage")
    reach = np.array(sensor.chamber_mm) / 2 + BEYOND_MM
    for name, row in slides.iterrows():
        waypoints = waypoints_of(row)
        # A slide touches all the way; a path may be above the skin.
        deepest_mm = waypoints[:, 3].max()
        check_depth(name, deepest_mm if row["waypoints"] is None else max(deepest_mm, 0.0), "stage")
        if waypoints[:, 3].min() < -CLEAR_MM:
            raise InputError(f"{name}: goes up by more than {CLEAR_MM:g} mm", "stage")
        if not (np.abs(waypoints[:, 1:3]) <= reach).all():
            raise InputError(
                f"{name}: leaves the {2 * reach[0]:g} x {2 * reach[1]:g} mm that a stage is driven over",
                "stage",
            )
        if not 0 < (speed := speeds_mm_s(waypoints).max()) <= TRAVEL_MM_S:
            raise InputError(f"{name}: {speed:g} mm/s; a stage is driven at most at {TRAVEL_MM_S:g}", "stage")


def _is_harmless(reply: str) -> bool:
    """Whether an error is one after which Marlin asks for the line again, or goes on."""
    return any(word in reply.lower() for word in ("checksum", "line number", "last line", "unknown command"))


def _listed(place: np.ndarray) -> str:
    return ", ".join(f"{value:g}" for value in place)
