"""What the code of a result does, as a hash: of modules and of all that they import here.

Comments, docstrings and layout do not count, so that an edit of prose makes no figure old.
"""

import ast
import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from softslide import ROOMS as ROOMS

ROOT = Path(__file__).parents[1]
# Files of package data that figures depend on; a module names them by these.
DATA = (".npz", ".toml")


def code_hash(modules: Iterable[str] = ()) -> str:
    """SHA-256 of the statements of modules, and of those that they import from the rooms, anywhere in them.

    Files of package data count by their bytes where a module names one that lies next to it. What is imported by a name
    that is computed is not found: name it too. modules: by their dotted names in softslide, or files by their paths
    from ROOT; none: all modules.

    Raises:
        ValueError: there is no such module or file.
    """
    named = list(modules) or [_place(path) for room in ROOMS for path in (ROOT / room).rglob("*.py")]
    if missing := [name for name in named if _file_of(name) is None]:
        raise ValueError(f"{ROOT}: holds no {missing[0]}")
    digest = hashlib.sha256()
    for path in _closure(named):
        content = path.read_bytes()
        found = _read(content).encode() if path.suffix == ".py" else content
        digest.update(f"{_place(path)}\0".encode())
        digest.update(hashlib.sha256(found).digest())
    return digest.hexdigest()


def _place(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _closure(modules: Iterable[str]) -> list[Path]:
    """The files of modules, of all that they import, and of package data that is named there."""
    found: set[Path] = set()
    waiting = list(modules)
    while waiting:
        path = _file_of(waiting.pop())
        if path is None or path in found:
            continue
        found.add(path)
        if path.suffix != ".py":
            continue
        imported, files = _names(path.read_bytes())
        found |= {path.parent / file for file in files if (path.parent / file).is_file()}
        waiting += imported
    return sorted(found)


def _file_of(module: str) -> Path | None:
    """A file that is named by its path, or that of a module in the rooms; None: there is no such file."""
    if "/" in module:
        files = [ROOT / module]
    else:
        room, *inside = module.removeprefix("softslide.").split(".")
        place = ROOT.joinpath(room, *inside)
        files = [place.with_name(f"{place.name}.py"), place / "__init__.py"] if room in ROOMS else []
    return next((file for file in files if file.is_file()), None)


@cache
def _names(source: bytes) -> tuple[frozenset[str], frozenset[str]]:
    """What a module may import, with the packages it lies in, and the texts in it that may name a file of data."""
    imported: set[str] = set()
    files: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            # The name may be a module's or something in one.
            imported |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.endswith(DATA):
            files.add(node.value)
    packages = {name.rsplit(".", n)[0] for name in imported for n in range(1, name.count(".") + 1)}
    return frozenset(imported | packages), frozenset(files)


@cache
def _read(source: bytes) -> str:
    return _words(ast.parse(source))


def _words(node: Any) -> str:
    """A syntax tree as words, without docstrings and other texts that nothing is done with.

    What is empty is left out: `ast.dump` shows fields that another version of Python lacks.
    """
    if isinstance(node, ast.AST):
        known = {name: getattr(node, name, None) for name in node._fields}
        parts = [
            f"{name} {_words(value)}" for name, value in known.items() if value is not None and value != []
        ]
        return f"{type(node).__name__}({' '.join(parts)})"
    if isinstance(node, list):
        return f"[{' '.join(_words(each) for each in node if not _is_text(each))}]"
    return repr(node)


def _is_text(node: Any) -> bool:
    value = getattr(node, "value", None) if isinstance(node, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)
