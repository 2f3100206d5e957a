"""What a device sends with `--format cobs`, written from docs/format.md."""

import binascii
import struct
from collections.abc import Sequence


def frame(sample: Sequence[float]) -> bytes:
    """A sample as docs/format.md has it: each run of bytes without a zero after its length, then a zero."""
    plain = struct.pack(f"<d{len(sample) - 1}f", *sample)
    plain += struct.pack("<H", binascii.crc_hqx(plain, 0))
    runs = plain.split(b"\0")
    assert all(len(run) < 254 for run in runs)
    return b"".join(bytes([len(run) + 1]) + run for run in runs) + b"\0"
