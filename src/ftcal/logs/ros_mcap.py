"""MCAP files: records in chunks, whose messages are found through the index behind each chunk.

Schemas and channels are read by the `mcap` library. Message indexes are not: it makes a tuple of
every entry, while NumPy takes all entries at once; nor chunks, which it copies twice. What an index
says is checked against the chunk, and a chunk without an index, or with one that does not cover it,
is walked through.

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
from ftcal.logs.mcap_records import BEHIND, HEAD, MAGIC, RECORD
from ftcal.logs.ros_topic import Batch, Topic, full_kind, no_foreign_errors
from ftcal.logs.ros_zstd import inflate, inflated

if TYPE_CHECKING:
    from jaxtyping import Int, Shaped
    from numpy import ndarray as Array

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = 0x03, 0x04, 0x05, 0x06, 0x07
_STATISTICS, _END, _FOOTER = 0x0B, 0x0F, 0x02
_READ = frozenset({_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX, _STATISTICS})

_CHUNK_HEAD, _LENGTH = struct.Struct("<QQQII"), struct.Struct("<Q")
"""A chunk: first and last time, size and checksum when unfolded, letters of the compression's name;
behind that name the length of what is packed."""

_TAKEN = ("channel", "length", "log")
_Found = tuple[np.ndarray, np.ndarray]
"""Where messages begin, and their heads."""

_LOOSE = 1 << 20
"""Bytes of messages outside of chunks that are taken together."""


@dataclass(frozen=True, slots=True)
class _Section:
    """Records that lie together: those of a chunk, or those outside of chunks."""

    content: bytes
    at: int = 0
    """First byte of them in the file."""
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
        """Return the messages of the wanted topics, as `sections` has them."""
        for _, batches in self.sections(wanted):
            yield from batches

    def sections(self, wanted: Callable[[Topic], bool]) -> Iterator[tuple[int, list[Batch]]]:
        """Return the messages of the wanted topics, chunk after chunk, and where each chunk begins.

        Raises `LogError` where the file is no MCAP, or a chunk is damaged; a file that is cut short
        is read as far as it goes.
        """
        with self._path.open("rb") as file, no_foreign_errors(self._title):
            if file.read(len(MAGIC)) != MAGIC:
                raise LogError(f"{self._title}: not an MCAP file; look at what wrote it")
            with ThreadPoolExecutor(1) as beside:  # the next chunk unfolds while this one is read
                sections = self._sections(file, len(MAGIC))
                coming = beside.submit(next, sections, None)
                while (section := coming.result()) is not None:
                    coming = beside.submit(next, sections, None)
                    yield section.at, list(self._section(section, wanted))
            if not self.faults and self._announced not in (None, self.counts.total()):
                self.faults.append(
                    f"announces {self._announced} messages but holds {self.counts.total()}"
                )

    def section(self, at: int, wanted: Callable[[Topic], bool]) -> list[Batch]:
        """Return the messages of the chunk at byte `at`, once `sections` have all been passed."""
        with self._path.open("rb") as file, no_foreign_errors(self._title):
            file.seek(at)
            section = next(self._sections(file, at), _Section(b""))
            return list(self._section(section, wanted))

    def _sections(self, file: IO[bytes], at: int) -> Iterator[_Section]:
        """Return the content of each chunk with the records of its index, from byte `at` on."""
        size, opcode = self._path.stat().st_size, 0
        chunk, loose, loose_at = _Section(b""), bytearray(), at
        while opcode != _FOOTER and size - at >= RECORD.size:
            begin, head = at, file.read(RECORD.size)
            opcode, length = RECORD.unpack(head)
            at += RECORD.size + length
            if at > size:
                break
            if opcode != _INDEX and chunk.content:
                yield chunk
                chunk = _Section(b"")
            if loose and (opcode in (_CHUNK, _END, _FOOTER) or len(loose) > _LOOSE):
                yield _Section(bytes(loose), loose_at)
                loose.clear()
            content = file.read(length) if opcode in _READ else b""
            file.seek(at)
            if opcode == _INDEX:
                chunk.index.append(content)
            elif opcode == _CHUNK:
                chunk = _Section(self._unpacked(content, at - length), begin)
            elif opcode == _STATISTICS:
                (self._announced,) = struct.unpack_from("<Q", content)
            elif opcode in (_SCHEMA, _CHANNEL, _MESSAGE):
                loose_at = loose_at if loose else begin
                loose += head + content
        yield chunk
        yield _Section(bytes(loose), loose_at)
        if opcode != _FOOTER or at > size:
            self.faults.append("cut short; read as far as it goes")

    def _unpacked(self, record: bytes, at: int) -> bytes:
        """Return the records in a chunk; `LogError` where it is not what it says."""
        _, _, size, crc, letters = _CHUNK_HEAD.unpack_from(record)
        packed = _CHUNK_HEAD.size + letters + _LENGTH.size
        method = record[_CHUNK_HEAD.size : packed - _LENGTH.size].decode()
        (length,) = _LENGTH.unpack_from(record, packed - _LENGTH.size)
        where = f"{self._title}: chunk at byte {at}"
        content = inflate(memoryview(record)[packed : packed + length], method, size, where)
        if crc and zlib.crc32(content) != crc:
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
                starts, lengths = offsets[mine] + HEAD.itemsize, after[mine] - BEHIND
                messages = Batch(topic, buffer, starts, lengths, log[mine])
                yield inflated(messages, self._title) if self._squeezed else messages

    def _indexed(
        self, content: bytes, buffer: Shaped[Array, "B"], index: list[bytes]
    ) -> _Found | None:
        """Return the messages that the index lists, or None where it does not cover the chunk."""
        entries = [np.frombuffer(record, "<u8", offset=6) for record in index if len(record) >= 6]
        offsets = np.concatenate([np.empty(0, "<u8"), *(entry[1::2] for entry in entries)])
        if not len(offsets) or offsets.max() > len(content) - HEAD.itemsize:
            return None
        starts = np.sort(offsets.astype(np.int64), kind="stable")
        heads = _heads(buffer, starts)
        if (heads["opcode"] != _MESSAGE).any() or heads["length"].max() > len(content):
            return None
        stops = starts + RECORD.size + heads["length"].astype(np.int64)
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
            opcode, length = RECORD.unpack_from(content, at)
            after = at + RECORD.size + length
            if after > stop or (opcode == _MESSAGE and length < BEHIND):
                raise LogError(f"{self._title}: a record of {length} bytes in a chunk that ends"
                               " before it; run `mcap recover`")  # fmt: skip
            if opcode == _MESSAGE:
                found.append(at)
            elif opcode in (_SCHEMA, _CHANNEL):
                self._declare(opcode, content[at + RECORD.size : after])
            at = after
        return found

    def _declare(self, opcode: int, record: bytes) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        stream = ReadDataStream(BytesIO(record))
        if opcode == _SCHEMA:
            schema = Schema.read(stream)
            self._schemas.setdefault(schema.id, schema)  # chunks and summary say it again
            return
        channel = Channel.read(stream)
        if channel.id in self._topics:
            return
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
        return np.empty(0, HEAD)
    every = np.ndarray((len(buffer) - HEAD.itemsize + 1,), f"V{HEAD.itemsize}", buffer,
                       strides=(1,))  # fmt: skip
    heads: Shaped[Array, "N"] = every[offsets].view(HEAD)
    return heads
