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


def code_hash(modules: Iterable[str] = (), root: Path | None = None) -> str:
    """SHA-256 of the statements of modules, and of those that they import from the rooms, anywhere in them.

    Files of package data count by their bytes where a module names one that lies next to it. What is imported by a name
    that is computed is not found: name it too. modules: by their dotted names in softslide, or files by their paths
    from root; none: all modules. root: the folder that holds the rooms (default: this project's).

    Raises:
        ValueError: there is no such module or file.
    """
    root = ROOT if root is None else root
    named = list(modules) or _all_modules(root)
    if missing := [name for name in named if _file_of(name, root) is None]:
        raise ValueError(f"{root}: holds no {missing[0]}")
    digest = hashlib.sha256()
    for path in _closure(named, root):
        content = path.read_bytes()
        found = _read(content).encode() if path.suffix == ".py" else content
        digest.update(f"{path.relative_to(root).as_posix()}\0".encode())
        digest.update(hashlib.sha256(found).digest())
    return digest.hexdigest()


def _all_modules(root: Path) -> list[str]:
    files = [path.relative_to(root) for room in ROOMS for path in (root / room).rglob("*.py")]
    return [".".join(file.with_suffix("").parts).removesuffix(".__init__") for file in files]


def _closure(modules: Iterable[str], root: Path) -> list[Path]:
    """The files of modules, of all that they import, and of package data that is named there."""
    found: set[Path] = set()
    waiting = list(modules)
    while waiting:
        path = _file_of(waiting.pop(), root)
        if path is None or path in found:
            continue
        found.add(path)
        if path.suffix != ".py":
            continue
        imported, files = _names(path.read_bytes())
        found |= {path.parent / file for file in files if (path.parent / file).is_file()}
        waiting += [name for name in map(_in_rooms, imported) if name.partition(".")[0] in ROOMS]
    return sorted(found)


def _in_rooms(module: str) -> str:
    return module.removeprefix("softslide.")


def _file_of(module: str, root: Path) -> Path | None:
    module = _in_rooms(module)
    place = root.joinpath(*module.split("."))
    files = (
        (root / module,) if "/" in module else (place.with_name(f"{place.name}.py"), place / "__init__.py")
    )
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
