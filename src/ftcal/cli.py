"""The commands. Results on stdout, progress on stderr; the work is in the rooms below.

Exit codes: 0 done, 1 something the user can mend, 2 usage, 3 done but no axis beats the Workbench.
"""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import click

from ftcal import __version__
from ftcal.errors import FtcalError

if TYPE_CHECKING:
    from rich.console import Console

    from ftcal.progress import Progress
    from ftcal.timeline import Phase

P = ParamSpec("P")
R = TypeVar("R")

NOT_BETTER = 3
"""Exit code of a run that found no axis better than its Workbench."""

WIDTH = 100
"""Columns of a table where the terminal does not say."""

PATIENCE = 2.0
"""Seconds after which a run shows how far it is."""

TEXT = click.Path(path_type=Path)
as_json = click.option("--json", "machine", is_flag=True, help="Print JSON instead of tables.")


def mendable(command: Callable[P, R]) -> Callable[P, R]:
    """Turn an `FtcalError` into one line on stderr and exit code 1."""

    @functools.wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except FtcalError as error:
            click.echo(f"ftcal: {' '.join(str(error).split())}", err=True)
            sys.exit(1)

    return wrapped


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Yield a progress callback that draws a bar on a terminal's stderr once a run takes long."""
    import threading
    import time

    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    rate = TextColumn("{task.fields[rate]}")
    columns = (BarColumn(), MofNCompleteColumn(), rate)
    doing = TextColumn("{task.description}")
    bar = Bar(*columns, TimeRemainingColumn(), doing, console=Console(stderr=True), transient=True)
    task = bar.add_task("starting", total=None, rate="")

    begun = time.monotonic()

    def tell(doing: str, done: int, total: int) -> None:
        rate = done / max(time.monotonic() - begun, 1e-9)
        shown = f"{rate:.2g} steps/s" if done else ""
        bar.update(task, description=escape(doing), completed=done, total=total, rate=shown)

    timer = threading.Timer(PATIENCE, bar.start)
    timer.daemon = True
    if sys.stderr.isatty():
        timer.start()
    try:
        yield tell
    finally:
        timer.cancel()
        if bar.live.is_started:
            bar.stop()


def console() -> Console:
    """Return the console of the results: the terminal's width, or 100 columns into a file."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDTH})
@click.version_option(__version__, prog_name="ftcal")
def main() -> None:
    """Calibrate the six-axis force/torque sensors inside a robot, where they sit.

    The robot moves, its model says what each sensor should have felt, a regression towards the
    manufacturer's Workbench matrix finds the sensor that would have said so, and recordings it
    never saw judge it.
    """


@main.command(short_help="Show what is in a log and what is wrong with it.")
@click.argument("log", type=TEXT)
@click.option("--robot", type=TEXT, help="URDF or xacro: show which joints and sensors match.")
@click.option("--time", default="time", show_default=True, help="Tables: column of the stamps.")
@click.option("--zero", help="Signal whose first sample is second 0 (default: the earliest).")
@click.option(
    "--feet",
    nargs=2,
    metavar="LINK LINK",
    help="Two soles: propose who stood when, as the job's contacts (needs --robot).",
)
@click.option("--plot", type=TEXT, help="HTML file: what the proposal of --feet rests on.")
@as_json
@mendable
def inspect(
    log: Path,
    robot: Path | None,
    time: str,
    zero: str | None,
    feet: tuple[str, str] | None,
    plot: Path | None,
    machine: bool,
) -> None:
    """Show what is in LOG, what is wrong with it and what of it the robot knows."""
    if feet is not None and robot is None:
        raise click.UsageError("--feet needs --robot")
    if plot is not None and feet is None:
        raise click.UsageError("--plot needs --feet")
    from ftcal import logs, terminal
    from ftcal.health import examine
    from ftcal.urdf import read_robot

    recording = logs.read(log, logs.Layout(time=time, zero=zero))
    findings = (*recording.findings, *examine(recording))
    model = None if robot is None else read_robot(robot)
    phases: tuple[Phase, ...] = ()
    if feet is not None and model is not None:
        from ftcal.plots.contact import contact_timeline
        from ftcal.report.single import write_plot
        from ftcal.timeline import propose_timeline

        timeline = propose_timeline(recording, model, feet, findings=findings)
        phases = timeline.phases
        if plot is not None:
            write_plot(plot, contact_timeline(timeline, recording.name))
    if machine:
        from ftcal.inspection import as_record

        click.echo(json.dumps(as_record(recording, findings, model, phases), indent=1))
        return
    out = console()
    terminal.print_recording(out, recording, model)
    terminal.print_findings(out, [(recording.name, finding) for finding in findings])
    if phases:
        terminal.print_phases(out, phases)


@main.command(short_help="Calibrate the sensors of a job file.")
@click.argument("job", type=TEXT)
@click.option("-o", "--output", type=TEXT, help="Folder of the results (default: ftcal-out).")
@as_json
@mendable
def calibrate(job: Path, output: Path | None, machine: bool) -> None:
    """Calibrate the sensors of JOB (TOML): calibration.json, metrics.json and report.html."""
    sys.exit(run_job(job, output, machine, truth=None))


def run_job(job: Path, output: Path | None, machine: bool, *, truth: dict[str, Any] | None) -> int:
    """Run a job, write its results, print them; return the exit code."""
    from ftcal import terminal
    from ftcal.config import read_job
    from ftcal.pipeline import calibrate as run
    from ftcal.report import metrics, write_outcome

    described = read_job(job)
    folder = output or job.parent / (described.output or "ftcal-out")
    with progress_bar() as progress:
        outcome = run(described, progress=progress)
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


@main.command(short_help="Score a calibration on other recordings.")
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


@main.command(short_help="Recalibrate a log.")
@click.argument("calibration", type=TEXT)
@click.argument("log", type=TEXT)
@click.option("-o", "--output", type=TEXT, required=True, help="Table (.csv, .parquet) or folder.")
@click.option(
    "--offset",
    default="auto",
    show_default=True,
    help="Which recording's offset: its name, `zero`, or auto (LOG's own, else the last).",
)
@click.option("--like", type=TEXT, help="Job whose first recording says how LOG is to be read.")
@mendable
def apply(calibration: Path, log: Path, output: Path, offset: str, like: Path | None) -> None:
    """Recalibrate LOG: write the corrected wrenches of every calibrated sensor that it carries."""
    from ftcal import logs
    from ftcal.applying import corrected, write_table
    from ftcal.calibration import read_calibration
    from ftcal.config import read_job

    layout = logs.Layout() if like is None else read_job(like).recordings[0].layout()
    recording, used = corrected(read_calibration(calibration), logs.read(log, layout), offset)
    write_table(recording, output)
    for sensor, source in used.items():
        click.echo(f"{sensor}: offset of {source}")
    click.echo(f"wrote {output}")


@main.command(short_help="Simulate an iCub with a bent sensor and calibrate it.")
@click.option(
    "-o",
    "--output",
    type=TEXT,
    default=Path("ftcal-out/demo"),
    show_default=True,
    help="Folder of logs and results.",
)
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of everything random.")
@as_json
@mendable
def demo(output: Path, seed: int, machine: bool) -> None:
    """Simulate an iCub whose right leg's sensor is bent, and calibrate it from its logs."""
    from ftcal.demonstration import write_demo
    from ftcal.synthetic import read_truth

    job = write_demo(output, seed=seed)
    sys.exit(run_job(job, output, machine, truth=read_truth(job)))


if __name__ == "__main__":
    main()
