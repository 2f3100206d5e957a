"""The two errors that the command line reports in one line."""


class InputError(ValueError):
    """Bad input or usage: exit status 2. The message is one line: file, row or column, what is wrong, what to do.

    parameter: the function's parameter that holds the bad value, if it is that and not a file's content. The message
    then begins with its name, and the command line shows it as the option of the same name.
    """

    def __init__(self, message: str, parameter: str = "") -> None:
        super().__init__(f"{parameter} {message}" if parameter else message)
        self.parameter = parameter


class CheckFailed(RuntimeError):
    """A result did not pass the project's own check of it and was not written: exit status 1."""
