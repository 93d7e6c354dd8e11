"""A calibration applied: in a control loop, to channels in memory, and to a log on disk.

    python benchmarks/applying.py --samples 3000000 --rounds 3

The map of channels is measured against BLAS, whose result depends on where a row stands; the
command against what an engineer writes with pyarrow and NumPy for a log that fits into memory. Both
take turns within a round. Each command is a process of its
own, and its peak memory is what the system says of it. To a process the system counts what its
parent held when it was started, so logs are made in processes of their own, too.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
import pyarrow as pa
from measure import Benchmark, Record, interleaved
from pyarrow import parquet

from ftcal.applying import by_rows
from ftcal.calibration import (
    AxisVerdict,
    Calibration,
    Centre,
    Offset,
    Prior,
    Provenance,
    SensorCalibration,
    to_json,
)
from ftcal.live import SdReader, WrenchReader
from ftcal.sensor import AXES

CHANNELS = 131_072
"""Samples of the map in memory: a piece of the command."""
GENERATED = 1_000_000
"""Rows of a log that are made at a time."""
NAMES = [f"leg.{axis}" for axis in AXES]

BY_HAND = """
import json, sys
import numpy as np, pyarrow as pa
from pyarrow import parquet
sensor = json.load(open(sys.argv[1]))["sensors"][0]
C, o = np.array(sensor["gain"]), np.array(sensor["offsets"][0]["offset"])
table = parquet.read_table(sys.argv[2])
names = table.column_names[1:]
r = np.column_stack([table[name].to_numpy() for name in names])
w = r @ C.T + o
columns = [pa.array(np.ascontiguousarray(column)) for column in w.T]
parquet.write_table(pa.table([table["time"], *columns], names=["time", *names]), sys.argv[3])
"""
"""What an engineer writes."""


def calibration() -> Calibration:
    """Return a calibration of one sensor, of numbers drawn at random."""
    rng = np.random.default_rng(0)
    gain = (rng.normal(size=(6, 6)) * 0.05).tolist()
    centre = Centre(inputs=[100.0] * 6, sd=[0.1] * 6)
    offset = Offset(
        recording="log", start=0.0, stop=1.0, offset=[1.0] * 6, sd=[0.1] * 6, centre=centre
    )
    prior = Prior(
        name="drawn", gain=gain, full_scale=[2e3] * 3 + [40.0] * 3, form="kappa", strength=0.1,
        chosen_by="job",
    )  # fmt: skip
    sensor = SensorCalibration(
        sensor="leg", signal="leg", logged="channels", frame="leg", acts_on="leg",
        temperature_signal=None, gain=gain, fitted_gain=gain, secondary=None,
        temperature_gain=None, reference_temperature=0.0, offsets=[offset],
        covariance=[(1e-8 * np.eye(6)).tolist()] * 6, envelope={}, noise_sd=[0.1] * 6,
        inefficiency=[1.0] * 6, prior=prior,
        verdicts=[AxisVerdict(axis=axis, verdict="ACCEPT", reason="drawn") for axis in AXES],
        health=[],
    )  # fmt: skip
    none = Provenance(ftcal="", python="", numpy="", created="", inputs=[])
    return Calibration(robot="drawn", sensors=[sensor], provenance=none)


def write_log(file: Path, samples: int) -> None:
    """Write a log at 1 kHz, counts with noise, without holding more than a stretch of it."""
    rng = np.random.default_rng(0)
    schema = pa.schema([("time", pa.timestamp("ns", "UTC")), *((n, pa.float64()) for n in NAMES)])
    with parquet.ParquetWriter(str(file), schema, compression="zstd") as sink:
        for start in range(0, samples, GENERATED):
            n = np.arange(start, min(start + GENERATED, samples))
            stamps = 1_700_000_000 * 10**9 + n * 10**6 + rng.integers(0, 10**5, len(n))
            slow = 1e3 * np.sin(n[:, None] / 1e3 * np.linspace(0.3, 2.0, 6))
            counts = np.rint(slow + 20.0 * rng.standard_normal((len(n), 6)))
            moments = pa.array(stamps).cast(schema.field("time").type)
            sink.write_table(pa.table([moments, *map(pa.array, counts.T.copy())], schema=schema))


def run(arguments: Sequence[str]) -> tuple[float, float]:
    """Return seconds and peak memory [MB] of a process of its own."""
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{arguments[:4]} failed")
    return time.perf_counter() - start, used.ru_maxrss / 1e3


def control_loop(rounds: int) -> None:
    """Print microseconds of a sample."""
    (sensor,) = calibration().sensors
    sample = np.ones(6)
    for name, read in (("wrench", WrenchReader(sensor).read), ("sd", SdReader(sensor).read)):
        spent = timeit.repeat(partial(read, sample), number=10_000, repeat=10 * rounds)
        # the fastest says what the code costs, the median what others on this machine add
        print(f"one sample, {name:8}{min(spent) * 100:8.2f} us, median {median(spent) * 100:.2f}")


def mapping(rounds: int) -> Record:
    """Return the record of the pure 6x6 map."""
    rng = np.random.default_rng(0)
    x = np.asfortranarray(rng.normal(size=(CHANNELS, 6)))
    gain, offset = rng.normal(size=(6, 6)), rng.normal(size=6)
    ways: dict[str, Callable[[], object]] = {
        "ftcal": lambda: by_rows(x, gain, offset),
        "BLAS": lambda: x @ gain.T + offset,
    }
    spent = interleaved(ways, 10 * rounds)
    print(f"6x6 map: {CHANNELS / median(spent['ftcal']) / 1e6:.1f} million samples/s")
    size = f"{CHANNELS} samples"
    return Record.of("apply: 6x6 map in memory", "BLAS", size, ours=spent["ftcal"],
                     theirs=spent["BLAS"])  # fmt: skip


def command(home: Path, samples: int, rounds: int) -> Record:
    """Print rate and memory of `ftcal apply`, and return its record."""
    known, log = home / "calibration.json", home / "log.parquet"
    known.write_bytes(to_json(calibration()))
    run([__file__, "--write", str(log), str(samples)])
    apply = ["-m", "ftcal.cli", "apply", str(known), str(log), "-o"]
    ways = {
        "ftcal apply": [*apply, str(home / "out.parquet")],
        "ftcal apply --sd": [*apply, str(home / "sd.parquet"), "--sd"],
        "by hand": ["-c", BY_HAND, str(known), str(log), str(home / "hand.parquet")],
    }
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, arguments in ways.items():
            spent[name].append(run(arguments))
    print(f"{samples} samples x 7 columns, {log.stat().st_size / 1e6:.0f} MB of Parquet")
    seconds = {name: [s for s, _ in each] for name, each in spent.items()}
    for name, each in spent.items():
        rate, peak = samples / median(seconds[name]) / 1e6, max(mb for _, mb in each)
        print(f"{name:18}{median(seconds[name]):8.2f} s{rate:8.2f} million samples/s{peak:8.0f} MB")
    name, against = "apply: command, Parquet to Parquet", "pyarrow and NumPy"
    return Record.of(name, against, f"{samples} samples",
                     ours=seconds["ftcal apply"], theirs=seconds["by hand"])  # fmt: skip


def measure(samples: int, rounds: int) -> list[Record]:
    """Return the records of the map and of the command; what a sample costs is printed."""
    control_loop(rounds)
    with tempfile.TemporaryDirectory() as temporary:
        return [mapping(rounds), command(Path(temporary), samples, rounds)]


BENCHMARK = Benchmark(measure, {"samples": 3_000_000, "rounds": 3}, {"samples": 1_000, "rounds": 1})

if __name__ == "__main__":
    if sys.argv[1:2] == ["--write"]:
        write_log(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        BENCHMARK.main(__doc__)
