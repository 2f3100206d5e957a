"""The readers by kind of file: a line each."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from softslide.pipeline.importers.readers.chunk import Chunk


@dataclass(frozen=True)
class Reader:
    """One kind of file: its suffixes, what it is called, and the function that reads it."""

    suffixes: tuple[str, ...]
    title: str
    module: str
    function: str

    def read(self) -> "Callable[..., Iterator[Chunk]]":
        """The function `(path, columns, ...)`; its library is imported now and not before."""
        return getattr(import_module(f"softslide.pipeline.importers.readers.{self.module}"), self.function)


READERS = {
    "csv": Reader((".csv", ".txt", ".tsv", ".dat"), "delimited text", "delimited", "read_delimited"),
    "xlsx": Reader((".xlsx",), "Excel workbook", "workbook", "read_workbook"),
    "parquet": Reader((".parquet",), "Parquet", "parquet", "read_parquet"),
    "hdf5": Reader((".h5", ".hdf5", ".hdf"), "HDF5", "hdf5", "read_hdf5"),
    "tdms": Reader((".tdms",), "TDMS of LabVIEW", "tdms", "read_tdms"),
    "mat": Reader((".mat",), "MATLAB of either format", "matlab", "read_matlab"),
    "mcap": Reader((".mcap",), "log of softslide serve", "mcap_log", "read_mcap"),
    "ros": Reader((".bag", ".mcap", ".db3"), "ROS 1, ROS 2, MCAP", "ros", "read_ros"),
}
