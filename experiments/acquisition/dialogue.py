"""What `softslide record` says to an operator and asks, with the live level next to it."""

import math
import select
import sys
from collections.abc import Callable

BAR = 30  # characters
REDRAW_S = 0.1
LOWEST_V, HIGHEST_V = 1e-3, 0.3  # the bar's ends: about a block's noise, and the article's largest outputs


class Operator:
    """Asks on standard error and reads answers from standard input; where `absent`, every default is taken."""

    def __init__(self, absent: bool) -> None:
        self.absent, self._watched = absent, sys.stderr.isatty()

    def say(self, text: str) -> None:
        """One line."""
        print(f"{self._clear()}{text}", file=sys.stderr, flush=True)

    def ask(self, question: str, live: Callable[[], str]) -> str:
        """The first letter of the answer, in lower case; "" for the default, "q" at the input's end.

        live: what to show next to the question while a person thinks.
        """
        if self.absent:
            return ""
        self.say(question)
        if self._watched and sys.stdin.isatty():
            while not select.select([sys.stdin], [], [], REDRAW_S)[0]:
                self.show(live())
        answer = sys.stdin.readline()
        return answer.strip().lower()[:1] if answer else "q"

    def show(self, text: str) -> None:
        """A line that the next one replaces; only where a person watches."""
        if self._watched:
            print(f"{self._clear()}{text}", end="", file=sys.stderr, flush=True)

    def _clear(self) -> str:
        return "\r\x1b[K" if self._watched else ""


def level_bar(volts: float) -> str:
    """A deviation in V as a bar on a logarithmic scale, and in mV."""
    share = math.log(max(volts, LOWEST_V) / LOWEST_V) / math.log(HIGHEST_V / LOWEST_V)
    full = round(BAR * min(share, 1.0))
    return f"|{'#' * full}{' ' * (BAR - full)}| {1e3 * volts:6.1f} mV"
