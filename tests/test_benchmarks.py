"""What `make bench` says of its figures: ratios, regressions, the table of the README."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

HOME = Path(__file__).resolve().parents[1]
BENCHMARKS = HOME / "benchmarks"
QUICK = ("fitting", "reading", "wrenches")
"""Run by a test through the same code on tiny sizes; the figures mean nothing."""


@pytest.fixture
def measure(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module("measure")


@pytest.fixture
def run(measure: Any) -> Any:
    return import_module("run")


def baseline() -> Any:
    return json.loads((BENCHMARKS / "baseline.json").read_text())


def test_a_ratio_is_the_median_of_those_of_the_rounds(measure: Any) -> None:
    # a neighbour that slows a whole round leaves its ratio: 10, 10 and, alone in theirs, 40
    record = measure.Record.of("a", "b", "c", ours=[1.0, 3.0, 1.0], theirs=[10.0, 30.0, 40.0])
    assert (record.low, record.ratio, record.high) == (10.0, 10.0, 40.0)
    assert record.seconds == 1.0


def test_a_slice_of_theirs_counts_as_often_as_ours_is_longer(measure: Any) -> None:
    assert measure.Record.of("a", "b", "c", ours=[2.0], theirs=[1.0], times=50).ratio == 25.0


def test_calls_take_turns_within_a_round(measure: Any) -> None:
    order: list[str] = []
    calls = {name: (lambda name=name: order.append(name)) for name in "ab"}
    times = measure.interleaved(calls, 3)
    assert order == list("ababab")
    assert [len(times[name]) for name in "ab"] == [3, 3]


def records(run: Any, ratio: float, size: str = "10 rows") -> list[Any]:
    return [run.Record("reading", "pyarrow", size, ratio, ratio, ratio, 1.0)]


def compared(run: Any, before: float, now: float, size: str = "10 rows") -> list[str]:
    known = {"records": [run.asdict(one) for one in records(run, before)]}
    fallen: list[str] = run.notes(records(run, now, size), known)[1]
    return fallen


def test_a_ratio_below_seven_tenths_of_the_baseline_is_a_regression(run: Any) -> None:
    assert compared(run, 100.0, 69.0) == ["reading, against pyarrow: 69 (baseline 100)"]
    assert compared(run, 100.0, 71.0) == []


def test_ratios_of_other_sizes_are_not_compared(run: Any) -> None:
    assert compared(run, 100.0, 1.0, size="5 rows") == []


@pytest.mark.parametrize("what", ["cpu", "cores", "python", "numpy", "llvmlite", "pyarrow"])
def test_another_processor_or_version_is_another_machine(measure: Any, what: str) -> None:
    here = measure.machine()
    assert measure.same_machine(here, {**here, "date": "yesterday", "load": 8.0})
    assert not measure.same_machine(here, {**here, what: "other"})


@pytest.mark.parametrize(
    ("ratio", "same", "code"), [(1.0, True, 1), (1.0, False, 0), (9.0, True, 0)]
)
def test_a_regression_fails_on_the_same_machine_alone(
    run: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, ratio: float, same: bool, code: int
) -> None:
    file = tmp_path / "baseline.json"
    known = {**run.machine(), **({} if same else {"cpu": "other"})}
    file.write_text(json.dumps({"machine": known, "records": [
        run.asdict(one) for one in records(run, 10.0)]}))  # fmt: skip
    monkeypatch.setattr(run, "BASELINE", file)
    monkeypatch.setattr(run, "run", lambda name, quick: records(run, ratio))
    assert run.main(["--only", "reading"]) == code


def test_a_benchmark_that_fails_is_named_and_the_others_are_run(
    run: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        run, "run", lambda name, quick: None if name == "bags" else records(run, 1.0)
    )
    assert run.main(["--only", "bags", "--only", "reading"]) == 1
    out = capsys.readouterr().out
    assert "failed: bags" in out
    assert "pyarrow" in out


def test_every_named_benchmark_is_a_file_that_says_its_sizes(run: Any) -> None:
    for name in run.NAMES:
        assert "BENCHMARK = Benchmark(" in (BENCHMARKS / f"{name}.py").read_text(), name


def test_tables_are_no_wider_than_a_hundred_columns(measure: Any) -> None:
    some = [measure.Record(**one) for one in baseline()["records"]]
    assert max(map(len, measure.table(some))) <= measure.WIDTH


def test_the_table_of_the_readme_is_that_of_the_baseline(run: Any) -> None:
    text = (HOME / "README.md").read_text()
    some = [run.Record(**one) for one in baseline()["records"]]
    assert run.into_readme(text, some) == text


@pytest.mark.parametrize("name", QUICK)
def test_a_smoke_run_measures_and_checks_the_numbers(name: str, tmp_path: Path) -> None:
    if name == "wrenches":
        for oracle in ("idyntree", "pinocchio"):
            pytest.importorskip(oracle)
    file = tmp_path / "records.json"
    command = [sys.executable, str(BENCHMARKS / "run.py"), "--quick", "--only", name]
    ended = subprocess.run(
        [*command, "--json", str(file)], check=False, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    measured = json.loads(file.read_text())
    assert measured["machine"]["cores"] > 0
    assert measured["records"]
    for one in measured["records"]:
        assert one["low"] <= one["ratio"] <= one["high"]
        assert one["ratio"] > 0
