"""A log in pieces is the log that is read at once."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import csv, parquet

from ftcal import logs
from ftcal.errors import DataError, LogError
from ftcal.logs import streamed, tables_batches, tables_pieces
from ftcal.logs.layout import Layout, TimeUnit
from ftcal.logs.pieces import Pieces, WholeLog, joined, median_period, signal_between
from ftcal.logs.streamed import StreamedPieces
from ftcal.recording import NANOSECONDS, Signal
from piecewise import assert_are_pieces, assert_same, put_together

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

EPOCH = 1_700_000_000 * NANOSECONDS
WRENCH = tuple(f"leg.{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz"))
LAYOUT = Layout(temperatures={"board": "board"}, imus={"base": ("ax", "ay")})
STEP = 1_000_000  # nanoseconds

one_folder = settings(
    max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def columns(names: Sequence[str], stamps: Sequence[int]) -> dict[str, object]:
    """Return a table of numbers that are all different, on stamps [ns since EPOCH]."""
    rng = np.random.default_rng(len(stamps))
    moments = pa.array([EPOCH + stamp for stamp in stamps]).cast(pa.timestamp("ns", "UTC"))
    return {"time": moments, **{name: rng.normal(size=len(stamps)) for name in names}}


def write(file: Path, table: dict[str, object]) -> Path:
    if file.suffix == ".csv":
        moments = table.get("time")
        if isinstance(moments, pa.Array):
            counts = moments.cast(pa.int64()).to_pylist()
            text = [f"{n // NANOSECONDS}.{n % NANOSECONDS:09d}" for n in counts]
            table = {**table, "time": text}
        options = csv.WriteOptions(quoting_style="none")
        csv.write_csv(pa.table(table), file, options)
    else:
        parquet.write_table(pa.table(table), file, row_group_size=13)
    return file


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches of 45 numbers of a Parquet file, or of 600 bytes of a CSV file."""
    monkeypatch.setattr(tables_pieces, "NUMBERS", 45)
    monkeypatch.setattr(tables_batches, "BLOCK", 600)


def in_batches(path: Path, layout: Layout = LAYOUT) -> StreamedPieces:
    """Return a table opened in pieces; the test fails where it comes as a whole."""
    opened = logs.in_pieces(path, layout)
    assert isinstance(opened, StreamedPieces)
    return opened


clocks = st.lists(st.integers(0, 3), min_size=1, max_size=60).map(
    lambda steps: [int(stamp) * STEP for stamp in np.cumsum(steps)]
)
"""Stamps of which some repeat the one before."""


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@one_folder
@given(clock=clocks, rows=st.integers(1, 70))
def test_the_pieces_of_a_table_are_the_table(
    suffix: str, clock: list[int], rows: int, tmp_path: Path
) -> None:
    file = write(tmp_path / f"log{suffix}", columns([*WRENCH, "knee", "board", "ax", "ay"], clock))
    pieces = list(in_batches(file).pieces(rows=rows))
    assert_same(put_together(pieces), logs.read(file, LAYOUT))
    distinct = len(set(clock))
    assert [len(p.own.channels[0]) for p in pieces] == [
        min(rows, distinct - done) for done in range(0, distinct, rows)
    ]


@pytest.mark.usefixtures("small")
@one_folder
@given(
    legs=clocks, board=clocks, late=st.integers(-50, 50), rows=st.integers(1, 70),
    overlap=st.integers(0, 40),
)  # fmt: skip
def test_tables_with_clocks_of_their_own_are_cut_at_common_times(
    legs: list[int], board: list[int], late: int, rows: int, overlap: int, tmp_path: Path
) -> None:
    folder = tmp_path / "log"
    folder.mkdir(exist_ok=True)
    write(folder / "legs.parquet", columns([*WRENCH, "knee"], legs))
    later = [stamp + late * STEP for stamp in board]
    write(folder / "slow.csv", columns(["board", "ax", "ay"], later))
    write(folder / "text.csv", {**columns([], [5]), "note": ["nothing that is read"]})
    pieces = list(in_batches(folder).pieces(rows=rows, overlap=overlap * STEP / NANOSECONDS))
    whole = logs.read(folder, LAYOUT)
    assert_are_pieces(pieces, whole, rows=rows, margin=overlap * STEP)


@given(breaks=st.sets(st.integers(1, 19)), cuts=st.sets(st.integers(0, 20)))
def test_a_signal_that_is_cut_and_joined_keeps_its_sessions(
    breaks: set[int], cuts: set[int]
) -> None:
    values = np.arange(40.0).reshape(20, 2)
    whole = Signal("leg", ("a", "b"), np.arange(20), values, tuple(sorted(breaks)))
    edges = [-1, *sorted(cuts), 21]
    parts = [signal_between(whole, start, stop) for start, stop in pairwise(edges)]
    assert joined(parts).breaks == whole.breaks
    assert all(bool(p.breaks[:1] == (0,)) == (p.stamps[0] in breaks) for p in parts if len(p))


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_whole_numbers_of_any_unit_are_told_alike(
    tmp_path: Path, unit: TimeUnit, suffix: str
) -> None:
    factor = {"s": NANOSECONDS, "ms": 10**6, "us": 10**3, "ns": 1}[unit]
    stamps = np.arange(40) + EPOCH // factor
    file = write(tmp_path / f"log{suffix}", {**columns(WRENCH, range(40)), "time": stamps})
    assert_same(put_together(list(in_batches(file, Layout()).pieces(rows=7))), logs.read(file))


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_units_that_a_job_declares_hold_in_pieces(tmp_path: Path, suffix: str) -> None:
    layout = Layout(
        angle="deg", acceleration="g", time_unit="ms", imus={"base": ("ax", "ay", "az")}
    )
    numbers = columns([*WRENCH, "knee", "ax", "ay", "az"], range(40))
    file = write(tmp_path / f"log{suffix}", {**numbers, "time": np.arange(40) * 2.5})
    pieces = list(in_batches(file, layout).pieces(rows=7))
    assert_same(put_together(pieces), logs.read(file, layout))


@pytest.mark.parametrize("first", [0.0, 9_007_199.0])
def test_seconds_beyond_104_days_are_rounded_as_the_whole_column(
    tmp_path: Path, first: float
) -> None:
    """float64 holds nanoseconds up to 2^53 of them only: a log that passes there comes whole."""
    seconds = first + np.linspace(0.0, 1.0, 40)
    file = write(tmp_path / "log.parquet", {**columns(WRENCH, range(40)), "time": seconds})
    opened = logs.in_pieces(file)
    assert isinstance(opened, WholeLog) == (first > 0)
    assert_same(put_together(list(opened.pieces(rows=7))), logs.read(file))


def refusal(path: Path, layout: Layout = LAYOUT) -> tuple[str, str]:
    """Return what is said of a log that is read in pieces, and at once."""
    with pytest.raises(LogError) as at_once:
        logs.read(path, layout)
    with pytest.raises(LogError) as in_pieces:
        for _ in logs.in_pieces(path, layout).pieces(rows=3):
            pass
    return str(in_pieces.value), str(at_once.value)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("row", range(1, 23))
def test_time_that_goes_back_is_refused_across_any_edge(
    tmp_path: Path, suffix: str, row: int
) -> None:
    stamps = [n * STEP for n in range(23)]
    stamps[row] = (row - 1) * STEP - 7
    said, expected = refusal(write(tmp_path / f"log{suffix}", columns(WRENCH, stamps)), Layout())
    assert said == expected
    assert "time goes back" in said


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("rows", [[0], [4], [5], [6, 21], [9, 10, 22]])
def test_a_number_that_is_none_is_refused_with_its_row_and_their_count(
    tmp_path: Path, suffix: str, rows: list[int]
) -> None:
    table = columns([*WRENCH, "knee"], [n * STEP for n in range(23)])
    for name in ("leg.ty", "leg.fy"):
        numbers = np.array(table[name])
        numbers[rows] = np.nan
        table[name] = numbers
    said, expected = refusal(write(tmp_path / f"log{suffix}", table), Layout())
    assert said == expected
    assert f"row {rows[0] + (2 if suffix == '.csv' else 1)}: column 'leg.fy' is nan" in said
    assert f"({2 * len(rows)} such values in all)" in said


@pytest.mark.usefixtures("small")
def test_missing_numbers_and_stamps_are_refused_alike(tmp_path: Path) -> None:
    stamps = [n * STEP for n in range(23)]
    table = columns(WRENCH, stamps)
    holed = {**table, "leg.fx": pa.array([None if n == 17 else 1.0 for n in range(23)])}
    said, expected = refusal(write(tmp_path / "null.parquet", holed), Layout())
    assert said == expected
    moments = [None if n == 17 else EPOCH + stamp for n, stamp in enumerate(stamps)]
    blind = {**table, "time": pa.array(moments, pa.timestamp("ns"))}
    said, expected = refusal(write(tmp_path / "blind.parquet", blind), Layout())
    assert said == expected
    assert "row 18: no time stamp" in said


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize(
    "fault", ["text", "absent", "joint", "twice", "timeless", "empty", "broken"]
)
def test_what_is_no_table_is_refused_alike(tmp_path: Path, suffix: str, fault: str) -> None:
    table = columns(WRENCH, [n * STEP for n in range(23)])
    layout = Layout(channels={"leg": WRENCH})
    file = tmp_path / f"log{suffix}"
    if fault == "text":
        write(file, {**table, "leg.fx": ["left"] * 23})
    elif fault == "absent":
        write(file, {n: c for n, c in table.items() if n != "leg.tz"})
    elif fault == "joint":
        layout = Layout(channels={"leg": WRENCH}, joints={"hip": ("knee",)})
        write(file, table)
    elif fault == "twice":
        write(file, {"time": table["time"], "leg.fx": np.ones(23), "leg_fx": np.ones(23)})
        file.write_bytes(file.read_bytes().replace(b"leg_fx", b"leg.fx"))
    elif fault == "timeless":
        write(file, {"stamp": np.arange(3.0), "leg.fx": np.ones(3)})
    elif fault == "empty":
        write(file, columns(WRENCH, []))
    else:
        file.write_bytes(write(file, table).read_bytes()[:100])
    said, expected = refusal(file, layout)
    assert said == expected


def test_a_file_that_breaks_off_while_it_is_read_is_named(tmp_path: Path) -> None:
    file = write(tmp_path / "log.parquet", columns(WRENCH, range(1000)))
    opened = in_batches(file, Layout())
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(LogError, match=r"log\.parquet: not a readable table"):
        list(opened.pieces(rows=10))


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("late", ["0.3,left", "0.30000000000000004,1.5"])
def test_a_late_row_that_changes_a_type_has_the_whole_table_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: str
) -> None:
    """Text in a column of numbers; a stamp with more digits than those of the head."""
    monkeypatch.setattr(tables_batches, "_HEAD", 600)
    file = tmp_path / "log.csv"
    lines = [f"{n / 1000},{n}.5,{n}" for n in range(300)]
    file.write_text("\n".join(["time,knee,hip", *lines, f"{late},1"]) + "\n")
    opened = logs.in_pieces(file)
    assert isinstance(opened, WholeLog)
    assert_same(put_together(list(opened.pieces(rows=7))), logs.read(file))


def stretches(stamps: Int[Array, "N"]) -> Iterator[Int[Array, "M"]]:
    for start in range(0, max(len(stamps) - 1, 1), 7):
        yield stamps[start : start + 8]


@settings(deadline=None)
@given(st.lists(st.one_of(st.integers(1, 5), st.integers(1, 2**50)), max_size=40))
def test_the_median_period_is_that_of_all_steps(steps: list[int]) -> None:
    stamps = np.cumsum([EPOCH, *steps])
    found = median_period(lambda: stretches(stamps), len(steps), max(steps, default=0))
    expected = float(np.median(np.diff(stamps))) / NANOSECONDS if steps else float("nan")
    assert found == expected or not steps
    assert np.isnan(found) == (not steps)


@pytest.mark.usefixtures("small")
def test_a_period_is_that_of_the_whole_signal(tmp_path: Path) -> None:
    stamps = np.cumsum(np.random.default_rng(0).integers(0, 5, 200)) * STEP
    file = write(tmp_path / "log.csv", columns([*WRENCH, "board", "ax", "ay"], stamps.tolist()))
    opened: Pieces = in_batches(file)
    whole = logs.read(file, LAYOUT)
    assert opened.period("temperatures", "board") == whole.temperatures[0].period
    assert opened.period("channels", "leg") == WholeLog(whole).period("channels", "leg")
    with pytest.raises(DataError, match="no temperatures signal of recording 'log' 'bord'; did"):
        opened.period("temperatures", "bord")


def test_a_log_of_another_format_is_read_as_a_whole(tmp_path: Path) -> None:
    file = tmp_path / "log.npz"
    np.savez(file, time=np.arange(20) / 100, leg=np.arange(120.0).reshape(20, 6))
    opened = logs.in_pieces(file)
    assert isinstance(opened, WholeLog)
    assert_same(put_together(list(opened.pieces(rows=3))), logs.read(file))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_memory_does_not_grow_with_the_log(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """NumPy's share; that of Arrow is in benchmarks/applying.py."""
    monkeypatch.setattr(tables_pieces, "NUMBERS", 14_000)
    monkeypatch.setattr(streamed, "NUMBERS", 14_000)
    monkeypatch.setattr(tables_batches, "BLOCK", 1 << 18)
    table = columns(WRENCH, [n * STEP for n in range(200_000)])
    file = tmp_path / f"log{suffix}"
    if suffix == ".csv":
        write(file, table)
    else:
        parquet.write_table(pa.table(table), file)
    opened = in_batches(file, Layout())
    tracemalloc.start()
    seen = sum(len(piece.own.channels[0]) for piece in opened.pieces())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seen == 200_000
    # the log is 11.2 MB of numbers, a piece 0.1 MB, a block of text 0.1 MB of numbers
    assert peak < 2e6
