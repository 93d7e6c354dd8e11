"""A folder of tables, or one, a piece at a time.

Every file is passed through twice (`tables_streamed`). Where one cannot be read so, `tables_pieces`
returns None, and the reader of whole tables has the word.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow as pa

from ftcal.logs import columns, tables
from ftcal.logs.layout import Layout
from ftcal.logs.pieces import NUMBERS
from ftcal.logs.streamed import StreamedPieces
from ftcal.logs.tables_batches import batched
from ftcal.logs.tables_streamed import StreamedTable


def tables_pieces(path: Path, layout: Layout, *, name: str | None = None) -> StreamedPieces | None:
    """Return the table or the folder of tables `path`, opened, or None where it must be read whole.

    Raises `LogError` as `tables.read` does, but for what only the numbers show.
    """
    files = tables.files(path) if path.is_dir() else [path]
    sources = [batched(file, layout) for file in files]
    known = [source for source in sources if source is not None]
    if len(known) < len(files):
        return None
    empty = {s.file: s.schema.empty_table() for s in known}
    plain = [
        tables.Table(s.file, dict(zip(s.schema.names, empty[s.file].columns, strict=True)), 1, b"")
        for s in known
    ]
    claims = tables.claimed(path, plain, layout)
    with ThreadPoolExecutor(1) as beside:
        digests = beside.map(columns.file_sha256, files)
        streamed = []
        for source in known:
            try:
                table = StreamedTable(source, claims[source.file], layout, NUMBERS).looked_through()
            except pa.ArrowException:
                return None
            if table is None:
                return None
            streamed.append(table)
        return StreamedPieces.of(
            streamed,
            layout,
            name=name or (path.resolve().name if path.is_dir() else plain[0].title),
            source=str(path),
            sha256=columns.digest(digests),
        )
