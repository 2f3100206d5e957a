"""`softslide import --guess`: a map from a lab's files themselves, with what is unsure in its comments."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import tomli_w

from softslide.features.errors import InputError
from softslide.features.units import STANDARD_GRAVITY
from softslide.pipeline.importers.import_map import Map
from softslide.pipeline.importers.readers.delimited import CsvLayout
from softslide.pipeline.importers.readers.layout_guess import TIMESTAMP, guess_layout
from softslide.pipeline.importers.readers.registry import READERS

TIME = re.compile(r"t|time|zeit|temps|stamp|timestamp|clock", re.IGNORECASE)
UNIT = re.compile(r"[\[(/_ ]\s*(s|ms|us|µs|ns|V|mV|g|m/s2|m/s²|m/s\^2|counts|lsb)\s*[\])]?$", re.IGNORECASE)
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
RATES_HZ = (50.0, 2e5)  # between which accelerometers are sampled
SIGNED = ("offset_mm", "start_x_mm", "start_y_mm")
# The words that stand before a label's number in file names, in English and German.
WORDS = {
    "direction_deg": ("direction", "dir", "angle", "ang", "heading", "deg", "richtung", "winkel"),
    "speed_mm_s": ("speed", "velocity", "vel", "v", "geschwindigkeit"),
    "offset_mm": ("offset", "off", "dist", "abstand"),
    "depth_mm": ("depth", "z", "tiefe", "indent"),
    "pressure_mpa": ("pressure", "mpa", "druck"),
    "start_x_mm": ("x", "startx"),
    "start_y_mm": ("y", "starty"),
    "travel_mm": ("travel", "length", "weg", "hub"),
}
NUMBER = r"\d+(?:\.\d+)?"
SPLIT = r"(?:calibration|train|test)[\w-]*"
AXIS = "[XY][FB]"  # X forward and so on, between what is no letter
EDGE = r"(?:\b|[_\d])"
# A label, by the word before it in the names, what stands between, and its pattern.
Labels = dict[str, tuple[str, str, str]]
DIRECTIONS = "{XF = 0, YF = 90, XB = 180, YB = 270}"


def guess_map(sources: Sequence[Path]) -> str:
    """The text of a map of delimited files, as TOML; a comment that begins with `unsure` where the files do not say.

    Raises:
        InputError: no such file, or another kind than delimited text, for which there is a template.
    """
    # Each with the folders that lie between it and its source.
    found = {path: folders for source in sources for path, folders in _files(source)}
    files = list(found)
    kind = kind_of(files)
    if not kind:
        raise InputError(f"{', '.join(map(str, sources))}: no file of a known kind; name the lab's files")
    if kind != "csv":
        raise InputError(
            f"{files[0]}: only delimited text is guessed from; begin from the template of {kind}"
        )
    files = [path for path in files if path.suffix.lower() in READERS["csv"].suffixes]
    is_split = all(any(re.fullmatch(SPLIT, name) for name in found[path]) for path in files)
    layout, names, units, values, time, seconds = _looked_at(files[0])
    labels = _found(files)
    signals = [k for k in range(len(names)) if k != time and np.ptp(values[:, k]) > 0]
    lines = [
        f"# Guessed from {files[0].name} and the names of {len(files)} files. Read the lines marked unsure."
    ]
    lines += [
        'kind = "csv"',
        'sensor = "sensor.toml"',
        "",
        *_pattern(files, is_split, labels),
        'signs = "zones"',
        "",
    ]
    lines += ["[csv]", *layout_lines(layout), "", *_clock(names, time, seconds, values), ""]
    lines += _channels(names, units, values, signals)
    return "\n".join([*lines, *_labels(is_split, labels), ""])


def kind_of(files: Sequence[Path]) -> str:
    """The kind of most of the files, by their endings; empty where none is known."""
    known = {ending: kind for kind, reader in READERS.items() for ending in reader.suffixes}
    kinds = Counter(known[path.suffix.lower()] for path in files if path.suffix.lower() in known)
    return max(kinds, key=kinds.__getitem__, default="")


def layout_lines(layout: CsvLayout, other: CsvLayout | None = None) -> list[str]:
    """The keys of `[csv]`; those alone that another layout has otherwise, if one is given."""
    shown = {f.name: getattr(layout, f.name) for f in fields(layout) if f.name != "open_end"}
    kept = {name: v for name, v in shown.items() if other is None or getattr(other, name) != v}
    return tomli_w.dumps(kept).splitlines()


def cure(path: Path, mapping: Map) -> str:
    """What the map would say of a file that looks otherwise, as the end of a message; empty where they agree."""
    if mapping.kind != "csv":
        return ""
    try:
        layout, names, _, values, time, unit = _looked_at(path)
    except InputError:
        return ""
    if not mapping.csv.encoding.startswith("utf-8"):
        layout = replace(layout, encoding=mapping.csv.encoding)
    lines = [f"[csv] {line}" for line in layout_lines(layout, mapping.csv)]
    if not lines and time is not None and (names[time], unit) != (mapping.time.column, mapping.time.unit):
        lines = [f"[time] {line}" for line in _clock(names, time, unit, values)[1:3]]
    return f"; it looks like {', '.join(lines)}, as import --guess shows" if lines else ""


def _looked_at(path: Path) -> tuple[CsvLayout, list[str], list[str], np.ndarray, int | None, str]:
    """A file's layout, its columns' names and units, its first rows (n, columns), the column of times and its unit.

    Raises:
        InputError: as `guess_layout`.
    """
    layout, names, units, rows = guess_layout(path)
    values = np.array([[_number(cell, layout.decimal) for cell in row] for row in rows])
    return layout, names, units, values, *_time(names, units, values, rows)


def _text(value: str) -> str:
    return tomli_w.dumps({"x": value}).partition("= ")[2].strip()


def _files(source: Path) -> list[tuple[Path, tuple[str, ...]]]:
    if not source.exists():
        raise InputError(f"{source}: no such file or folder; name one that exists")
    if not source.is_dir():
        return [(source, ())]
    inside = sorted(path for path in source.rglob("*") if path.is_file())
    return [(path, path.relative_to(source).parent.parts) for path in inside]


def _number(cell: str, decimal: str) -> float:
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return np.nan


def _unit(name: str, unit: str) -> str:
    found = unit or (match[1] if (match := UNIT.search(name)) else "")
    known = {"µs": "us", "m/s²": "m/s2", "m/s^2": "m/s2", "lsb": "counts", "v": "V", "mv": "mV"}
    known |= {unit: unit for unit in ("s", "ms", "us", "ns", "g", "m/s2", "counts")}
    return known.get(found.lower(), "")


def _time(
    names: list[str], units: list[str], values: np.ndarray, rows: list[list[str]]
) -> tuple[int | None, str]:
    """The column of times, None where there is none, and its unit."""
    named = [k for k, name in enumerate(names) if TIME.fullmatch(re.split(r"[\W_]", name.strip())[0])]
    steady = [k for k in range(len(names)) if (np.diff(values[:, k]) > 0).all()]
    for k in [*[k for k in named if k in steady], *steady]:
        if unit := _unit(names[k], units[k]):
            return k, unit
        step = float(np.median(np.diff(values[:, k])))
        # The unit of the names is the unit of most; else the rate that is an accelerometer's.
        fit = [u for u, s in SECONDS.items() if RATES_HZ[0] <= 1 / (step * s) <= RATES_HZ[1]]
        if fit:
            return k, fit[0]
    stamped = [k for k in range(len(names)) if TIMESTAMP.match(rows[0][k])]
    return (stamped[0], "timestamp") if stamped else (None, "")


def _clock(names: list[str], time: int | None, unit: str, values: np.ndarray) -> list[str]:
    if time is None:
        return ["[time]", "rate_hz = 1000.0  # unsure: the files hold no times"]
    lines = ["[time]", f"column = {_text(names[time])}", f"unit = {_text(unit)}"]
    if unit == "timestamp":
        return lines
    rate = 1 / (float(np.median(np.diff(values[:, time]))) * SECONDS[unit])
    return [*lines, f"# {rate:.6g} Hz by these times: sample_rate_hz of sensor.toml"]


def _channels(names: list[str], units: list[str], values: np.ndarray, signals: list[int]) -> list[str]:
    """The outputs, three an accelerometer: by the letter that their names end with, else in their order."""
    axes: dict[str, dict[str, int]] = {}
    for k in signals:
        bare = UNIT.sub("", names[k]).strip()
        if match := re.search(r"(.*?)v?([xyz])(\d*)$", bare, re.IGNORECASE):
            axes.setdefault((match[1] + match[2]).lower().strip("_ -."), {})[match[2].lower()] = k
    groups = [group for group in axes.values() if len(group) == 3]
    doubt = ""
    if not groups:
        groups = [dict(zip("xyz", signals[n : n + 3], strict=False)) for n in range(0, len(signals), 3)]
        groups = [group for group in groups if len(group) == 3]
        doubt = "  # unsure: in the order of the columns"
    if not groups:
        return [f"# unsure: which of {', '.join(names)} are V_x, V_y, V_z", "[channels.a0_vx]", 'column = ""']
    lines = []
    for number, group in enumerate(groups):
        for axis, k in group.items():
            unit = _unit(names[k], units[k])
            unsure = "" if unit else "  # unsure: by its size at rest"
            unit = unit or _by_size(values[:, [*group.values()]])
            lines += [f"[channels.a{number}_v{axis}]", f"column = {_text(names[k])}{doubt}"]
            lines += [f"unit = {_text(unit)}{unsure}"]
            lines += ["volts_per_count = 0.001  # unsure"] if unit == "counts" else []
    return [
        *lines,
        f"# {len(groups)} accelerometers: as many [[accelerometer]] in sensor.toml, named a0, a1, ...",
        "",
    ]


def _by_size(values: np.ndarray) -> str:
    """The unit of three outputs, from their length at rest."""
    length = float(np.linalg.norm(np.median(values, axis=0)))
    if abs(length / STANDARD_GRAVITY - 1) < 0.1:
        return "m/s2"
    if abs(length - 1) < 0.1:
        return "g"
    return "V" if length < 20 else "mV" if length < 8000 else "counts"


def _pattern(files: Sequence[Path], is_split: bool, labels: Labels) -> list[str]:
    """Of the file's name; of its path where folders are called as splits are, or hold files of the same name."""
    twice = len({path.name for path in files}) < len(files)
    start = f"(?P<split>{SPLIT})/.*?" if is_split else ""
    parts = [
        f"{re.escape(word)}{between}(?P<{_group(label)}>{number}){'' if word else EDGE}"
        for label, (word, between, number) in labels.items()
    ]
    groups = r"[^/]*?" + "".join(f"{part}[^/]*?" for part in parts)
    return [rf"pattern = '{start}(?P<recording>{'[^/]+/' if twice else ''}{groups})\.[^.]*$'"]


def _group(label: str) -> str:
    return label.removesuffix("_mm_s").removesuffix("_mm").removesuffix("_deg").removesuffix("_mpa")


def _found(files: Sequence[Path]) -> Labels:
    """Labels that every file's name holds, in its order: the word before each, what stands between, and its pattern."""
    found: Labels = {}
    for match in re.finditer(rf"([A-Za-zÄÖÜäöü]+)[=_-]?[-+]?{NUMBER}|{EDGE}{AXIS}{EDGE}", files[0].stem):
        word = match[1] or ""
        label = next((name for name, words in WORDS.items() if word.lower() in words), "")
        # A minus before what has no sign is a dash.
        between, number = ("[=_]?", rf"[-+]?{NUMBER}") if label in SIGNED else ("[=_-]?", NUMBER)
        if not word:
            label, between, number = "direction_deg", EDGE, AXIS
        pattern = re.escape(word) + between + number + ("" if word else EDGE)
        if label and all(re.search(pattern, path.stem) for path in files):
            found.setdefault(label, (word, between, number))
    return found


def _labels(is_split: bool, labels: Labels) -> list[str]:
    split = 'name = "split"' if is_split else 'value = "calibration"  # unsure: which are for tests'
    lines = ["[labels.split]", split, ""]
    for label, (word, _, number) in labels.items():
        lines += [f"[labels.{label}]", f'name = "{_group(label)}"']
        lines += [f"values = {DIRECTIONS}"] if number == AXIS else []
        lines += [f"# unsure: what stands after '{word}' in the names" if word else "# XF: X forward", ""]
    return lines
