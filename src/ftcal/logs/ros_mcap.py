"""MCAP files: records in chunks, whose messages are found through the index behind each chunk.

The content of records is read by the `mcap` library, except that of message indexes: it makes a
tuple of every entry, while NumPy takes all entries at once. What the index says is checked against
the chunk, and a chunk without an index, or with one that does not cover it, is walked through.

Source: MCAP format specification 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ftcal.errors import LogError
from ftcal.logs.ros_topic import Batch, Topic, full_kind, no_foreign_errors
from ftcal.logs.ros_zstd import inflate, inflated

if TYPE_CHECKING:
    from jaxtyping import Int, Shaped
    from numpy import ndarray as Array

MAGIC = b"\x89MCAP0\r\n"

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = 0x03, 0x04, 0x05, 0x06, 0x07
_STATISTICS, _END, _FOOTER = 0x0B, 0x0F, 0x02
_READ = frozenset({_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX, _STATISTICS})

_RECORD = struct.Struct("<BQ")
"""In front of every record: what it is, and how many bytes follow."""

_HEAD = np.dtype([("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"),
                  ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")])  # fmt: skip
"""A message record up to its content."""

_TAKEN = ("channel", "length", "log")
_BEHIND = _HEAD.itemsize - _RECORD.size
"""Bytes of the head that the length of the record counts."""

_Found = tuple[np.ndarray, np.ndarray]
"""Where messages begin, and their heads."""

_LOOSE = 1 << 20
"""Bytes of messages outside of chunks that are taken together."""


@dataclass(frozen=True, slots=True)
class _Section:
    """Records that lie together: those of a chunk, or those outside of chunks."""

    content: bytes
    index: list[bytes] = field(default_factory=list)
    """Records of the message index behind a chunk."""


class McapFile:
    """One MCAP file; what was met is known when all batches have been taken."""

    def __init__(self, path: Path, title: str, *, squeezed: bool) -> None:
        """Prepare to read `path`; `title` names it in errors, `squeezed` messages are zstd."""
        self.counts: Counter[Topic] = Counter()
        """Messages by topic, whether wanted or not."""
        self.faults: list[str] = []
        """What is missing from the file, a line each."""
        self._path, self._title, self._squeezed = path, title, squeezed
        self._schemas: dict[int, Any] = {}
        self._topics: dict[int, Topic] = {}
        self._announced: int | None = None

    def batches(self, wanted: Callable[[Topic], bool]) -> Iterator[Batch]:
        """Return the messages of the wanted topics, chunk after chunk.

        Raises `LogError` where the file is no MCAP, or a chunk is damaged; a file that is cut short
        is read as far as it goes.
        """
        with self._path.open("rb") as file, no_foreign_errors(self._title):
            if file.read(len(MAGIC)) != MAGIC:
                raise LogError(f"{self._title}: not an MCAP file; look at what wrote it")
            with ThreadPoolExecutor(1) as beside:  # the next chunk unfolds while this one is read
                sections = self._sections(file, self._path.stat().st_size)
                coming = beside.submit(next, sections, None)
                while (section := coming.result()) is not None:
                    coming = beside.submit(next, sections, None)
                    yield from self._section(section, wanted)
            if not self.faults and self._announced not in (None, self.counts.total()):
                self.faults.append(
                    f"announces {self._announced} messages but holds {self.counts.total()}"
                )

    def _sections(self, file: IO[bytes], size: int) -> Iterator[_Section]:
        """Return the content of each chunk with the records of its index."""
        chunk, loose, at, opcode = _Section(b""), bytearray(), len(MAGIC), 0
        while opcode != _FOOTER and size - at >= _RECORD.size:
            head = file.read(_RECORD.size)
            opcode, length = _RECORD.unpack(head)
            at += _RECORD.size + length
            if at > size:
                break
            if opcode != _INDEX and chunk.content:
                yield chunk
                chunk = _Section(b"")
            if opcode in (_CHUNK, _END, _FOOTER) or len(loose) > _LOOSE:
                yield _Section(bytes(loose))
                loose.clear()
            content = file.read(length) if opcode in _READ else b""
            file.seek(at)
            if opcode == _INDEX:
                chunk.index.append(content)
            elif opcode == _CHUNK:
                chunk = _Section(self._unpacked(content, at - length))
            elif opcode == _STATISTICS:
                (self._announced,) = struct.unpack_from("<Q", content)
            elif opcode in (_SCHEMA, _CHANNEL, _MESSAGE):
                loose += head + content
        yield chunk
        yield _Section(bytes(loose))
        if opcode != _FOOTER or at > size:
            self.faults.append("cut short; read as far as it goes")

    def _unpacked(self, record: bytes, at: int) -> bytes:
        """Return the records in a chunk; `LogError` where it is not what it says."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk

        chunk = Chunk.read(ReadDataStream(BytesIO(record)))
        where = f"{self._title}: chunk at byte {at}"
        content = inflate(chunk.data, chunk.compression, chunk.uncompressed_size, where)
        if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
            raise LogError(f"{where} is damaged (checksum); run `mcap recover`")
        return content

    def _section(self, section: _Section, wanted: Callable[[Topic], bool]) -> Iterator[Batch]:
        """Return the wanted messages of one chunk, topic by topic."""
        content, buffer = section.content, np.frombuffer(section.content, np.uint8)
        offsets, heads = self._indexed(content, buffer, section.index) or _all(
            buffer, self._walk(content, 0, len(content))
        )
        channels, after, log = (heads[name].astype(np.int64) for name in _TAKEN)
        for channel in np.flatnonzero(np.bincount(channels)).tolist():
            if channel not in self._topics:
                raise LogError(f"{self._title}: messages of channel {channel}, which is not"
                               " declared; run `mcap recover`")  # fmt: skip
            topic = self._topics[channel]
            mine = np.flatnonzero(channels == channel)
            self.counts[topic] += len(mine)
            if wanted(topic):
                starts, lengths = offsets[mine] + _HEAD.itemsize, after[mine] - _BEHIND
                messages = Batch(topic, buffer, starts, lengths, log[mine])
                yield inflated(messages, self._title) if self._squeezed else messages

    def _indexed(
        self, content: bytes, buffer: Shaped[Array, "B"], index: list[bytes]
    ) -> _Found | None:
        """Return the messages that the index lists, or None where it does not cover the chunk."""
        entries = [np.frombuffer(record, "<u8", offset=6) for record in index if len(record) >= 6]
        offsets = np.concatenate([np.empty(0, "<u8"), *(entry[1::2] for entry in entries)])
        if not len(offsets) or offsets.max() > len(content) - _HEAD.itemsize:
            return None
        starts = np.sort(offsets.astype(np.int64), kind="stable")
        heads = _heads(buffer, starts)
        if (heads["opcode"] != _MESSAGE).any() or heads["length"].max() > len(content):
            return None
        stops = starts + _RECORD.size + heads["length"].astype(np.int64)
        begins, ends = np.append(starts, len(content)), np.insert(stops, 0, 0)
        if (begins < ends).any():
            return None
        for gap in np.flatnonzero(begins > ends).tolist():
            if self._walk(content, int(ends[gap]), int(begins[gap])):
                return None
        return starts, heads

    def _walk(self, content: bytes, at: int, stop: int) -> list[int]:
        """Return where messages begin in records [at, stop), and learn of schemas and channels."""
        found = []
        while at < stop:
            opcode, length = _RECORD.unpack_from(content, at)
            after = at + _RECORD.size + length
            if after > stop or (opcode == _MESSAGE and length < _BEHIND):
                raise LogError(f"{self._title}: a record of {length} bytes in a chunk that ends"
                               " before it; run `mcap recover`")  # fmt: skip
            if opcode == _MESSAGE:
                found.append(at)
            elif opcode in (_SCHEMA, _CHANNEL):
                self._declare(opcode, content[at + _RECORD.size : after])
            at = after
        return found

    def _declare(self, opcode: int, record: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        stream = ReadDataStream(BytesIO(record))
        if opcode == _SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
            return
        channel = Channel.read(stream)
        schema = self._schemas.get(channel.schema_id)
        language = schema.encoding if schema else ""
        topic = self._topics[channel.id] = Topic(
            channel.topic,
            full_kind(schema.name) if schema else "unknown",
            schema.data.decode() if schema and language in _LANGUAGES else "",
            language,
            channel.message_encoding,
        )
        self.counts[topic] += 0  # a topic that stays empty is told too


_LANGUAGES = frozenset({"ros1msg", "ros2msg", "ros2idl"})


def _all(buffer: Shaped[Array, "B"], offsets: list[int]) -> _Found:
    starts = np.array(offsets, dtype=np.int64)
    return starts, _heads(buffer, starts)


def _heads(buffer: Shaped[Array, "B"], offsets: Int[Array, "N"]) -> Shaped[Array, "N"]:
    """Return the heads of the message records at `offsets`."""
    if not len(offsets):
        return np.empty(0, _HEAD)
    every = np.ndarray((len(buffer) - _HEAD.itemsize + 1,), f"V{_HEAD.itemsize}", buffer,
                       strides=(1,))  # fmt: skip
    heads: Shaped[Array, "N"] = every[offsets].view(_HEAD)
    return heads
