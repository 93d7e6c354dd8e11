"""How fast logs are read, as ratios to what pyarrow's parser alone needs.

Ratios of medians over interleaved rounds of one run; the same text lies in the page cache for all.
`python benchmarks/reading.py --rows 1000000 --rounds 9`
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
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


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Print and return the median time of each reader over that of its yardstick."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        home = Path(temporary)
        write_logs(home, options.rows, seed=0)
        port = home / "ft" / "icub" / "left_leg" / "analog:o" / "data.log"
        parquet = home / "take.parquet"
        runs: dict[str, tuple[Callable[[], object], Callable[[], object]]] = {
            "YARP F/T / arrow": (lambda: read(home / "ft"), lambda: arrow_alone(port, " ")),
            "YARP stateExt / arrow, clean": (
                lambda: read(home / "board"), lambda: arrow_alone(home / "board.txt", " "),
            ),
            "CSV / arrow": (
                lambda: read(home / "take.csv"), lambda: arrow_alone(home / "take.csv", ","),
            ),
            "Parquet / arrow": (lambda: read(parquet), lambda: pq.read_table(parquet)),
        }  # fmt: skip
        times: dict[str, tuple[list[float], list[float]]] = {name: ([], []) for name in runs}
        for _ in range(options.rounds):
            for name, pair in runs.items():
                for run, spent in zip(pair, times[name], strict=True):
                    start = time.perf_counter()
                    run()
                    spent.append(time.perf_counter() - start)
    ratios = {}
    print(f"{'':32}{'reader ms':>12}{'yardstick ms':>14}{'ratio':>8}")
    for name, (ours, theirs) in times.items():
        a, b = median(ours), median(theirs)
        ratios[name] = a / b
        print(f"{name:32}{a * 1e3:12.1f}{b * 1e3:14.1f}{a / b:8.2f}")
    return ratios


if __name__ == "__main__":
    main()
