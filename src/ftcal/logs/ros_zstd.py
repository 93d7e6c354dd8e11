"""Compressed pieces of a bag: never more memory than a piece may claim.

A few bytes can claim, or unfold to, gigabytes. What a piece says of its size is believed up to
`CEILING`, or `RATIO` times what it takes on disk: logged numbers are never that empty.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ftcal.errors import LogError
from ftcal.logs.ros_topic import Batch, batch

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import IO

CEILING = 1 << 26
"""Bytes that any piece may unfold to."""

RATIO = 200
"""Times its own size that a large piece may unfold to."""


def limit(packed: int) -> int:
    """Return how many bytes a piece of `packed` bytes may unfold to."""
    return max(CEILING, RATIO * packed)


def inflate(packed: bytes | memoryview, method: str, size: int, where: str) -> bytes:
    """Return the `size` bytes that `packed` unfolds to; `LogError` where it does not."""
    if not 0 <= size <= limit(len(packed)):
        raise LogError(f"{where} claims {size} bytes in {len(packed)}; the file is damaged")
    if method == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        content = LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    elif method == "zstd":
        content = _zstd(packed, size, where)
    elif method == "":
        content = packed
    else:
        raise LogError(f"{where} is compressed with {method!r}; rewrite it with zstd or lz4")
    if len(content) != size:
        raise LogError(f"{where} holds {len(content)} bytes, not {size}; the file is damaged")
    return bytes(content)


def inflated(messages: Batch, where: str) -> Batch:
    """Return `messages`, each of which was compressed by itself with zstd, unfolded."""
    from zstandard import frame_content_size

    found = []
    for row in range(len(messages)):
        packed = messages.message(row)
        found.append(inflate(packed, "zstd", frame_content_size(packed), f"{where}: a message"))
    return batch(messages.topic, found, messages.arrival.tolist())


def unfold(file: Path, into: Path, where: str) -> None:
    """Write what the zstd file `file` unfolds to; `LogError` where that is far too much."""
    from zstandard import ZstdDecompressor

    ceiling = limit(file.stat().st_size)
    with file.open("rb") as packed, into.open("wb") as out:
        for piece in _pieces(ZstdDecompressor().stream_reader(packed, read_across_frames=True)):
            if (ceiling := ceiling - len(piece)) < 0:
                raise LogError(f"{where}: unfolds to more than {RATIO} times its size; damaged")
            out.write(piece)


def _pieces(stream: IO[bytes]) -> Iterator[bytes]:
    while piece := stream.read(1 << 20):
        yield piece


def _zstd(packed: bytes | memoryview, size: int, where: str) -> bytes:
    from zstandard import ZstdDecompressor, frame_content_size

    claimed = frame_content_size(packed)
    if claimed > sys.maxsize or (claimed >= 0 and claimed != size):
        raise LogError(f"{where} holds {claimed} bytes, not {size}; the file is damaged")
    return bytes(ZstdDecompressor().decompress(packed, max_output_size=size))
