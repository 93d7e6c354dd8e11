"""Where the numbers lie in a message, learnt from one message, read from all that are packed alike.

ROS messages are packed field after field: CDR (ROS 2) pads every number to its own size, counted
from the end of a four-byte head; ROS 1 does not pad and has no head. As long as no text and no
count changes, every number keeps its place, and NumPy reads all messages at once.

Source: OMG DDS-XTypes 1.3, 7.4.3 (plain CDR); ROS 1 wiki, msg, Serialization.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, Shaped, UInt8
    from numpy import ndarray as Array

_LITTLE_ENDIAN = b"\x00\x01"
_HEAD = 4
"""Bytes in front of a CDR message: how it is packed, and options."""
_PADDING = 3
"""Most bytes behind a CDR message, or between two texts or counts of it."""

_BLOCK = 1 << 16
"""Bytes of messages that are compared together: what the processor keeps at hand."""

_CODES = {
    "bool": "|u1", "byte": "|u1", "char": "|u1", "uint8": "|u1", "int8": "|i1",
    "uint16": "<u2", "int16": "<i2", "uint32": "<u4", "int32": "<i4",
    "uint64": "<u8", "int64": "<i8", "float32": "<f4", "float64": "<f8",
}  # fmt: skip


class UnfitError(Exception):
    """A message that is packed in another way; it is decoded by itself."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the numbers of one field lie."""

    offset: int
    """Bytes from the start of the message."""
    code: str
    """NumPy's code of the number."""
    count: int

    @property
    def size(self) -> int:
        """Bytes of all numbers."""
        return self.count * np.dtype(self.code).itemsize


@dataclass(frozen=True, slots=True)
class ByteLayout:
    """Places of all numbers in messages that agree with the first in length, texts and counts."""

    first: bytes
    """The message it was learnt from."""
    fixed: UInt8[Array, "B"]
    """Bits of a message that must not change."""
    spans: tuple[tuple[int, int], ...]
    """Bytes [start, stop) that have such bits, and the padding between them."""
    places: Mapping[str, Place]
    """By the path of the field, such as `wrench.force.x`."""
    texts: Mapping[str, str]
    """What all these messages say, by the path of the field, such as `name.0`."""

    def agrees(self, buffer: UInt8[Array, "B"], starts: Int[Array, "N"]) -> Bool[Array, "N"]:
        """Return which of the messages at `starts`, as long as the first, are packed like it."""
        alike = np.ones(len(starts), dtype=bool)
        for start, stop in self.spans:
            length, first = stop - start, self.first[start:stop]
            rows = _BLOCK // length + 1
            for row in range(0, len(starts), rows):
                found = taken(buffer, starts[row : row + rows], start, length)
                if found.tobytes() != first * len(found):  # hardly ever; row by row takes longer
                    differs = (found ^ np.frombuffer(first, np.uint8)) & self.fixed[start:stop]
                    alike[row : row + rows] &= ~differs.any(axis=1)
        return alike

    def read(
        self, buffer: UInt8[Array, "B"], starts: Int[Array, "N"], path: str
    ) -> Shaped[Array, "N K"]:
        """Return the numbers of the field at `path`, one row a message."""
        return _read(buffer, starts, self.places[path])

    def table(
        self, buffer: UInt8[Array, "B"], starts: Int[Array, "N"], paths: Sequence[str]
    ) -> Float[Array, "N K"]:
        """Return the numbers of several fields side by side; neighbours are read in one go."""
        joined: list[Place] = []
        for place in (self.places[path] for path in paths):
            last = joined[-1] if joined else place
            if joined and last.offset + last.size == place.offset and last.code == place.code:
                joined[-1] = replace(last, count=last.count + place.count)
            else:
                joined.append(place)
        parts = [_read(buffer, starts, place) for place in joined]
        return (parts[0] if len(parts) == 1 else np.hstack(parts)).astype(np.float64, copy=False)


def _read(buffer: UInt8[Array, "B"], starts: Int[Array, "N"], place: Place) -> Shaped[Array, "N K"]:
    return taken(buffer, starts, place.offset, place.size).view(place.code)


def taken(
    buffer: UInt8[Array, "B"], starts: Int[Array, "N"], offset: int, length: int
) -> UInt8[Array, "N length"]:
    """Return a copy of `length` bytes, `offset` behind each of `starts`, one a row."""
    if not length or not len(starts):
        return np.empty((len(starts), length), dtype=np.uint8)
    # every byte begins a window; taking windows copies each of them in one go
    count = len(buffer) - offset - length + 1
    windows = np.ndarray((count,), f"V{length}", buffer, offset, strides=(1,))
    found: UInt8[Array, "N length"] = windows[starts].view(np.uint8).reshape(-1, length)
    return found


def learn(message: bytes, kind: str, definitions: Mapping[str, Any], *, wire: str) -> ByteLayout:
    """Return the layout of messages packed like `message`, of the type `kind`.

    `definitions` are the field definitions of `rosbags` (`Typestore.fielddefs`). Raises
    `UnfitError` where the message is not little-endian CDR or ROS 1, or shorter than its type.
    """
    cdr = wire == "cdr"
    if cdr and message[:2] != _LITTLE_ENDIAN:
        raise UnfitError
    walk = _Walk(message, definitions, _HEAD if cdr else 0, cdr)
    if cdr:
        walk.fixed.append((0, len(_LITTLE_ENDIAN)))
    walk.structure(kind, "")
    if len(message) - walk.at > (_PADDING if cdr else 0):
        raise UnfitError
    fixed = np.zeros(len(message), dtype=np.uint8)
    spans: list[tuple[int, int]] = []
    for start, stop in walk.fixed:
        fixed[start:stop] = 0xFF
        begin = start
        if spans and start - spans[-1][1] <= _PADDING:
            begin, _ = spans.pop()
        spans.append((begin, stop))
    return ByteLayout(message, fixed, tuple(spans), walk.places, walk.texts)


@dataclass(slots=True)
class _Walk:
    """A finger on one message, that moves over its fields."""

    message: bytes
    definitions: Mapping[str, Any]
    at: int
    padded: bool
    places: dict[str, Place] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)
    """Bytes [start, stop) of texts and counts."""

    def structure(self, kind: str, path: str) -> None:
        if kind not in self.definitions:
            raise UnfitError
        for name, description in self.definitions[kind][1]:
            self.one(description, f"{path}{name}")

    def one(self, description: Any, path: str) -> None:
        node, inner = description
        match node.name:
            case "NAME":
                self.structure(inner, f"{path}.")
            case "BASE" if inner[0] == "string":
                start = self.align(4)
                self.skip(self.count())
                self.fixed.append((start, self.at))
                self.texts[path] = self.text(start + 4)
            case "BASE":
                self.numbers(inner[0], 1, path)
            case "ARRAY":
                self.several(inner[0], inner[1], path)
            case _:  # a sequence: its count comes first
                start = self.align(4)
                count = self.count()
                self.fixed.append((start, self.at))
                self.several(inner[0], count, path)

    def several(self, description: Any, count: int, path: str) -> None:
        node, inner = description
        if node.name == "BASE" and inner[0] != "string":
            self.numbers(inner[0], count, path)
            return
        if count > len(self.message):  # a broken count, were each item but one byte
            raise UnfitError
        for number in range(count):
            self.one(description, f"{path}.{number}")

    def numbers(self, base: str, count: int, path: str) -> None:
        if base not in _CODES:
            raise UnfitError
        size = np.dtype(_CODES[base]).itemsize
        if count:
            self.align(size)
        self.places[path] = Place(self.at, _CODES[base], count)
        self.skip(count * size)

    def count(self) -> int:
        start = self.at
        self.skip(4)
        (count,) = struct.unpack_from("<I", self.message, start)
        return int(count)

    def text(self, start: int) -> str:
        try:
            return self.message[start : self.at].removesuffix(b"\0").decode()
        except UnicodeDecodeError as error:
            raise UnfitError from error

    def align(self, size: int) -> int:
        if self.padded:
            self.at += -(self.at - _HEAD) % size
        return self.at

    def skip(self, size: int) -> None:
        self.at += size
        if self.at > len(self.message):
            raise UnfitError
