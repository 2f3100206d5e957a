"""The one exception that means: the input is wrong, and the user can mend it."""


class InputError(ValueError):
    """Bad input or usage. The message is one line: the file, the row or column, what is wrong, what to do.

    The front door turns it into exit status 2.
    """
