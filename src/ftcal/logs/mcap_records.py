"""How MCAP files begin, and how their records and messages do.

Source: MCAP format specification 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct

import numpy as np

MAGIC = b"\x89MCAP0\r\n"
"""Both ends of a file."""

RECORD = struct.Struct("<BQ")
"""In front of every record: what it is, and how many bytes follow."""

HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"),
                 ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")])  # fmt: skip
"""A message record up to its content."""

BEHIND = HEAD.itemsize - RECORD.size
"""Bytes of the head that the length of the record counts."""
