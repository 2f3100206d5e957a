"""Names that people give: of sensors, accelerometers, models and recordings.

They are written into C, HTML, tables and terminals, and files are called by them. So a name holds no quotes, no control
characters, none of the signs by which these begin or end something, nothing that a spreadsheet would compute, and
nothing that Windows takes for a drive, a stream or a device.
"""

import re

SIGNS = " ._,;()[]{}+#&'%=@~^-"
MOST_SIGNS = 200
REMEDY = (
    f"letters, digits and {SIGNS.strip()} alone, none of = + @ at the start and - only before a number, no dot or "
    "space at an end, and no device of Windows (CON, NUL, COM1); rename it"
)
# Before the first dot, whatever follows it.
DEVICE = re.compile(r"(con|prn|aux|nul|(com|lpt)[0-9¹²³]) *(\..*)?", re.IGNORECASE)
NUMBER = re.compile(r"-\d[\w., ]*")


def is_plain(name: str) -> bool:
    """Whether a name can be written anywhere as it is."""
    if not 0 < len(name) <= MOST_SIGNS or not all(c.isalnum() or c in SIGNS for c in name):
        return False
    if name != name.strip() or name.endswith(".") or DEVICE.fullmatch(name):
        return False
    return name[0] not in "=+-@" or NUMBER.fullmatch(name) is not None


def check_plain(name: str, what: str) -> None:
    """Sees that `name` is plain. what: names it in the error.

    Raises:
        ValueError: it is not.
    """
    if not is_plain(name):
        raise ValueError(f"{what} is {name[:60]!r}; a name holds {REMEDY}")
