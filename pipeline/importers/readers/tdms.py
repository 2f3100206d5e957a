"""TDMS of LabVIEW and FlexLogger, through npTDMS: channels as `group/channel`."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from nptdms import TdmsFile

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import Chunk, in_chunks, require

# As a time column: the waveform's own start and step, which DAQmx stores with each channel.
WAVEFORM = "wf_increment"


def read_tdms(path: Path, columns: Sequence[str]) -> Iterator[Chunk]:
    """Columns `group/channel`, scaled as the file says; `wf_increment` is the waveform's clock in seconds."""
    # Opened here, because npTDMS leaves a file that it cannot parse open.
    with path.open("rb") as raw, TdmsFile.open(raw) as file:
        status = file.file_status
        if status.incomplete_final_segment:
            raise InputError(f"{path}: the last segment is cut short; copy it again, or save it anew")
        present = {f"{group.name}/{lane.name}": lane for group in file.groups() for lane in group.channels()}
        data = [column for column in columns if column != WAVEFORM]
        require(path, data, present, "channel")
        channels = {column: present[column] for column in data}
        clock = next(iter(channels.values())).properties
        if WAVEFORM in columns and WAVEFORM not in clock:
            raise InputError(
                f"{path}: '{data[0]}' has no {WAVEFORM}; name a time channel or rate_hz under [time]"
            )
        start = 0
        for chunk in in_chunks(path, channels):
            if WAVEFORM in columns:
                since = np.arange(start, start + len(chunk)) * clock[WAVEFORM]
                chunk.columns[WAVEFORM] = clock.get("wf_start_offset", 0.0) + since
            start += len(chunk)
            yield chunk
