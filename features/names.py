"""Names that people give: of sensors, accelerometers, models and recordings.

They are written into C, HTML, tables and terminals. So a name holds no quotes, no control characters, none of the signs
by which these begin or end something, and nothing that a spreadsheet would compute.
"""

SIGNS = " ._,:;()[]{}+#&'%=@~^-"
MOST_SIGNS = 200
REMEDY = f"letters, digits and {SIGNS.strip()} alone, and neither = nor @ at the start; rename it"


def is_plain(name: str) -> bool:
    """Whether a name can be written anywhere as it is."""
    if not 0 < len(name) <= MOST_SIGNS or not all(c.isalnum() or c in SIGNS for c in name):
        return False
    return name[0] not in "=@" and not (name[0] in "+-" and "(" in name)


def check_plain(name: str, what: str) -> None:
    """Sees that `name` is plain. what: names it in the error.

    Raises:
        ValueError: it is not.
    """
    if not is_plain(name):
        raise ValueError(f"{what} is {name[:60]!r}; a name holds {REMEDY}")
