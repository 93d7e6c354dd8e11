"""A piece that fails costs that piece alone, wherever it runs."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from ftcal.compute import Cluster, Executor, Failure, Here, Processes, executor
from ftcal.errors import FtcalError, JobError, LogError

PIECES = {f"piece {k}": k for k in range(6)}


def doubled(number: int) -> int:
    return 2 * number


def broken_at_three(number: int) -> int:
    if number == 3:
        raise LogError("three.csv: the file is empty; leave it out")
    return 2 * number


def deadly_at_three(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def deadly_once(marks: tuple[int, str]) -> int:
    number, folder = marks
    mark = Path(folder) / "killed"
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def wrong_at_three(number: int) -> int:
    return 1 // (3 - number)


@pytest.mark.parametrize("where", [Here(), Processes(2)])
def test_every_piece_is_done_once(where: Executor) -> None:
    assert dict(where.run(doubled, PIECES)) == {name: 2 * k for name, k in PIECES.items()}


@pytest.mark.parametrize("where", [Here(), Processes(2)])
def test_a_broken_log_costs_its_piece_alone(where: Executor) -> None:
    found = dict(where.run(broken_at_three, PIECES))
    assert found.pop("piece 3") == Failure("three.csv: the file is empty; leave it out")
    assert found == {name: 2 * k for name, k in PIECES.items() if k != 3}


def test_who_kills_its_worker_falls_alone() -> None:
    found = dict(Processes(2).run(deadly_at_three, PIECES))
    failure = found.pop("piece 3")
    assert isinstance(failure, Failure)
    assert failure.reason.startswith("took its worker down 3 times")
    assert found == {name: 2 * k for name, k in PIECES.items() if k != 3}


def test_a_worker_that_is_killed_once_costs_nothing(tmp_path: Path) -> None:
    pieces = {name: (k, str(tmp_path)) for name, k in PIECES.items()}
    assert dict(Processes(2).run(deadly_once, pieces)) == {n: 2 * k for n, k in PIECES.items()}


@pytest.mark.parametrize("where", [Here(), Processes(1)])
def test_a_fault_of_ours_is_not_hidden(where: Executor) -> None:
    with pytest.raises(ZeroDivisionError):
        list(where.run(wrong_at_three, PIECES))


def test_a_cluster_does_the_same(cluster: Cluster) -> None:
    assert dict(cluster.run(doubled, PIECES)) == dict(Here().run(doubled, PIECES))
    found = dict(cluster.run(broken_at_three, PIECES))
    assert found == dict(Here().run(broken_at_three, PIECES))


def test_a_scheduler_that_does_not_answer_is_told_in_one_line() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(JobError, match=r"^tcp://localhost:9: no Dask scheduler answers within 0.2"):
        list(Cluster("tcp://localhost:9", patience=0.2).run(doubled, PIECES))


@pytest.mark.parametrize("word", ["", "dask", "localhost:8786"])
def test_an_unknown_scheduler_is_told_in_one_line(word: str) -> None:
    with pytest.raises(FtcalError, match=r"give 'here', 'local' or an address as tcp://host:8786"):
        executor(word)
