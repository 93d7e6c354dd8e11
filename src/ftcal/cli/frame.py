"""What all commands share: errors as one line, progress, a console, options, places to write."""

from __future__ import annotations

import functools
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import click

from ftcal.errors import FtcalError, OutputError

if TYPE_CHECKING:
    from rich.console import Console

    from ftcal.progress import Progress

P = ParamSpec("P")
R = TypeVar("R")

NOT_BETTER = 3
"""Exit code of a run that found no axis better than its Workbench."""

WIDTH = 100
"""Columns of a table where the terminal does not say."""

PATIENCE = 2.0
"""Seconds after which a run shows how far it is."""

TEXT = click.Path(path_type=Path)
as_json = click.option("--json", "machine", is_flag=True, help="Print JSON instead of tables.")
workers_option = click.option(
    "--workers", type=click.IntRange(1), help="Processes (default: one a core)."
)


def scheduler_option(default: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return the option that says where recordings are read and paired."""
    return click.option(
        "--scheduler",
        metavar="WHERE",
        help=f"here, local or a Dask scheduler's tcp://HOST:PORT (default: {default}).",
    )


def mendable(command: Callable[P, R]) -> Callable[P, R]:
    """Turn an `FtcalError` into one line on stderr and exit code 1."""

    @functools.wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except FtcalError as error:
            click.echo(f"ftcal: {' '.join(str(error).split())}", err=True)
            sys.exit(1)

    return wrapped


def require_writable(folder: Path, *, option: str = "-o") -> None:
    """Raise `OutputError` where a folder that `option` names cannot be made or written.

    What takes minutes is not begun for a place that cannot take its results. Nothing is created:
    what is asked is the nearest folder that is there.
    """
    place = folder.absolute()
    try:
        place = next(one for one in (place, *place.parents) if is_there(one))
        # permissions alone do not tell: a disk may be full, or mounted for reading only
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot be written ({place}: {error.strerror}); name another folder with"
            f" {option}"
        ) from error


def is_there(place: Path) -> bool:
    """Return whether a path names anything, be it a link that leads nowhere.

    Raises `OSError` where that cannot be told.
    """
    try:
        place.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Yield a progress callback that draws a bar on a terminal's stderr once a run takes long."""
    import threading
    import time

    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    rate = TextColumn("{task.fields[rate]}")
    columns = (BarColumn(), MofNCompleteColumn(), rate)
    doing = TextColumn("{task.description}")
    bar = Bar(*columns, TimeRemainingColumn(), doing, console=Console(stderr=True), transient=True)
    task = bar.add_task("starting", total=None, rate="")

    begun = time.monotonic()

    def tell(doing: str, done: int, total: int) -> None:
        rate = done / max(time.monotonic() - begun, 1e-9)
        shown = f"{rate:.2g} steps/s" if done else ""
        bar.update(task, description=escape(doing), completed=done, total=total, rate=shown)

    timer = threading.Timer(PATIENCE, bar.start)
    timer.daemon = True
    if sys.stderr.isatty():
        timer.start()
    try:
        yield tell
    finally:
        timer.cancel()
        if bar.live.is_started:
            bar.stop()


def console() -> Console:
    """Return the console of the results: the terminal's width, or 100 columns into a file."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)
