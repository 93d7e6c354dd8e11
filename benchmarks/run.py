"""Every benchmark, one after the other, beside the baseline of this folder.

    python benchmarks/run.py [--quick] [--only NAME] [--json FILE] [--markdown] [--update]

Each runs in a process of its own on one core. A ratio below 0.7 of the baseline's is a regression.
Ratios compare only on the same machine: the same processor, count of cores, Python and versions of
numpy, llvmlite and pyarrow. There a regression makes the exit code 1; on another machine it is told
and the exit code is 0. Sizes that differ, as with `--quick`, are not compared. A benchmark that
fails is named, the others are run, and the exit code is 1.

`--update` makes this run the baseline, and writes its table into README.md.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from measure import Key, Record, machine, markdown, same_machine, table

HERE = Path(__file__).resolve().parent
BASELINE = HERE / "baseline.json"
README = HERE.parent / "README.md"
MARKS = ("<!-- benchmarks: written by benchmarks/run.py --update -->", "<!-- end of benchmarks -->")
NAMES = (
    "reading", "bags", "filtering", "wrenches", "external", "balances", "fitting", "study",
    "applying", "end_to_end",
)  # fmt: skip
"""Files of this folder that measure a ratio, in the order of the pipeline."""
REGRESSION = 0.7
"""Share of the baseline's ratio below which one is a regression: neighbours move it by less."""


def run(name: str, *, quick: bool) -> list[Record] | None:
    """Return what a benchmark measured in a process of its own; None where it failed."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "records.json"
        command = [sys.executable, str(HERE / f"{name}.py"), "--json", str(file)]
        ended = subprocess.run([*command, *(["--quick"] if quick else [])], check=False)
        if ended.returncode:
            return None
        return [Record(**one) for one in json.loads(file.read_text())]


def notes(records: Sequence[Record], baseline: dict[str, Any]) -> tuple[dict[Key, str], list[str]]:
    """Return what the baseline says of each record, and the names of the regressions."""
    known = {one.key: one for one in (Record(**some) for some in baseline["records"])}
    said: dict[Key, str] = {}
    fallen = []
    for one in records:
        before = known.get(one.key)
        if before is None:
            said[one.key] = "new"
        elif one.ratio < REGRESSION * before.ratio:
            said[one.key] = f"was {before.ratio:.3g}"
            fallen.append(f"{one.name}, against {one.against}: {one.ratio:.3g}"
                          f" (baseline {before.ratio:.3g})")  # fmt: skip
    return said, fallen


def into_readme(text: str, records: Sequence[Record]) -> str:
    """Return the README with the table of these records between its marks."""
    before, rest = text.split(MARKS[0])
    after = rest.split(MARKS[1])[1]
    return "\n".join([f"{before}{MARKS[0]}", *markdown(records), f"{MARKS[1]}{after}"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for, print the table and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a smoke run on tiny sizes")
    parser.add_argument("--only", action="append", choices=NAMES, help="may be given again")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write records and machine")
    parser.add_argument("--markdown", action="store_true", help="print the table as in README.md")
    parser.add_argument("--update", action="store_true", help="make this run the baseline")
    told = parser.parse_args(arguments)
    if told.update and (told.quick or told.only):
        parser.error("--update is of a whole run")
    here = machine()
    records, failed = [], []
    for name in told.only or NAMES:
        print(f"== {name}", flush=True)
        found = run(name, quick=told.quick)
        if found is None:
            failed.append(name)
        else:
            records += found
    measured = {"machine": here, "records": [asdict(record) for record in records]}
    text = json.dumps(measured, indent=1) + "\n"
    if told.json:
        told.json.write_text(text)
    baseline = json.loads(BASELINE.read_text())
    said, fallen = notes(records, baseline)
    same = same_machine(here, baseline["machine"])
    print("", *(markdown(records) if told.markdown else table(records, said)), sep="\n")
    print(f"{here['cpu']}, {here['cores']} cores, load {here['load']:.1f} at the start")
    where = "" if same else " (another machine than the baseline's: told, not counted)"
    for line in [f"regression{where}: {one}" for one in fallen] + [f"failed: {n}" for n in failed]:
        print(line)
    if told.update and not failed:
        BASELINE.write_text(text)
        README.write_text(into_readme(README.read_text(), records))
    return int(bool(failed) or (same and bool(fallen) and not told.update))


if __name__ == "__main__":
    sys.exit(main())
