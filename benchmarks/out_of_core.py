"""A recording larger than memory, Parquet in, calibration out: seconds, memory, and how they grow.

    python benchmarks/out_of_core.py --rows 100000 1000000 10000000 30000000

The session of `end_to_end.py` (six sensors, 69 columns) is told again and again in one recording
with stamps that go on. Every length is a process of its own, which calibrates a short recording
first: what is timed is no import and no compilation. The shortest is calibrated from memory, too;
both must agree.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from end_to_end import CHECKED, CONTACT, lasting, simulated, written
from pyarrow import parquet

from ftcal import logs
from ftcal.config import read_job
from ftcal.logs import tables

ONCE = """
import json, sys, time
from pathlib import Path
from ftcal import takes
from ftcal.pipeline import calibrate
from ftcal.config import read_job
short, job = (read_job(Path(name)) for name in sys.argv[1:3])
calibrate(short)
takes.IN_MEMORY = int(sys.argv[3])
start = time.perf_counter()
sensors = calibrate(job).sensors
seconds = time.perf_counter() - start
# of this process alone: what `getrusage` says began with what its parent held
status = Path("/proc/self/status").read_text()
peak = int(status.split("VmHWM:")[1].split()[0])
print(json.dumps({
    "seconds": seconds,
    "peak": peak / 1024,
    "gains": [sensor.fit.estimate.gain.tolist() for sensor in sensors],
}))
"""
"""A process that knows nothing but ftcal."""

TOLD = 100_000
"""Rows that are written at a time."""


def grown(file: Path, rows: int) -> Path:
    """Write one log of so many rows beside the job of the session; return its own job."""
    job = read_job(file)
    section = job.recordings[0]
    recording = logs.read(job.path(section.log), section.layout(), name="wide")
    folder = file.parent / f"long {rows}"
    folder.mkdir()
    once = folder / "once.parquet"
    layout = tables.write(lasting(recording, min(TOLD, rows), "once"), once)
    table = parquet.read_table(once)
    once.unlink()
    stamps = table["time"].to_numpy()
    step = int(stamps[-1] - stamps[0]) + int(stamps[1] - stamps[0])
    log = folder / "long.parquet"
    names = [name for name in table.column_names if name != "time"]
    with parquet.ParquetWriter(
        log,
        table.schema,
        compression="zstd",
        use_dictionary=False,
        column_encoding=dict.fromkeys(names, "BYTE_STREAM_SPLIT"),
    ) as writer:
        for start in range(0, rows, TOLD):
            later = pa.array(stamps + start // TOLD * step, type=table.schema.field("time").type)
            told = table.set_column(table.column_names.index("time"), "time", later)
            writer.write_table(told.slice(0, min(TOLD, rows - start)))
    channels = ", ".join(f'"{s}" = {list(c)}' for s, c in layout.channels.items())
    text = file.read_text().split("[[recordings]]")[0]
    made = file.with_name(f"long {rows}.toml")
    made.write_text(
        f'{text}\n[[recordings]]\nlog = "long {rows}/long.parquet"\ncontact = "{CONTACT}"\n'
        f"channels = {{ {channels} }}\n"
    )
    return made


def calibrated(short: Path, job: Path, *, in_memory: bool = False) -> dict[str, Any]:
    """Return seconds, peak memory [MB] and gains of a calibration in a process of its own."""
    most = sys.maxsize if in_memory else 0
    command = [sys.executable, "-c", ONCE, str(short), str(job), str(most)]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found: dict[str, Any] = json.loads(said)
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[100_000, 300_000, 1_000_000])
    rows = sorted(parser.parse_args().rows)
    with tempfile.TemporaryDirectory() as folder:
        file, recording = simulated(Path(folder))
        short = written(file, recording, CHECKED).job.file
        print(f"{'rows':>10} {'seconds':>9} {'us a row':>9} {'peak MB':>8} {'file MB':>8}")
        for count in rows:
            job = grown(file, count)
            log = job.with_suffix("") / "long.parquet"
            found = calibrated(short, job)
            seconds = found["seconds"]
            print(
                f"{count:10d} {seconds:9.2f} {1e6 * seconds / count:9.2f}"
                f" {found['peak']:8.0f} {log.stat().st_size / 1e6:8.0f}",
                flush=True,
            )
            if count == rows[0]:
                one, other = (np.array(x["gains"])
                              for x in (found, calibrated(short, job, in_memory=True)))  # fmt: skip
                apart = np.abs(one - other).max(axis=(1, 2)) / np.abs(other).max(axis=(1, 2))
                print(f"           in memory and in pieces differ by {apart.max():.1e} of a gain")
            log.unlink()


if __name__ == "__main__":
    main()
