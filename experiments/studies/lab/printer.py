"""OctoPrint's virtual printer (Marlin's protocol) on a pseudo-terminal, timed by its moves' length and speed.

Run by the Python of an environment that has OctoPrint; prints the terminal's name, and a line of JSON as each move
begins: when (s, of the monotonic clock), from and to (mm), and how long it takes (s).

    PYTHON experiments/studies/lab/printer.py FOLDER HASTE ["5:checksum_mismatch" ...]
"""

import json
import math
import os
import sys
import threading
import time
import tty

from octoprint.plugin import plugin_manager
from octoprint.plugins.virtual_printer import VirtualPrinterPlugin
from octoprint.plugins.virtual_printer.virtual import VirtualPrinter
from octoprint.printer.profile import PrinterProfileManager

FOLDER, HASTE, ERRORS = sys.argv[1], float(sys.argv[2]), sys.argv[3:]
LATE_S = 0.02  # of a process on a busy machine; a move that begins so late was waiting for the one before


class Settings:
    """The plugin's defaults, without a server; errors that come once each, by line number."""

    # Its moves have no ramps: it is not to say that they have.
    defaults = VirtualPrinterPlugin().get_settings_defaults() | {
        "simulated_errors": ERRORS,
        "support_M503": False,
    }

    def get(self, path, merged=False):
        return self.defaults.get(path[0])

    def get_int(self, path):
        return int(self.get(path) or 0)

    def get_float(self, path):
        return float(self.get(path) or 0)

    def get_boolean(self, path):
        return bool(self.get(path))

    def global_get_basefolder(self, name):
        return FOLDER


class Profiles:
    def get_current_or_default(self):
        return PrinterProfileManager.default


class Timed(VirtualPrinter):
    """Its own moves last a tenth of their time in one direction, and none in the other: they are made instant here, and
    one begins when the one before ends. A pause waits for the moves before it, as Marlin's does."""

    free_s = 0.0

    def _performMove(self, line):
        self._feedrate_multiplier = 1e12
        begin = self._lastX, self._lastY, self._lastZ
        super()._performMove(line)
        end = self._lastX, self._lastY, self._lastZ
        took_s = math.dist(begin, end) / max(self._lastF / 60, 1e-9) / HASTE
        now_s = time.monotonic()
        at_s = self.free_s if now_s < self.free_s + LATE_S else now_s
        self.free_s = at_s + took_s
        print(json.dumps({"at_s": at_s, "from": begin, "to": end, "took_s": took_s}), flush=True)
        time.sleep(max(0.0, self.free_s - time.monotonic()))

    def _gcode_G4(self, data):
        self.buffered.join()
        time.sleep(float(data.partition("P")[2]) / 1000 / HASTE)


def main():
    plugin_manager(init=True)
    own, theirs = os.openpty()
    tty.setraw(theirs)
    print(os.ttyname(theirs), flush=True)
    printer = Timed(Settings(), Profiles(), FOLDER)

    def answer():
        while True:
            if line := printer.readline():
                os.write(own, line.rstrip() + b"\n")

    threading.Thread(target=answer, daemon=True).start()
    while data := os.read(own, 1024):
        printer.write(data)


if __name__ == "__main__":
    main()
