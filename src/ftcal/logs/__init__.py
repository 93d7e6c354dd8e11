"""One file a format → `Recording`.

| looks like | is read by |
|---|---|
| a folder with `data.log` or `info.log` in it or below, or a `data.log` itself | `yarp` |
| `.csv`, `.tsv`, `.parquet`, `.npz`, or a folder of them | `tables` |
| `.mat` | `robot_logger` |
| `.bag`, `.mcap`, `.db3`, or a folder of them, with `metadata.yaml` or without | `ros` |
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ftcal.errors import LogError
from ftcal.logs.layout import PLAIN, Layout

if TYPE_CHECKING:
    from ftcal.logs.pieces import Pieces
    from ftcal.recording import Recording

__all__ = ["IN_MEMORY", "Layout", "in_pieces", "opened", "read", "weight"]

IN_MEMORY = 128 * 1024**2
"""Bytes of a log, as numbers, beyond which it is read twice and in pieces instead of once."""


def read(path: Path, layout: Layout = PLAIN, *, name: str | None = None) -> Recording:
    """Return the recording at `path`, called `name` (default: the name of the file or folder).

    Raises `LogError` where `path` holds no log, or one that cannot be believed.
    """
    from ftcal.logs import units

    return units.in_si(_as_logged(Path(path), layout, name), layout)


def in_pieces(path: Path, layout: Layout = PLAIN, *, name: str | None = None) -> Pieces:
    """Return the log at `path`, opened to be read a span of time at a time in constant memory.

    YARP folders, MCAP, CSV and Parquet are; of any other format the whole is in memory. The pieces
    put together are what `read` returns. Raises `LogError` as `read` does; what only the numbers
    show, on the way.
    """
    from ftcal.logs import ros, tables, yarp
    from ftcal.logs.pieces import WholeLog
    from ftcal.logs.ros_pieces import ros_pieces
    from ftcal.logs.tables_pieces import tables_pieces
    from ftcal.logs.yarp_pieces import yarp_pieces

    path = Path(path)
    try:
        if path.name == yarp.SAMPLES and path.is_file():
            return yarp_pieces(path.parent, layout, name=name)
        if path.is_dir() and yarp.holds(path):
            return yarp_pieces(path, layout, name=name)
        if ros.holds(path):
            return ros_pieces(path, layout, name=name) or WholeLog(read(path, layout, name=name))
        if path.is_dir():
            streams = bool(tables.files(path))
        else:
            streams = path.is_file() and path.suffix.lower() in tables.SUFFIXES
        opened = tables_pieces(path, layout, name=name) if streams else None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    return opened or WholeLog(read(path, layout, name=name))


def opened(
    path: Path, layout: Layout = PLAIN, *, name: str | None = None, most: int = IN_MEMORY
) -> Pieces:
    """Return the log at `path`, opened: read as a whole where its numbers take `most` bytes.

    Raises `LogError` as `read` and `in_pieces` do.
    """
    from ftcal.logs.pieces import WholeLog

    if weight(path) <= most:
        return WholeLog(read(path, layout, name=name))
    return in_pieces(path, layout, name=name)


def weight(path: Path) -> int:
    """Return about how many bytes the numbers of a log take: what Parquet says, else its files.

    Nothing is refused here: zero of what cannot be looked at.
    """
    import pyarrow as pa
    from pyarrow import parquet

    path = Path(path)
    try:
        files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
        total = 0
        for file in files:
            total += file.stat().st_size
            if file.suffix.lower() == ".parquet":
                said = parquet.read_metadata(file)
                total = max(total, 8 * said.num_rows * said.num_columns)
    except (OSError, pa.ArrowException):
        return 0
    return total


def _as_logged(path: Path, layout: Layout, name: str | None) -> Recording:
    """Return the recording at `path` in the units that its format has or declares."""
    from ftcal.logs import robot_logger, ros, tables, yarp

    try:
        if ros.holds(path) and not (path.is_dir() and yarp.holds(path)):
            return ros.read(path, layout, name=name)
        if path.is_dir():
            if yarp.holds(path):
                return yarp.read(path, layout, name=name)
            if tables.files(path):
                return tables.read(path, layout, name=name)
        elif path.name == yarp.SAMPLES:
            return yarp.read(path.parent, layout, name=name)
        elif path.suffix.lower() in tables.SUFFIXES:
            return tables.read(path, layout, name=name)
        elif path.suffix.lower() == robot_logger.SUFFIX and path.is_file():
            return robot_logger.read(path, layout, name=name)
        elif path.exists():
            known = ", ".join(sorted({*tables.SUFFIXES, robot_logger.SUFFIX, *ros.SUFFIXES}))
            raise LogError(f"{path}: no reader for {path.suffix!r}; give {known} or a YARP folder")
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    what = "holds no data.log and no table" if path.is_dir() else "there is no such file or folder"
    raise LogError(f"{path}: {what}; give the folder that the dumper wrote, or a table")
