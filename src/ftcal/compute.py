"""Where pieces of work run: here one by one, on the cores of this machine, or on a Dask cluster.

A piece is a name and what it is made of. One that cannot be done, because its log is broken or
because it takes its worker down with it, costs that piece alone: the others are finished, and it is
told by name.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from ftcal.errors import FtcalError, JobError

A = TypeVar("A")
B = TypeVar("B")

ATTEMPTS = 2
"""Times that a piece is tried which takes its worker down with it."""

HERE, LOCAL = "here", "local"
"""Names of the schedulers that need no cluster."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a piece could not be done."""

    reason: str
    """One line for a person."""


class Executor(Protocol):
    """Runs a task on pieces."""

    def run(
        self, task: Callable[[A], B], pieces: Mapping[str, A]
    ) -> Iterator[tuple[str, B | Failure]]:
        """Yield name and result of every piece, as they are done."""


def executor(scheduler: str, workers: int | None = None) -> Executor:
    """Return where to run: `here`, `local` (a process a core), or the address of a Dask scheduler.

    Raises `JobError` for any other word.
    """
    if scheduler == HERE:
        return Here()
    if scheduler == LOCAL:
        return Processes(workers or os.cpu_count() or 1)
    if "://" in scheduler:
        return Cluster(scheduler)
    raise JobError(
        f"scheduler {scheduler!r} is none: give {HERE!r}, {LOCAL!r} or an address as tcp://host:8786"
    )


def attempted(task: Callable[[A], B], argument: A) -> B | Failure:
    """Return the result of a piece, or why it has none."""
    try:
        return task(argument)
    except FtcalError as error:
        return Failure(str(error))
    except MemoryError:
        return Failure("not enough memory; give it to a machine with more, or split the recording")


@dataclass(frozen=True, slots=True)
class Here:
    """One piece after the other, in this process."""

    def run(
        self, task: Callable[[A], B], pieces: Mapping[str, A]
    ) -> Iterator[tuple[str, B | Failure]]:
        """Yield name and result of every piece, in order."""
        for name, argument in pieces.items():
            yield name, attempted(task, argument)


def end_with_parent() -> None:
    """End this worker when whoever started it is gone, killed without a chance to say so."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@dataclass(frozen=True, slots=True)
class Processes:
    """A pool of processes on this machine."""

    workers: int

    def run(
        self, task: Callable[[A], B], pieces: Mapping[str, A]
    ) -> Iterator[tuple[str, B | Failure]]:
        """Yield name and result of every piece, as they are done.

        Whoever kills a worker breaks the pool for all that are under way; they are tried again,
        then each in a process of its own, so that the culprit falls alone.
        """
        left = dict(pieces)
        for _ in range(ATTEMPTS):
            for name, result in self._together(task, left, self.workers):
                del left[name]
                yield name, result
            if not left:
                return
        for name, argument in left.items():
            alone = list(self._together(task, {name: argument}, 1))
            yield alone[0] if alone else (name, Failure(_killed(ATTEMPTS + 1)))

    @staticmethod
    def _together(
        task: Callable[[A], B], pieces: Mapping[str, A], workers: int
    ) -> Iterator[tuple[str, B | Failure]]:
        """Yield what a pool finished before it broke, if it does."""
        # a forked copy of a process with threads (BLAS, Arrow) may hang
        spawn = multiprocessing.get_context("spawn")
        size = min(workers, len(pieces))
        with ProcessPoolExecutor(size, mp_context=spawn, initializer=end_with_parent) as pool:
            names: dict[Future[B | Failure], str] = {}
            for name, argument in pieces.items():
                try:
                    names[pool.submit(attempted, task, argument)] = name
                except BrokenProcessPool:
                    break
            for future in as_completed(names):
                if not isinstance(future.exception(), BrokenProcessPool):
                    yield names[future], future.result()


@dataclass(frozen=True, slots=True)
class Cluster:
    """The workers of a Dask scheduler that runs already; they must see the same files."""

    address: str
    patience: float = 10.0
    """Seconds to wait for the scheduler."""

    def run(
        self, task: Callable[[A], B], pieces: Mapping[str, A]
    ) -> Iterator[tuple[str, B | Failure]]:
        """Yield name and result of every piece, as they are done.

        Raises `JobError` where no scheduler answers, or `distributed` is not installed.
        """
        with self._client() as client:
            from distributed import KilledWorker
            from distributed import as_completed as completed

            futures = {
                client.submit(attempted, task, argument, pure=False, retries=ATTEMPTS): name
                for name, argument in pieces.items()
            }
            for future in completed(futures, loop=client.loop):
                if isinstance(future.exception(), KilledWorker):
                    yield futures[future], Failure(_killed(ATTEMPTS + 1))
                else:
                    yield futures[future], future.result()

    def _client(self) -> Any:
        try:
            from distributed import Client
        except ImportError as error:
            raise JobError(
                f'{self.address}: Dask is not installed: pip install "ftcal[cluster]"'
            ) from error
        try:
            return Client(self.address, timeout=self.patience, set_as_default=False)
        except (OSError, ValueError) as error:
            raise JobError(
                f"{self.address}: no Dask scheduler answers within {self.patience:g} s; start one,"
                " or give --scheduler local"
            ) from error


def _killed(times: int) -> str:
    return f"took its worker down {times} times (out of memory?); try it alone: --scheduler here"
