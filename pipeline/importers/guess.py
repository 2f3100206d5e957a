"""`softslide import --guess`: a map from a lab's files themselves, with what is unsure in its comments."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import tomli_w

from softslide.features.errors import InputError
from softslide.features.units import STANDARD_GRAVITY
from softslide.pipeline.importers.import_map import PER_SECOND, Map
from softslide.pipeline.importers.readers.delimited import CsvLayout
from softslide.pipeline.importers.readers.layout_guess import TIMESTAMP, guess_layout
from softslide.pipeline.importers.readers.registry import READERS
from softslide.pipeline.importers.sources import inside, kind_of

TIME = re.compile(r"t|time|zeit|temps|stamp|timestamp|clock", re.IGNORECASE)
# Units by what they are called, in small letters.
UNITS = {name: name for name in ("s", "ms", "us", "ns", "g", "m/s2", "counts")}
UNITS |= {"µs": "us", "m/s²": "m/s2", "m/s^2": "m/s2", "lsb": "counts", "v": "V", "mv": "mV"}
UNIT = re.compile(r"[\[(/_ ]\s*(s|ms|us|µs|ns|V|mV|g|m/s2|m/s²|m/s\^2|counts|lsb)\s*[\])]?$", re.IGNORECASE)
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
# Labels in the files' names: the word before each (none before XF and the like), and the pattern of both.
Labels = dict[str, tuple[str, str]]
XF_LINES = ["values = {XF = 0, YF = 90, XB = 180, YB = 270}", "# XF: X forward"]


@dataclass(frozen=True)
class Look:
    """What a delimited file looks like.

    units: of the columns, empty where not known. values: the first rows (n, columns). time: the column of times, None
    where there is none; time_unit: its unit.
    """

    layout: CsvLayout
    names: list[str]
    units: list[str]
    values: np.ndarray
    time: int | None
    time_unit: str


def guess_map(sources: Sequence[Path]) -> str:
    """The text of a map of delimited files, as TOML; a comment that begins with `unsure` where the files do not say.

    Raises:
        InputError: no such file, or another kind than delimited text, for which there is a template.
    """
    # Each with the folders that lie between it and its source.
    found = {
        path: path.relative_to(source).parts[:-1]
        for source in sources
        for path in inside(source)
        if path.is_file()
    }
    kind = kind_of([*found])
    if not kind:
        raise InputError(f"{', '.join(map(str, sources))}: no file of a known kind; name the lab's files")
    if kind != "csv":
        raise InputError(
            f"{next(iter(found))}: only delimited text is guessed from; begin from the template of {kind}"
        )
    files = [path for path in found if path.suffix.lower() in READERS["csv"].suffixes]
    is_split = all(any(re.fullmatch(SPLIT, name) for name in found[path]) for path in files)
    look, labels = _look(files[0]), _labels_in(files)
    lines = [
        f"# Guessed from {files[0].name} and the names of {len(files)} files. Read the lines marked unsure.",
        'kind = "csv"',
        'sensor = "sensor.toml"',
        "",
        _pattern(files, is_split, labels),
        'signs = "zones"',
        "",
        "[csv]",
        *layout_lines(look.layout),
        "",
        *_clock(look),
        "",
        *_channels(look),
        "[labels.split]",
        'name = "split"' if is_split else 'value = "calibration"  # unsure: which are for tests',
        "",
    ]
    for label, (word, _) in labels.items():
        lines += [f"[labels.{label}]", f'name = "{_group(label)}"']
        lines += [f"# unsure: what stands after '{word}' in the names"] if word else XF_LINES
        lines += [""]
    return "\n".join([*lines, ""])


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
        look = _look(path)
    except InputError:
        return ""
    layout, clock = look.layout, (mapping.time.column, mapping.time.unit)
    if not mapping.csv.encoding.startswith("utf-8"):
        layout = replace(layout, encoding=mapping.csv.encoding)
    lines = [f"[csv] {line}" for line in layout_lines(layout, mapping.csv)]
    if not lines and look.time is not None and (look.names[look.time], look.time_unit) != clock:
        lines = [f"[time] {line}" for line in _clock(look)[1:3]]
    return f"; it looks like {', '.join(lines)}, as import --guess shows" if lines else ""


def _look(path: Path) -> Look:
    """Raises InputError as `guess_layout`."""
    layout, names, units, rows = guess_layout(path)
    values = np.array([[_number(cell, layout.decimal) for cell in row] for row in rows])
    units = [_unit(name, unit) for name, unit in zip(names, units, strict=True)]
    return Look(layout, names, units, values, *_time(names, units, values, rows[0]))


def _number(cell: str, decimal: str) -> float:
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return np.nan


def _unit(name: str, unit: str) -> str:
    found = unit or (match[1] if (match := UNIT.search(name)) else "")
    return UNITS.get(found.lower(), "")


def _time(names: list[str], units: list[str], values: np.ndarray, row: list[str]) -> tuple[int | None, str]:
    """The column of times, None where there is none, and its unit. row: the first one's cells."""
    steady = [k for k in range(len(names)) if (np.diff(values[:, k]) > 0).all()]
    # Those that are called so come first.
    steady.sort(key=lambda k: not TIME.fullmatch(re.split(r"[\W_]", names[k].strip())[0]))
    for k in steady:
        if units[k]:
            return k, units[k]
        step = float(np.median(np.diff(values[:, k])))
        # The unit of the names is the unit of most; else the rate that is an accelerometer's.
        fit = [u for u, count in PER_SECOND.items() if RATES_HZ[0] <= count / step <= RATES_HZ[1]]
        if fit:
            return k, fit[0]
    stamped = [k for k, cell in enumerate(row) if TIMESTAMP.match(cell)]
    return (stamped[0], "timestamp") if stamped else (None, "")


def _clock(look: Look) -> list[str]:
    if look.time is None:
        return ["[time]", "rate_hz = 1000.0  # unsure: the files hold no times"]
    keys = {"column": look.names[look.time], "unit": look.time_unit}
    lines = ["[time]", *tomli_w.dumps(keys).splitlines()]
    if look.time_unit == "timestamp":
        return lines
    rate = PER_SECOND[look.time_unit] / float(np.median(np.diff(look.values[:, look.time])))
    return [*lines, f"# {rate:.6g} Hz by these times: sample_rate_hz of sensor.toml"]


def _channels(look: Look) -> list[str]:
    """The outputs, three an accelerometer: by the letter that their names end with, else in their order."""
    signals = [k for k in range(len(look.names)) if k != look.time and np.ptp(look.values[:, k]) > 0]
    axes: dict[str, dict[str, int]] = {}
    for k in signals:
        bare = UNIT.sub("", look.names[k]).strip()
        if match := re.search(r"(.*?)v?([xyz])(\d*)$", bare, re.IGNORECASE):
            axes.setdefault((match[1] + match[2]).lower().strip("_ -."), {})[match[2].lower()] = k
    groups = [group for group in axes.values() if len(group) == 3]
    doubt = ""
    if not groups:
        threes = range(0, len(signals) - 2, 3)
        groups = [dict(zip("xyz", signals[n : n + 3], strict=True)) for n in threes]
        doubt = "  # unsure: in the order of the columns"
    if not groups:
        names = ", ".join(look.names)
        return [f"# unsure: which of {names} are V_x, V_y, V_z", "[channels.a0_vx]", 'column = ""']
    lines = []
    for number, group in enumerate(groups):
        by_size = _by_size(look.values[:, [*group.values()]])
        for axis, k in group.items():
            column, unit = tomli_w.dumps({"column": look.names[k]}).strip(), look.units[k] or by_size
            unsure = "" if look.units[k] else "  # unsure: by its size at rest"
            lines += [f"[channels.a{number}_v{axis}]", f"{column}{doubt}", f'unit = "{unit}"{unsure}']
            lines += ["volts_per_count = 0.001  # unsure"] if unit == "counts" else []
    named = "as many [[accelerometer]] in sensor.toml, named a0, a1, ..."
    return [*lines, f"# {len(groups)} accelerometers: {named}", ""]


def _by_size(values: np.ndarray) -> str:
    """The unit of three outputs, from their length at rest."""
    length = float(np.linalg.norm(np.median(values, axis=0)))
    if abs(length / STANDARD_GRAVITY - 1) < 0.1:
        return "m/s2"
    if abs(length - 1) < 0.1:
        return "g"
    return "V" if length < 20 else "mV" if length < 8000 else "counts"


def _pattern(files: Sequence[Path], is_split: bool, labels: Labels) -> str:
    """Of the file's name; of its path where folders are called as splits are, or hold files of the same name."""
    twice = len({path.name for path in files}) < len(files)
    start = f"(?P<split>{SPLIT})/.*?" if is_split else ""
    groups = r"[^/]*?" + "".join(f"{part}[^/]*?" for _, part in labels.values())
    return rf"pattern = '{start}(?P<recording>{'[^/]+/' if twice else ''}{groups})\.[^.]*$'"


def _group(label: str) -> str:
    return re.sub("_(mm_s|mm|deg|mpa)$", "", label)


def _labels_in(files: Sequence[Path]) -> Labels:
    """The labels that every file's name holds, in the first one's order."""
    found: Labels = {}
    for match in re.finditer(rf"([A-Za-zÄÖÜäöü]+)[=_-]?[-+]?{NUMBER}|{EDGE}{AXIS}{EDGE}", files[0].stem):
        word = match[1] or ""
        label = next((name for name, words in WORDS.items() if word.lower() in words), "")
        # A minus before what has no sign is a dash.
        between, value = ("[=_]?", rf"[-+]?{NUMBER}") if label in SIGNED else ("[=_-]?", NUMBER)
        part = f"{re.escape(word)}{between}(?P<{_group(label)}>{value})"
        if not word:
            label, part = "direction_deg", f"{EDGE}(?P<direction>{AXIS}){EDGE}"
        if label and all(re.search(part, path.stem) for path in files):
            found.setdefault(label, (word, part))
    return found
