"""One file a format → `Recording`.

| looks like | is read by |
|---|---|
| a folder with `data.log` or `info.log` in it or below, or a `data.log` itself | `yarp` |
| `.csv`, `.tsv`, `.parquet`, or a folder of them | `tables` |
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ftcal.errors import LogError
from ftcal.logs.layout import PLAIN, Layout

if TYPE_CHECKING:
    from ftcal.recording import Recording

__all__ = ["Layout", "read"]


def read(path: Path, layout: Layout = PLAIN, *, name: str | None = None) -> Recording:
    """Return the recording at `path`, called `name` (default: the name of the file or folder).

    Raises `LogError` where `path` holds no log, or one that cannot be believed.
    """
    from ftcal.logs import tables, yarp

    path = Path(path)
    try:
        if path.is_dir():
            if yarp.holds(path):
                return yarp.read(path, layout, name=name)
            if tables.files(path):
                return tables.read(path, layout, name=name)
        elif path.name == yarp.SAMPLES:
            return yarp.read(path.parent, layout, name=name)
        elif path.suffix.lower() in tables.SUFFIXES:
            return tables.read(path, layout, name=name)
        elif path.exists():
            known = ", ".join(sorted(tables.SUFFIXES))
            raise LogError(f"{path}: no reader for {path.suffix!r}; give {known} or a YARP folder")
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    what = "holds no data.log and no table" if path.is_dir() else "there is no such file or folder"
    raise LogError(f"{path}: {what}; give the folder that the dumper wrote, or a table")
