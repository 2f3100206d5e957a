"""A lab's files for the importer's tests, each written by its format's own library."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pandas as pd
import scipy.io
from nptdms import ChannelObject, TdmsWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from softslide.pipeline.sensor import Accelerometer, Sensor, write_sensor

RATE_HZ = 100.0
HEAD = 'kind = "{kind}"\nsensor = "sensor.toml"\npattern = \'{pattern}\'\n{top}\n[time]\n{time}\n'
OUTPUTS = ("a0_vx", "a0_vy", "a0_vz")


def a_sensor() -> Sensor:
    parts = (Accelerometer("a0", 5.0, 0.0),)
    return Sensor("trial", RATE_HZ, (50.0, 50.0), 4.0, 6.0, 0.035, (5.0, 0.0), 0.0, parts)


def slide(seed: int, samples: int = 250) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) s and volts (n, 3) V with every bit of a float64 in use."""
    return np.arange(samples) / RATE_HZ, np.random.default_rng(seed).normal(1.65, 0.2, (samples, 3))


@dataclass(frozen=True)
class Format:
    """How a lab writes a slide, and the map that reads it back, to the last bit or within a tolerance."""

    write: Callable[[Path, str, np.ndarray, np.ndarray], None]
    kind: str
    suffix: str
    columns: tuple[str, str, str]
    time: str = 'column = "t"'
    top: str = ""
    pattern: str = "(?P<recording>[a-z]+)"
    channel: str = ""
    tables: str = ""
    tolerance_v: float = 0.0

    def map_text(self) -> str:
        text = HEAD.format(kind=self.kind, pattern=self.pattern, top=self.top, time=self.time)
        for output, column in zip(OUTPUTS, self.columns, strict=True):
            part = f'part = "{output[-1]}"\n' if "<part>" in self.pattern else ""
            text += f'[channels.{output}]\ncolumn = "{column}"\n{part}{self.channel}\n'
        return text + self.tables


def write_lab(folder: Path, form: Format, names: tuple[str, ...] = ("one", "two")) -> Path:
    """A folder of sources, a sensor.toml and a map; returns the map."""
    (folder / "lab").mkdir(parents=True)
    for seed, name in enumerate(names):
        form.write(folder / "lab", name, *slide(seed))
    write_sensor(folder / "sensor.toml", a_sensor())
    (folder / "map.toml").write_text(form.map_text())
    return folder / "map.toml"


def _table(time_s: np.ndarray, volts: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"t": time_s, "x": volts[:, 0], "y": volts[:, 1], "z": volts[:, 2]})


def _csv(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    _table(time_s, volts).to_csv(folder / f"{name}.csv", index=False)


def _european_csv(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    body = _table(time_s, volts).to_csv(index=False, sep=";", decimal=",").split("\n", 1)
    text = f"DAQ 9234; 24 bit\nGerät {name}\n{body[0]}\ns;V;V;V\n{body[1]}"
    (folder / f"{name}.txt").write_text(text, encoding="latin-1")


def _csv_for_each_axis(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    for n, axis in enumerate("xyz"):
        pd.DataFrame({"t": time_s, "V": volts[:, n]}).to_csv(folder / f"{name}_{axis}.csv", index=False)


def _stamped_csv(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    since = pd.to_timedelta((time_s * 1e9).round().astype(int), unit="ns")
    stamps = (pd.Timestamp("2026-03-01T09:00:00") + since).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    _table(time_s, volts).assign(t=stamps).to_csv(folder / f"{name}.csv", index=False)


def _workbook(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    """A sheet of notes, then the samples below a title, with a row of units, and rows whose content was deleted."""
    book = openpyxl.Workbook()
    book.active.append(["nothing here"])
    sheet = book.create_sheet("slide")
    for row in (["DAQ 9234"], ["t", "x", "y", "z"], ["s", "V", "V", "V"]):
        sheet.append(row)
    for row in np.column_stack([time_s, volts]).tolist():
        sheet.append(row)
    sheet.cell(sheet.max_row + 3, 1).value = ""
    book.save(folder / f"{name}.xlsx")


def _parquet(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    _table(time_s, volts).to_parquet(folder / f"{name}.parquet")


def _hdf5(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    with h5py.File(folder / f"{name}.h5", "w") as file:
        file["daq/t"] = time_s
        file["daq/v"] = volts


def _tdms(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    with TdmsWriter(folder / f"{name}.tdms") as writer:
        clock = {"wf_increment": 1 / RATE_HZ, "wf_start_offset": 0.0}
        for half in (slice(None, 100), slice(100, None)):
            lanes = [ChannelObject("daq", axis, volts[half, n].copy(), clock) for n, axis in enumerate("xyz")]
            writer.write_segment([*lanes, ChannelObject("daq", "t", time_s[half])])


def _mat(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    scipy.io.savemat(folder / f"{name}.mat", {"t": time_s, "daq": {"v": volts}}, do_compression=True)


def _mat_73(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    with h5py.File(folder / f"{name}.mat", "w", userblock_size=512) as file:
        file["t"] = time_s[None, :]
        file["daq/v"] = volts.T
    with (folder / f"{name}.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def _vectors(store, volts: np.ndarray, time_s: np.ndarray, kind: str, ros1: bool):
    """Stamped messages of the type, with their time in ns."""
    types = store.types
    for n, (moment, (x, y, z)) in enumerate(zip(time_s, volts, strict=True)):
        ns = round(moment * 1e9) + 1_700_000_000_000_000_000
        stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="skin", **({"seq": n} if ros1 else {}))
        vector = types["geometry_msgs/msg/Vector3"](x=float(x), y=float(y), z=float(z))
        if kind == "geometry_msgs/msg/Vector3Stamped":
            yield ns, types[kind](header=header, vector=vector)
        else:
            still = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
            turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            parts = {"orientation": turn, "angular_velocity": still, "linear_acceleration": vector}
            spreads = {f"{part}_covariance": np.zeros(9) for part in parts}
            yield ns, types[kind](header=header, **parts, **spreads)


VOLTS, IMU = "geometry_msgs/msg/Vector3Stamped", "sensor_msgs/msg/Imu"


def _bag1(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(folder / f"{name}.bag") as writer:
        topic = writer.add_connection("/skin", VOLTS, typestore=store)
        for ns, message in _vectors(store, volts, time_s, VOLTS, ros1=True):
            writer.write(topic, ns, store.serialize_ros1(message, VOLTS))


def _bag2(plugin: StoragePlugin, kind: str):
    def write(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
        store = get_typestore(Stores.ROS2_HUMBLE)
        values = (volts - 1.65) / 0.8 * 9.80665 if kind == IMU else volts
        with Writer2(folder / name, version=9, storage_plugin=plugin) as writer:
            topic = writer.add_connection("/skin", kind, typestore=store)
            for ns, message in _vectors(store, values, time_s, kind, ros1=False):
                writer.write(topic, ns, store.serialize_cdr(message, kind))

    return write


def write_two_topics(folder: Path, lag_s: float, samples: int = 250) -> None:
    """A bag of two accelerometers, each with a clock of its own: the second's runs lag_s behind the first's."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    time_s, volts = slide(0, samples)
    messages = []
    for topic, lag in (("/left", 0.0), ("/right", lag_s)):
        messages += [(ns, topic, m) for ns, m in _vectors(store, volts, time_s + lag, VOLTS, ros1=False)]
    with Writer2(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {name: writer.add_connection(name, VOLTS, typestore=store) for name in ("/left", "/right")}
        for ns, topic, message in sorted(messages, key=lambda entry: entry[0]):
            writer.write(topics[topic], ns, store.serialize_cdr(message, VOLTS))


def _mcap(folder: Path, name: str, time_s: np.ndarray, volts: np.ndarray) -> None:
    """The one file of a recorder that writes no metadata.yaml."""
    _bag2(StoragePlugin.MCAP, VOLTS)(folder, f"{name}_", time_s, volts)
    (folder / f"{name}_" / f"{name}_.mcap").rename(folder / f"{name}.mcap")
    (folder / f"{name}_" / "metadata.yaml").unlink()
    (folder / f"{name}_").rmdir()


_VECTOR = ("/skin.vector.x", "/skin.vector.y", "/skin.vector.z")
_ACCELERATION = tuple(f"/skin.linear_acceleration.{axis}" for axis in "xyz")
_STAMP = 'column = "header.stamp"'
_MATRIX = ("daq.v:0", "daq.v:1", "daq.v:2")

_XYZ = ("x", "y", "z")
_EUROPEAN = (
    '[csv]\ndelimiter = ";"\ndecimal = ","\nheader_lines = 2\nunits_row = true\nencoding = "latin-1"\n'
)
_SHEET = '[xlsx]\nsheet = "slide"\nheader_lines = 1\nunits_row = true\n'
_TDMS = ("daq/x", "daq/y", "daq/z")
_EACH_AXIS = "(?P<recording>[a-z]+)_(?P<part>[xyz])"
_STAMPED = 'column = "t"\nunit = "timestamp"'
_IMU = {"time": _STAMP, "channel": 'unit = "m/s2"', "tolerance_v": 1e-12}

FORMATS: dict[str, Format] = {
    "csv": Format(_csv, "csv", ".csv", _XYZ),
    "european csv": Format(_european_csv, "csv", ".txt", _XYZ, tables=_EUROPEAN),
    "csv for each axis": Format(_csv_for_each_axis, "csv", ".csv", ("V", "V", "V"), pattern=_EACH_AXIS),
    "csv with timestamps": Format(_stamped_csv, "csv", ".csv", _XYZ, time=_STAMPED),
    # openpyxl writes 16 digits.
    "xlsx": Format(_workbook, "xlsx", ".xlsx", _XYZ, tables=_SHEET, tolerance_v=1e-15),
    "parquet": Format(_parquet, "parquet", ".parquet", _XYZ),
    "hdf5": Format(_hdf5, "hdf5", ".h5", ("daq/v:0", "daq/v:1", "daq/v:2"), time='column = "daq/t"'),
    "tdms": Format(_tdms, "tdms", ".tdms", _TDMS, time='column = "daq/t"'),
    "tdms waveform": Format(_tdms, "tdms", ".tdms", _TDMS, time='column = "wf_increment"'),
    "mat": Format(_mat, "mat", ".mat", _MATRIX),
    "mat 7.3": Format(_mat_73, "mat", ".mat", _MATRIX),
    "ros 1": Format(_bag1, "ros", ".bag", _VECTOR, time=_STAMP),
    "ros 2": Format(_bag2(StoragePlugin.SQLITE3, VOLTS), "ros", "", _VECTOR, time=_STAMP),
    "mcap": Format(_mcap, "ros", ".mcap", _VECTOR, time='column = "received"'),
    "ros 2 imu": Format(_bag2(StoragePlugin.MCAP, IMU), "ros", "", _ACCELERATION, **_IMU),
}
