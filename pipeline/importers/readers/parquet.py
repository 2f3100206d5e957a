"""Parquet, one row group's batch at a time."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow.parquet as pq

from softslide.pipeline.importers.readers.chunk import CHUNK, Chunk, check_length, require


def read_parquet(path: Path, columns: Sequence[str]) -> Iterator[Chunk]:
    """Columns by name; a null comes as NaN."""
    with pq.ParquetFile(path, pre_buffer=False) as file:
        require(path, columns, file.schema_arrow.names)
        check_length(path, file.metadata.num_rows)
        rows, total = 0, max(file.metadata.num_rows, 1)
        for batch in file.iter_batches(CHUNK, columns=list(columns)):
            rows += len(batch)
            parts = {name: batch.column(name).to_numpy(zero_copy_only=False) for name in columns}
            yield Chunk(parts, rows / total)
