"""How all benchmarks measure: in turn, on one core, as ratios with a spread.

A benchmark gives records. Ours and theirs take turns within a round, so that a noisy neighbour
slows both; a ratio is the median over the rounds of their time over ours, larger is better for
ftcal. Seconds are told but never compared: they are the machine's.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

K = TypeVar("K")
Key = tuple[str, str, str]
"""Name, what it is compared with, size."""

WIDTH = 100
"""Columns of a table."""


@dataclass(frozen=True, slots=True)
class Record:
    """One thing that ftcal does, against the tool that a user would otherwise run."""

    name: str
    """What is done."""
    against: str
    """What it is compared with."""
    size: str
    """On how much; ratios of other sizes say nothing of each other."""
    ratio: float
    """Their time over ours, median over the rounds."""
    low: float
    """Smallest ratio of a round."""
    high: float
    """Largest ratio of a round."""
    seconds: float
    """Our time [s], median over the rounds."""

    @staticmethod
    def of(
        name: str,
        against: str,
        size: str,
        *,
        ours: Sequence[float],
        theirs: Sequence[float],
        times: float = 1.0,
    ) -> Record:
        """Return the record of the seconds of every round.

        `times` is how many times longer our input was, where theirs is too slow for all of it.
        """
        ratios = [times * b / a for a, b in zip(ours, theirs, strict=True)]
        return Record(name, against, size, median(ratios), min(ratios), max(ratios), median(ours))

    @property
    def key(self) -> Key:
        """What makes two records comparable."""
        return self.name, self.against, self.size


@dataclass(frozen=True, slots=True)
class Benchmark:
    """A file of this folder: how it is measured, and on how much."""

    measure: Callable[..., list[Record]]
    """Its measurement; keywords are those of the sizes."""
    full: Mapping[str, int]
    """Sizes that are measured."""
    quick: Mapping[str, int]
    """Sizes of a smoke run: seconds, figures without meaning."""

    def main(self, description: str | None, arguments: Sequence[str] | None = None) -> None:
        """Measure as the command line asks, on one core, and print the table."""
        parser = argparse.ArgumentParser(
            description=description, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        for name, size in self.full.items():
            parser.add_argument(f"--{name}", type=int, help=f"default {size}")
        parser.add_argument("--quick", action="store_true", help="a smoke run on tiny sizes")
        parser.add_argument("--json", type=Path, metavar="FILE", help="write the records")
        told = vars(parser.parse_args(arguments))
        quick, file = told.pop("quick"), told.pop("json")
        said = {name: size for name, size in told.items() if size is not None}
        pinned()
        records = self.measure(**{**(self.quick if quick else self.full), **said})
        if file:
            file.write_text(json.dumps([asdict(record) for record in records]))
        print(*table(records), sep="\n")


def pinned() -> None:
    """Keep this process, and all that it starts, on one core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def seconds_of(call: Callable[[], object]) -> float:
    """Return the seconds that a call takes."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def interleaved(calls: Mapping[K, Callable[[], object]], rounds: int) -> dict[K, list[float]]:
    """Return the seconds of each call in each round."""
    times: dict[K, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            times[name].append(seconds_of(call))
    return times


def shown(figure: float) -> str:
    """Return a ratio with three digits."""
    return f"{figure:.0f}" if figure >= 100 else f"{figure:.3g}"


def table(records: Iterable[Record], notes: Mapping[Key, str] | None = None) -> list[str]:
    """Return the lines of a table; a note, by the key of its record, ends a line."""
    lines = [
        f"{'':<42.42} {'against':<20.20} {'ratio':>6} {'of rounds':>13}  {'now':>7}",
        "-" * WIDTH,
    ]
    for one in records:
        spread = f"{shown(one.low)} to {shown(one.high)}"
        line = f"{one.name:<42} {one.against:<20} {shown(one.ratio):>6} {spread:>13}  {ours(one)}"
        lines.append(f"{line}  {(notes or {}).get(one.key, '')}".rstrip())
    return lines


def ours(record: Record) -> str:
    """Return our seconds with a unit, seven characters."""
    seconds = record.seconds
    return f"{seconds * 1e3:>4.3g} ms" if seconds < 1 else f"{seconds:>5.3g} s"


def markdown(records: Iterable[Record]) -> list[str]:
    """Return the lines of the table of the README."""
    lines = ["| step | against | ratio | in rounds | on |", "|---|---|---|---|---|"]
    return lines + [
        f"| {one.name} | {one.against} | {shown(one.ratio)} | {shown(one.low)} to {shown(one.high)}"
        f" | {one.size} |"
        for one in records
    ]


def machine() -> dict[str, Any]:
    """Return where and when something is measured; load is that of the last minute."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": named[0] if named else platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "llvmlite", "pyarrow")},
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0,
    }


def same_machine(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether ratios of both can be compared: all but date and load are the same."""
    return {**one, "date": "", "load": 0.0} == {**other, "date": "", "load": 0.0}
