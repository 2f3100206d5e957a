"""Text of a comma-separated table: what it is is found before it is parsed.

A spreadsheet saves many things under the name of a table. Each gets the remedy that helps.
"""

from pathlib import Path

from softslide.features.errors import InputError
from softslide.features.regular_file import read_regular

# A line of names beyond this is not a header.
MOST_HEADER_BYTES = 1 << 16
MOST_COLUMNS = 1000
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}


def table_text(path: Path, missing: str, most_bytes: int, delimiter: str = ",") -> str:
    """The file's text, with a header that may be one. missing: what to do where there is no such file.

    Raises:
        InputError: no regular file, too large, another encoding or kind of file, separated by something else, or a name
            twice in the header.
    """
    text = _decoded(path, read_regular(path, most_bytes, missing))
    header = text.partition("\n")[0].strip("\r")
    if not text.strip():
        raise InputError(f"{path}: the file is empty; write a header and a row for each entry")
    if len(header.encode()) > MOST_HEADER_BYTES or header.count(delimiter) >= MOST_COLUMNS:
        raise InputError(f"{path}: its first line is too long for a header; is it a table?")
    other = next((name for mark, name in SEPARATORS.items() if mark in header), "")
    if delimiter == "," and "," not in header and other:
        raise InputError(
            f"{path}: separated by {other}, not by commas; save it with commas, and with points in numbers"
        )
    names = [name.strip().strip('"') for name in header.split(delimiter)]
    if twice := [name for n, name in enumerate(names) if name and name in names[:n]]:
        raise InputError(f"{path}: column '{twice[0][:40]}' comes twice; rename or remove one")
    return text


def _decoded(path: Path, content: bytes) -> str:
    if content.startswith(b"PK\x03\x04"):
        raise InputError(f"{path}: a workbook or a zip, not text; save the sheet as CSV UTF-8")
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: in UTF-16; save it as CSV UTF-8")
    if b"\0" in content:
        raise InputError(f"{path}: holds zero bytes, so it is no text or damaged; copy it again")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}: line {row} is not in UTF-8 (as Windows' cp1252 is not); save it as CSV UTF-8"
        ) from None
