"""What `softslide record` says to an operator and asks, with the live level next to it."""

import math
import select
import sys
from collections.abc import Callable

from softslide.experiments.acquisition.capture import Phases

BAR = 30  # characters
REDRAW_S = 0.1
LOWEST_V, HIGHEST_V = 1e-3, 0.3  # the bar's ends: about a block's noise, and the article's largest outputs


class Stopped(Exception):
    """The operator stops."""


class Operator:
    """Asks on standard error and reads answers from standard input; where `absent`, every default is taken."""

    def __init__(self, absent: bool) -> None:
        self.absent, self._watched = absent, sys.stderr.isatty()

    def say(self, text: str) -> None:
        """One line."""
        print(f"{self._clear()}{text}", file=sys.stderr, flush=True)

    def ask(self, question: str, live: Callable[[], str] = str) -> str:
        """The first letter of the answer, in lower case; "" for the default.

        live: what to show next to the question while a person thinks.

        Raises:
            Stopped: the answer is "q", or the input has ended.
        """
        if self.absent:
            return ""
        self.say(f"{question}, q stops:")
        if self._watched and sys.stdin.isatty():
            while not select.select([sys.stdin], [], [], REDRAW_S)[0]:
                self.show(live())
        answer = sys.stdin.readline()
        letter = answer.strip().lower()[:1]
        if not answer or letter == "q":
            raise Stopped
        return letter

    def show(self, text: str) -> None:
        """A line that the next one replaces; only where a person watches."""
        if self._watched:
            print(f"{self._clear()}{text}", end="", file=sys.stderr, flush=True)

    def guide(self, phases: Phases, is_driven: bool) -> Callable[[float, float], None]:
        """Says what to do as a recording goes on, which it is given the s of, and the level (V).

        is_driven: a stage moves the ball.
        """
        ends = (
            (phases.rest_s, "rest: hands off"),
            (phases.rest_s + phases.start_s, "the stage goes" if is_driven else "go: start the stage now"),
            (phases.whole_s - phases.rest_s, "motion"),
            (math.inf, "rest: hands off until the end"),
        )
        said: list[str] = []

        def show(recorded_s: float, level_v: float) -> None:
            end, phase = next((end, phase) for end, phase in ends if recorded_s < end)
            if phase not in said:
                said.append(phase)
                self.say(f"  {phase}")
            left_s = min(end, phases.whole_s) - recorded_s
            self.show(f"  {level_bar(level_v)}  {max(left_s, 0.0):4.0f} s")

        return show

    def _clear(self) -> str:
        return "\r\x1b[K" if self._watched else ""


def level_bar(volts: float) -> str:
    """A deviation in V as a bar on a logarithmic scale, and in mV."""
    share = math.log(max(volts, LOWEST_V) / LOWEST_V) / math.log(HIGHEST_V / LOWEST_V)
    full = round(BAR * min(share, 1.0))
    return f"|{'#' * full}{' ' * (BAR - full)}| {1e3 * volts:6.1f} mV"
