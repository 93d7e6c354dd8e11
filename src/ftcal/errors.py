"""Every failure a user can mend, as one tree.

A message is one line: the culprit, the value that is wrong, the way out.
"""

from __future__ import annotations

import difflib
import tokenize
import zipfile
import zlib
from collections.abc import Iterable

NO_ARCHIVE = (
    OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, SyntaxError,
    tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What NumPy and zipfile raise at an archive of arrays that is none."""


class FtcalError(Exception):
    """Root of everything ftcal raises on purpose; the command line prints it and exits with 1."""


class LogError(FtcalError):
    """A log that cannot be read as what it claims to be."""


class RobotError(FtcalError):
    """A robot description that is broken, or lacks what was asked of it."""


class JobError(FtcalError):
    """A job file with a key, a value or a unit that makes no sense."""


class SensorError(FtcalError):
    """A calibration matrix or a sensor description that cannot be used."""


class DataError(FtcalError):
    """A recording that was read but cannot carry the calculation asked of it."""


class OutputError(FtcalError):
    """A result that cannot be written where it was asked for."""


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """Return "no KIND 'NAME'" with the near names of `known`, or all of them where they are few."""
    names = sorted(set(known))
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    if not near and len(names) <= 8:
        near = names
    hint = f"; did you mean {', '.join(near)}?" if near else f" among {len(names)} known"
    hint = hint if names else "; there is none at all"
    return f"no {kind} {name!r}{hint}"


def raise_all(error: type[FtcalError], where: str, faults: Iterable[str]) -> None:
    """Raise one `error` that lists every fault found in `where`; do nothing where there is none."""
    found = list(faults)
    if found:
        raise error(f"{where}: {'; '.join(found)}")
