"""The exception for input that the user has to correct."""


class InputError(ValueError):
    """Bad input or usage. The message is one line: the file, the row or column, what is wrong, what to do.

    The front door turns it into exit status 2.
    """
