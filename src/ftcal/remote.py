"""Folders on another machine → a copy of them here, each file fetched once.

Where they lie is a URL that fsspec knows (`s3://`, `sftp://`, `https://`, …). A file is fetched
again when its mark changes: the ETag or the time of change that the far side tells, and its size.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path, PurePosixPath
from typing import Any

from ftcal.calibration import write_whole
from ftcal.errors import JobError, OutputError
from ftcal.progress import Progress, silent

MARKS = ("size", "ETag", "etag", "mtime", "LastModified", "last_modified", "md5Hash", "ino",
         "created")  # fmt: skip
"""What file systems call that which changes with a file."""

PACKAGES = {"smbclient": "smbprotocol"}
"""Packages whose name is not that of their module."""

OUTSIDE = "its name leads out of the folder"

CHUNK = 1 << 24
"""Bytes that are held in memory while a file is fetched."""


def is_url(place: str) -> bool:
    """Return whether a place is not simply a path."""
    return "://" in place


def fetched(url: str, folder: Path, *, progress: Progress = silent) -> tuple[Path, dict[str, str]]:
    """Return the folder with a copy of all files below `url`, and why files could not be fetched.

    The copy lies in `folder`. A file that cannot be fetched is missing in it, and told by its path
    below `url`. Raises `JobError` where the URL cannot be opened, `OutputError` where `folder`
    cannot be written.
    """
    try:
        import fsspec
    except ImportError as error:
        raise JobError(f'{url}: fsspec is not installed: pip install "ftcal[remote]"') from error
    try:
        far, root = fsspec.core.url_to_fs(url)
        told = far.find(root, detail=True)
    except ImportError as error:
        raise JobError(f"{url}: {remedy(url, error)}") from error
    except Exception as error:  # each protocol has errors of its own, of no common kind
        raise JobError(f"{url}: cannot be opened ({in_a_line(error)})") from error
    base = folder / hashlib.sha256(url.encode()).hexdigest()[:16]
    faults: dict[str, str] = {}
    for number, (name, known) in enumerate(sorted(told.items())):
        below = PurePosixPath(name).relative_to(PurePosixPath(root))
        progress(f"fetching {below}", number, len(told))
        here, mark = base / "files" / below, base / "marks" / f"{below}.json"
        # names are those of a stranger
        outside = ".." in below.parts
        reason = OUTSIDE if outside else fetch(far, name, known, here, mark)
        if reason:
            faults[below.as_posix()] = reason
    return base / "files", faults


def fetch(far: Any, name: str, known: dict[str, Any], here: Path, mark: Path) -> str:
    """Fetch one file unless its mark is the one that is kept; return why it could not be."""
    told = json.dumps({key: str(known[key]) for key in MARKS if known.get(key) is not None})
    if here.is_file() and mark.is_file() and mark.read_text() == told:
        return ""
    part = mark.with_suffix(".part")
    try:
        here.parent.mkdir(parents=True, exist_ok=True)
        mark.parent.mkdir(parents=True, exist_ok=True)
        # a mark vouches for the file: it goes first and comes last
        mark.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"{here}: cannot be written ({error.strerror}); name another folder with --cache"
        ) from error
    try:
        with far.open(name, "rb") as source, part.open("wb") as target:
            while block := source.read(CHUNK):
                target.write(block)
        part.replace(here)
    except Exception as error:  # see `fetched`
        here.unlink(missing_ok=True)
        return in_a_line(error)
    write_whole(mark, told.encode())
    return ""


def remedy(url: str, error: ImportError) -> str:
    """Return what to install for a URL whose file system could not be imported."""
    cause = error.__cause__
    module = cause.name if isinstance(cause, ImportError) else None
    if module is None:
        return f"cannot be opened ({in_a_line(error)})"
    name = module.partition(".")[0]
    protocol, package = url.partition("://")[0], PACKAGES.get(name, name)
    return f'{protocol}:// needs {package}: pip install "ftcal[remote]" {package}'


def in_a_line(error: Exception) -> str:
    """Return what a foreign error says, in one line."""
    return " ".join(str(error).split()) or type(error).__name__
