"""The commands that make a calibration of logs, and judge it."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ftcal.cli.frame import (
    NOT_BETTER,
    TEXT,
    as_json,
    console,
    mendable,
    progress_bar,
    require_writable,
    scheduler_option,
    workers_option,
)
from ftcal.errors import JobError

if TYPE_CHECKING:
    from ftcal.config import Job


@click.command(short_help="Calibrate the sensors of a job file.")
@click.argument("job", type=TEXT)
@click.option("-o", "--output", type=TEXT, help="Folder of the results (default: ftcal-out).")
@click.option("--cache", type=TEXT, help="Folder of paired recordings (default: none are kept).")
@scheduler_option("what the job says, or here")
@workers_option
@as_json
@mendable
def calibrate(
    job: Path,
    output: Path | None,
    *,
    cache: Path | None,
    scheduler: str | None,
    workers: int | None,
    machine: bool,
) -> None:
    """Calibrate the sensors of JOB (TOML): calibration.json, metrics.json and report.html."""
    sys.exit(run_job(job, output, machine, cache=cache, scheduler=scheduler, workers=workers))


def run_job(
    job: Path,
    output: Path | None,
    machine: bool,
    *,
    cache: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    truth: dict[str, Any] | None = None,
) -> int:
    """Run a job, write its results, print them; return the exit code.

    Paired recordings are kept in `cache` and found again there.
    """
    from ftcal import terminal
    from ftcal.archive import Shelf
    from ftcal.compute import executor
    from ftcal.config import read_job
    from ftcal.paired_takes import KINDS
    from ftcal.pipeline import calibrate as run
    from ftcal.report import metrics, write_outcome

    described = read_job(job)
    folder = output or job.parent / (described.output or "ftcal-out")
    where = executor(scheduler or described.compute.scheduler, workers or described.compute.workers)
    require_writable(folder)
    if cache is not None:
        require_writable(cache, option="--cache")
    if described.fit.scope == "whole body":
        if cache is not None:
            raise JobError(f"{job}: a fit of all sensors at once keeps nothing; leave out --cache")
        return run_whole_body(described, folder, machine)
    # workers may have another working directory
    shelf = None if cache is None else Shelf(cache.absolute(), KINDS)
    with progress_bar() as progress:
        outcome = run(described, where=where, shelf=shelf, progress=progress)
        report = write_outcome(outcome, folder, truth)
    if machine:
        click.echo(json.dumps(metrics(outcome, truth), indent=1))
    else:
        out = console()
        terminal.print_findings(out, outcome.findings)
        for sensor in outcome.sensors:
            terminal.print_sensor(out, sensor)
            if truth is not None:
                terminal.print_truth(out, sensor, truth[sensor.sensor.name])
        out.print(f"report       {report}", soft_wrap=True)
        out.print(f"calibration  {report.with_name('calibration.json')}", soft_wrap=True)
    return 0 if outcome.improved else NOT_BETTER


def run_whole_body(described: Job, folder: Path, machine: bool) -> int:
    """Fit all sensors of a job at once, write the results, print them; return the exit code."""
    from ftcal.report import whole_metrics, write_whole
    from ftcal.whole_pipeline import calibrate_whole_body
    from ftcal.whole_tables import print_whole

    with progress_bar() as progress:
        outcome = calibrate_whole_body(described, progress=progress)
        report = write_whole(outcome, folder)
    if machine:
        click.echo(json.dumps(whole_metrics(outcome), indent=1))
    else:
        out = console()
        print_whole(out, outcome)
        out.print(f"report       {report}", soft_wrap=True)
        out.print(f"calibration  {report.with_name('calibration.json')}", soft_wrap=True)
    return 0 if outcome.improved else NOT_BETTER


@click.command(short_help="Compare data sets and penalties: the paper's two validations.")
@click.argument("job", type=TEXT)
@click.option("-o", "--output", type=TEXT, help="Folder of the results (default: ftcal-out).")
@click.option("--cache", type=TEXT, help="Folder of prepared recordings (default: OUTPUT/cache).")
@workers_option
@as_json
@mendable
def study(
    job: Path, output: Path | None, cache: Path | None, workers: int | None, machine: bool
) -> None:
    """Train on every recording of JOB, test on every other, and compare on the switching run.

    Writes study.json, study.html and calibration.json with the mixed matrices.
    """
    from ftcal.config import read_job
    from ftcal.report import study_metrics, write_study
    from ftcal.study import study as run
    from ftcal.study_tables import print_study

    described = read_job(job)
    folder = output or job.parent / (described.output or "ftcal-out")
    shelf = cache or folder / "cache"
    require_writable(folder)
    require_writable(shelf, option="--cache")
    with progress_bar() as progress:
        outcome = run(
            described,
            shelf=shelf,
            workers=workers or os.cpu_count() or 1,
            progress=progress,
        )
        report = write_study(outcome, folder)
    if machine:
        click.echo(json.dumps(study_metrics(outcome), indent=1))
    else:
        out = console()
        print_study(out, outcome)
        out.print(f"report       {report}", soft_wrap=True)
        if outcome.sub_chains:
            out.print(f"calibration  {report.with_name('calibration.json')}", soft_wrap=True)
    sys.exit(0 if outcome.improved else NOT_BETTER)


@click.command(short_help="Calibrate many robots; show whose sensors drifted.")
@click.argument("place")
@click.option("-o", "--output", type=TEXT, required=True, help="Folder of the results.")
@scheduler_option("local")
@workers_option
@click.option("--cache", type=TEXT, help="Folder of paired recordings (default: OUTPUT/cache).")
@click.option("--since", type=TEXT, help="Compare with the results of an earlier run there.")
@click.option("--report", is_flag=True, help="Write report.html of every robot, too.")
@as_json
@mendable
def fleet(
    place: str,
    output: Path,
    *,
    scheduler: str | None,
    workers: int | None,
    cache: Path | None,
    since: Path | None,
    report: bool,
    machine: bool,
) -> None:
    """Calibrate every robot below PLACE, a folder or a URL: each is a folder with a job.toml.

    What is finished is not done again, however the run before ended. Exits with 1 where a
    recording or a robot could not be done.
    """
    from ftcal.compute import LOCAL, executor
    from ftcal.fleet import run_fleet
    from ftcal.fleet_table import as_record, print_fleet

    require_writable(output)
    require_writable(cache or output / "cache", option="--cache")
    with progress_bar() as progress:
        outcome = run_fleet(
            place,
            output,
            where=executor(scheduler or LOCAL, workers),
            cache=cache,
            since=since,
            report=report,
            progress=progress,
        )
    if machine:
        click.echo(json.dumps(as_record(outcome), indent=1))
    else:
        print_fleet(console(), outcome)
    sys.exit(0 if outcome.whole else 1)


@click.command(short_help="Score a calibration on other recordings.")
@click.argument("calibration", type=TEXT)
@click.argument("job", type=TEXT)
@as_json
@mendable
def validate(calibration: Path, job: Path, machine: bool) -> None:
    """Score CALIBRATION on the recordings of JOB that it never saw.

    The test windows of JOB count; a recording without any counts whole.
    """
    from ftcal import terminal
    from ftcal.calibration import read_calibration
    from ftcal.config import read_job
    from ftcal.pipeline import score_calibration
    from ftcal.report.scorecard import finite, scores_metrics

    known = read_calibration(calibration)
    with progress_bar() as progress:
        scored = score_calibration(known, read_job(job), progress=progress)
    if machine:
        record = finite({name: scores_metrics(scores) for name, scores in scored.items()})
        click.echo(json.dumps(record, indent=1))
    else:
        out = console()
        for name, scores in scored.items():
            out.print(f"[bold]{name}[/]")
            out.print(terminal.score_table(scores))
    better = any(s.by_name[axis].interval[1] < 100 for s in scored.values() for axis in s.by_name)
    sys.exit(0 if better else NOT_BETTER)
