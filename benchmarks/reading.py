"""How fast logs are read, against what pyarrow's parser alone needs.

    python benchmarks/reading.py --rows 1000000 --rounds 9

The same text lies in the page cache for both. A ratio below one is what checks, stamps and the
digest of the file cost on top of the parser.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from measure import Benchmark, Record, interleaved
from pyarrow import csv

from ftcal.logs import read, tables
from ftcal.recording import Recording, Signal

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")


def write_logs(home: Path, rows: int, *, seed: int) -> None:
    """Write one F/T port, one motor board, its text cleaned, and the F/T port as tables."""
    random = np.random.default_rng(seed)
    texts = [" ".join(f"{x:.6f}" for x in row) for row in random.normal(0, 100, (997, 6))]
    heads = [
        f"{n % 32768} {1457614036 + n // 100}.{n % 100 * 10000 + n % 997:06d}" for n in range(rows)
    ]
    folder = home / "ft" / "icub" / "left_leg" / "analog:o"
    folder.mkdir(parents=True)
    lines = (f"{head} {texts[n % 997]}\n" for n, head in enumerate(heads))
    (folder / "data.log").write_text("".join(lines))
    folder = home / "board" / "icub" / "left_leg" / "stateExt:o"
    folder.mkdir(parents=True)
    few = rows // 10  # ten groups: about as much text
    groups = [" ".join(f"({texts[(n + g) % 997]}) [ok]" for g in range(10)) for n in range(997)]
    lines = (f"{head} {groups[n % 997]}\n" for n, head in enumerate(heads[:few]))
    text = "".join(lines)
    (folder / "data.log").write_text(text)
    clean = text.replace(" [ok]", "").replace("(", "").replace(")", "")
    (home / "board.txt").write_text(clean)
    stamps = 1457614036_000000000 + 10_000_000 * np.arange(rows)
    signal = Signal("left_leg", AXES, stamps, random.normal(0, 100, (rows, 6)))
    take = Recording("take", "", int(stamps[0]), (), (signal,))
    for suffix in (".csv", ".parquet"):
        tables.write(take, home / f"take{suffix}")


def arrow_alone(file: Path, delimiter: str) -> None:
    """Parse every column of `file` as float64 with pyarrow's own settings."""
    width = file.open().readline().count(delimiter) + 1
    names = [str(k) for k in range(width)]
    csv.read_csv(
        file,
        read_options=csv.ReadOptions(column_names=names, skip_rows=delimiter == ","),
        parse_options=csv.ParseOptions(delimiter=delimiter),
        convert_options=csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64())),
    )


def measure(rows: int, rounds: int) -> list[Record]:
    """Return the ratios by format."""
    with tempfile.TemporaryDirectory() as temporary:
        home = Path(temporary)
        write_logs(home, rows, seed=0)
        port = home / "ft" / "icub" / "left_leg" / "analog:o" / "data.log"
        parquet = home / "take.parquet"
        runs: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
            "YARP F/T": (lambda: read(home / "ft"), lambda: arrow_alone(port, " ")),
            "YARP stateExt": (
                lambda: read(home / "board"), lambda: arrow_alone(home / "board.txt", " "),
            ),
            "CSV": (
                lambda: read(home / "take.csv"), lambda: arrow_alone(home / "take.csv", ","),
            ),
            "Parquet": (lambda: read(parquet), lambda: pq.read_table(parquet)),
        }  # fmt: skip
        calls = {
            (name, side): call for name, pair in runs.items() for side, call in enumerate(pair)
        }
        times = interleaved(calls, rounds)
    return [
        Record.of(f"reading {name}, digest included", "pyarrow's parser", f"{rows} rows",
                  ours=times[name, 0], theirs=times[name, 1])
        for name in runs
    ]  # fmt: skip


BENCHMARK = Benchmark(measure, {"rows": 1_000_000, "rounds": 9}, {"rows": 1_000, "rounds": 1})

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
