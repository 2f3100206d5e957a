"""The two errors that the command line reports in one line."""

LONGEST = 1000  # characters of a message: a path, a place, what is wrong and what to do


class InputError(ValueError):
    """Bad input or usage: exit status 2. The message is one line: file, row or column, what is wrong, what to do.

    parameter: the function's parameter that holds the bad value, if it is that and not a file's content. The message
    then begins with its name, and the command line shows it as the option of the same name.
    """

    def __init__(self, message: str, parameter: str = "") -> None:
        super().__init__(printable(f"{parameter} {message}" if parameter else message))
        self.parameter = parameter


def printable(text: str) -> str:
    """One line for a terminal: what does not print (control characters, line ends, other directions of writing) is
    escaped, and the middle of what is longer than LONGEST is left out. Messages show what a file holds."""
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return shown if len(shown) <= LONGEST else f"{shown[: LONGEST // 2]} ... {shown[-LONGEST // 2 :]}"


class CheckFailed(RuntimeError):
    """A result did not pass the project's own check of it and was not written: exit status 1."""
