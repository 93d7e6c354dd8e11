"""A tree of YARP dumper folders, a piece at a time; any `data.log` may be larger than memory.

Every file is passed through twice (`port_streamed`). What is refused is what the reader of whole
logs refuses, before the first piece.
"""

from __future__ import annotations

from pathlib import Path

from ftcal.logs import columns, dump, port_streamed, yarp
from ftcal.logs.layout import Layout
from ftcal.logs.streamed import StreamedPieces

_TEXT = 3 * dump.BLOCK  # bytes that are read at a time of all ports, which are read at once


def yarp_pieces(path: Path, layout: Layout, *, name: str | None = None) -> StreamedPieces:
    """Return the log below the folder `path`, opened; raises `LogError` as `yarp.read` does."""
    groups, known = yarp.ports(path, layout)
    ports, sums = [], []
    block = min(dump.BLOCK, _TEXT // max(len(groups), 1))
    for sessions in groups:
        passed, digests = port_streamed.passed_through(path, sessions, layout, block=block)
        ports.append(passed)
        sums += digests
    if not any(port.sessions for port in ports):
        raise yarp.nothing(path, known)
    return StreamedPieces.of(
        ports,
        layout,
        name=name or path.resolve().name,
        source=str(path),
        sha256=columns.digest(sums),
    )
