"""MCAP files written a chunk at a time: the messages of all channels of a chunk are laid at once.

The library writes message after message; here NumPy puts the records of a chunk in their places.
All records but those of messages and of their indexes are the library's.

Source: MCAP format specification 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ftcal.logs.mcap_records import BEHIND, HEAD, MAGIC, RECORD

if TYPE_CHECKING:
    from jaxtyping import Int, Shaped, UInt8
    from numpy import ndarray as Array

CHUNK = 1 << 20
"""Bytes of messages that are packed together."""


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one channel, in the order of their stamps."""

    channel: int
    stamps: Int[Array, "N"]
    """When they were logged and published [ns since the Unix epoch]."""
    length: int
    """Bytes of each."""
    packed: Callable[[slice], UInt8[Array, "M B"]]
    """What gives the bytes of some rows, a message a row."""


class ChunkedFile:
    """One MCAP file with zstd chunks, indexes and a summary."""

    def __init__(self, stream: IO[bytes], *, profile: str, library: str) -> None:
        """Begin the file."""
        from mcap.data_stream import RecordBuilder
        from mcap.records import Header, Statistics

        self._stream = stream
        self._declared = RecordBuilder()
        self._schemas: list[Any] = []
        self._channels: list[Any] = []
        self._chunks: list[Any] = []
        self._statistics = Statistics(
            attachment_count=0, channel_count=0, channel_message_counts={}, chunk_count=0,
            message_count=0, message_end_time=0, message_start_time=0, metadata_count=0,
            schema_count=0,
        )  # fmt: skip
        self._stream.write(MAGIC)
        self._write(Header(profile, library))

    def schema(self, name: str, encoding: str, text: bytes) -> int:
        """Declare a message type; return its number."""
        from mcap.records import Schema

        number = len(self._schemas) + 1
        return self._declare(
            self._schemas, Schema(id=number, data=text, encoding=encoding, name=name)
        )

    def channel(self, topic: str, encoding: str, schema: int) -> int:
        """Declare a topic; return its number."""
        from mcap.records import Channel

        number = len(self._channels) + 1
        return self._declare(
            self._channels,
            Channel(
                id=number, topic=topic, message_encoding=encoding, schema_id=schema, metadata={}
            ),
        )

    def add(self, groups: Sequence[Messages]) -> None:
        """Write messages of several channels, in the order of their stamps."""
        stamps = np.concatenate([group.stamps for group in groups])
        owner = np.repeat(np.arange(len(groups)), [len(group.stamps) for group in groups])
        order = np.argsort(stamps, kind="stable")
        owner = owner[order]
        ends = np.cumsum(np.array([HEAD.itemsize + group.length for group in groups])[owner])
        done = np.zeros(len(groups), dtype=np.int64)
        begin = written = 0
        while begin < len(ends):
            stop = max(begin + 1, int(np.searchsorted(ends, written + CHUNK, side="right")))
            offsets = np.concatenate([[written], ends[begin : stop - 1]]) - written
            counts = np.bincount(owner[begin:stop], minlength=len(groups))
            buffer = np.empty(int(ends[stop - 1]) - written, dtype=np.uint8)
            parts = []
            for k in np.flatnonzero(counts).tolist():
                group, rows = groups[k], slice(int(done[k]), int(done[k] + counts[k]))
                mine = offsets[owner[begin:stop] == k]
                _lay(buffer, mine, _records(group, rows))
                parts.append((group.channel, group.stamps[rows], mine))
            self._chunk(buffer, parts)
            done += counts
            begin, written = stop, int(ends[stop - 1])

    def finish(self) -> None:
        """Write the summary and end the file."""
        from mcap.data_stream import RecordBuilder
        from mcap.opcode import Opcode
        from mcap.records import DataEnd, Footer, SummaryOffset

        self._write(DataEnd(0))
        start, summary = self._stream.tell(), RecordBuilder()
        offsets = []
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics]), (Opcode.CHUNK_INDEX, self._chunks),
        ):  # fmt: skip
            before = summary.count
            for record in records:
                record.write(summary)
            length = summary.count - before
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + before, group_length=length)
            )
        offset_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        content = summary.end()  # type: ignore[no-untyped-call]  # the library says no types
        footer = RECORD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, offset_start)
        crc = zlib.crc32(footer, zlib.crc32(content))
        self._stream.write(content)
        self._write(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._stream.write(MAGIC)

    def _declare(self, known: list[Any], record: Any) -> int:
        known.append(record)
        record.write(self._declared)
        self._statistics.schema_count = len(self._schemas)
        self._statistics.channel_count = len(self._channels)
        return len(known)

    def _chunk(
        self,
        messages: UInt8[Array, "B"],
        parts: Sequence[tuple[int, Int[Array, "N"], Int[Array, "N"]]],
    ) -> None:
        """Write one chunk with what was declared in front, and its index.

        `parts` are the channels with their stamps and where in `messages` theirs begin.
        """
        from mcap.records import Chunk, ChunkIndex
        from zstandard import ZstdCompressor

        front = self._declared.end()  # type: ignore[no-untyped-call]
        content = b"".join((front, messages.data))
        packed = ZstdCompressor().compress(content)
        first = min(int(stamps[0]) for _, stamps, _ in parts)
        last = max(int(stamps[-1]) for _, stamps, _ in parts)
        at = self._stream.tell()
        self._write(
            Chunk(
                compression="zstd", data=packed, message_start_time=first, message_end_time=last,
                uncompressed_crc=zlib.crc32(content), uncompressed_size=len(content),
            )
        )  # fmt: skip
        behind, indexes = self._stream.tell(), {}
        for channel, stamps, offsets in parts:
            indexes[channel] = self._stream.tell()
            entries = np.column_stack([stamps, offsets + len(front)]).astype("<u8").tobytes()
            self._stream.write(RECORD.pack(_INDEX, 6 + len(entries)))
            self._stream.write(channel.to_bytes(2, "little") + len(entries).to_bytes(4, "little"))
            self._stream.write(entries)
            counts = self._statistics.channel_message_counts
            counts[channel] = counts.get(channel, 0) + len(stamps)
        self._chunks.append(
            ChunkIndex(
                chunk_length=behind - at, chunk_start_offset=at, compression="zstd",
                compressed_size=len(packed), message_end_time=last,
                message_index_length=self._stream.tell() - behind, message_index_offsets=indexes,
                message_start_time=first, uncompressed_size=len(content),
            )
        )  # fmt: skip
        told, begun = self._statistics, self._statistics.message_count
        told.message_start_time = min(told.message_start_time, first) if begun else first
        told.message_end_time = max(told.message_end_time, last)
        told.message_count = sum(told.channel_message_counts.values())
        told.chunk_count = len(self._chunks)

    def _write(self, record: Any) -> None:
        from mcap.data_stream import RecordBuilder

        builder = RecordBuilder()
        record.write(builder)
        self._stream.write(builder.end())  # type: ignore[no-untyped-call]


_MESSAGE, _INDEX = 0x05, 0x07


def _records(group: Messages, rows: slice) -> UInt8[Array, "M R"]:
    """Return the records of some messages, one a row."""
    stamps = group.stamps[rows]
    records = np.empty((len(stamps), HEAD.itemsize + group.length), dtype=np.uint8)
    heads = np.zeros(len(stamps), dtype=HEAD)
    heads["opcode"], heads["length"] = _MESSAGE, BEHIND + group.length
    heads["channel"], heads["log"], heads["publish"] = group.channel, stamps, stamps
    records[:, : HEAD.itemsize] = heads.view(np.uint8).reshape(len(stamps), -1)
    records[:, HEAD.itemsize :] = group.packed(rows)
    return records


def _lay(buffer: UInt8[Array, "B"], offsets: Int[Array, "N"], rows: UInt8[Array, "N R"]) -> None:
    """Write each of `rows` into `buffer` at its offset."""
    code = f"V{rows.shape[1]}"
    # every byte begins a window; filling windows copies each row in one go
    windows: Shaped[Array, "W"] = np.ndarray(
        (len(buffer) - rows.shape[1] + 1,), code, buffer, strides=(1,)
    )
    windows[offsets] = rows.view(code)[:, 0]
