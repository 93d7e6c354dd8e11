"""The commands. Results on stdout, progress on stderr; the work is in the rooms below.

Exit codes: 0 done, 1 something the user can mend, 2 usage, 3 done but no axis beats the Workbench.
"""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import click

from ftcal import __version__
from ftcal.errors import FtcalError

if TYPE_CHECKING:
    from rich.console import Console

    from ftcal.config import Job
    from ftcal.contact import ContactSchedule
    from ftcal.delay import Delay
    from ftcal.diagnosis import Diagnosis
    from ftcal.progress import Progress
    from ftcal.recording import Recording
    from ftcal.steps import Step
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
workers_option = click.option(
    "--workers", type=click.IntRange(1), help="Processes (default: one a core)."
)


def scheduler_option(default: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return the option that says where recordings are read and paired."""
    return click.option(
        "--scheduler",
        metavar="WHERE",
        help=f"here, local or a Dask scheduler's tcp://HOST:PORT (default: {default}).",
    )


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
@click.option(
    "--diagnose",
    is_flag=True,
    help="Look for a wrong sign, swapped axes, a wrong frame, a wrong robot, for delays and steps"
    " of offsets (needs --robot, and --contact or --feet).",
)
@click.option(
    "--contact",
    "contacts",
    multiple=True,
    metavar="LINK",
    help="For --diagnose, --init: link that touches throughout; once for each, the first still.",
)
@click.option(
    "--rival",
    "rivals",
    type=TEXT,
    multiple=True,
    help="For --diagnose: another URDF that may be the robot of the log; once for each.",
)
@click.option("--init", is_flag=True, help="Print a job file for LOG instead, to be edited.")
@as_json
@mendable
def inspect(
    log: Path,
    robot: Path | None,
    time: str,
    zero: str | None,
    feet: tuple[str, str] | None,
    plot: Path | None,
    *,
    diagnose: bool,
    contacts: tuple[str, ...],
    rivals: tuple[Path, ...],
    init: bool,
    machine: bool,
) -> None:
    """Show what is in LOG, what is wrong with it and what of it the robot knows."""
    if diagnose and (robot is None or not (contacts or feet)):
        raise click.UsageError("--diagnose needs --robot, and --contact or --feet")
    if rivals and not diagnose:
        raise click.UsageError("--rival needs --diagnose")
    if contacts and not (diagnose or init):
        raise click.UsageError("--contact needs --diagnose or --init")
    if init and (diagnose or machine):
        raise click.UsageError("--init prints a job file alone, without --diagnose or --json")
    if feet is not None and robot is None:
        raise click.UsageError("--feet needs --robot")
    if plot is not None and feet is None:
        raise click.UsageError("--plot needs --feet")
    from ftcal import logs, terminal
    from ftcal.health import examine
    from ftcal.urdf import read_robot

    recording = logs.read(log, logs.Layout(time=time, zero=zero))
    model = None if robot is None else read_robot(robot)
    findings = (*recording.findings, *examine(recording, robot=model))
    phases: tuple[Phase, ...] = ()
    if feet is not None and model is not None:
        from ftcal.plots.contact import contact_timeline
        from ftcal.report.single import write_plot
        from ftcal.timeline import propose_timeline

        timeline = propose_timeline(recording, model, feet, findings=findings)
        phases = timeline.phases
        if plot is not None:
            write_plot(plot, contact_timeline(timeline, recording.name))
    if init:
        from ftcal.job_draft import draft

        told = {key: value for key, value in (("time", time), ("zero", zero)) if value}
        if told.get("time") == "time":
            del told["time"]
        stood = touches(recording, contacts, phases)
        click.echo(draft(recording, log, model, robot, stood, told), nl=False)
        return
    verdict: Diagnosis | None = None
    late: tuple[Delay, ...] = ()
    stepped: dict[str, tuple[Step, ...]] = {}
    if diagnose and model is not None:
        from ftcal import delay, diagnosis, steps

        schedule = touches(recording, contacts, phases)
        assert schedule is not None
        verdict = diagnosis.diagnose(
            recording,
            model,
            schedule,
            rivals={str(path): read_robot(path) for path in rivals},
            findings=findings,
        )
        late = delay.delays(recording, model, schedule, findings=findings)
        stepped = steps.all_steps(recording, model, schedule, findings=findings)
    if machine:
        from ftcal.inspection import as_noticed, as_record

        record = as_record(recording, findings, model, phases, verdict)
        if verdict is not None:
            record |= as_noticed(late, stepped)
        click.echo(json.dumps(record, indent=1))
        return
    out = console()
    terminal.print_recording(out, recording, model)
    terminal.print_findings(out, [(recording.name, finding) for finding in findings])
    if phases:
        terminal.print_phases(out, phases)
    if verdict is not None:
        terminal.print_diagnosis(out, verdict)
        terminal.print_noticed(out, late, stepped)


def touches(
    recording: Recording, contacts: Sequence[str], phases: Sequence[Phase]
) -> ContactSchedule | None:
    """Return who touched the world as far as it was told or is seen; None where it is not."""
    from ftcal.diagnosis import throughout, touching

    if contacts:
        return throughout(recording, contacts)
    return touching(phases) if phases else None


@main.command(short_help="Calibrate the sensors of a job file.")
@click.argument("job", type=TEXT)
@click.option("-o", "--output", type=TEXT, help="Folder of the results (default: ftcal-out).")
@scheduler_option("what the job says, or here")
@workers_option
@as_json
@mendable
def calibrate(
    job: Path, output: Path | None, scheduler: str | None, workers: int | None, machine: bool
) -> None:
    """Calibrate the sensors of JOB (TOML): calibration.json, metrics.json and report.html."""
    sys.exit(run_job(job, output, machine, scheduler=scheduler, workers=workers))


def run_job(
    job: Path,
    output: Path | None,
    machine: bool,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    truth: dict[str, Any] | None = None,
) -> int:
    """Run a job, write its results, print them; return the exit code."""
    from ftcal import terminal
    from ftcal.compute import executor
    from ftcal.config import read_job
    from ftcal.pipeline import calibrate as run
    from ftcal.report import metrics, write_outcome

    described = read_job(job)
    folder = output or job.parent / (described.output or "ftcal-out")
    where = executor(scheduler or described.compute.scheduler, workers or described.compute.workers)
    if described.fit.scope == "whole body":
        return run_whole_body(described, folder, machine)
    with progress_bar() as progress:
        outcome = run(described, where=where, progress=progress)
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


@main.command(short_help="Compare data sets and penalties: the paper's two validations.")
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
    import os

    from ftcal.config import read_job
    from ftcal.report import study_metrics, write_study
    from ftcal.study import study as run
    from ftcal.study_tables import print_study

    described = read_job(job)
    folder = output or job.parent / (described.output or "ftcal-out")
    with progress_bar() as progress:
        outcome = run(
            described,
            shelf=cache or folder / "cache",
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


@main.command(short_help="Calibrate many robots; show whose sensors drifted.")
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
@click.option("-o", "--output", type=TEXT, required=True,
              help="Table (.csv, .parquet), folder, or .mcap.")  # fmt: skip
@click.option(
    "--offset",
    default="auto",
    show_default=True,
    help="Which recording's offset: its name, `zero`, or auto (LOG's own, else the last).",
)
@click.option("--like", type=TEXT, help="Job whose first recording says how LOG is to be read.")
@click.option("--sd", is_flag=True, help="Add the predicted standard deviation of every axis.")
@mendable
def apply(
    calibration: Path, log: Path, output: Path, offset: str, like: Path | None, *, sd: bool
) -> None:
    """Recalibrate LOG: write the corrected wrenches of every calibrated sensor that it carries."""
    from ftcal import applying, logs
    from ftcal.calibration import read_calibration
    from ftcal.config import read_job

    layout = logs.Layout() if like is None else read_job(like).recordings[0].layout()
    known = read_calibration(calibration)
    used = applying.apply(known, logs.in_pieces(log, layout), output, offset, sd=sd)
    for sensor, source in used.items():
        click.echo(f"{sensor}: offset of {source}")
        if sd and (kept := applying.refused(known.sensor(sensor))):
            click.echo(f"{sensor}: no standard deviation of {', '.join(kept)}: Workbench kept")
    click.echo(f"wrote {output}")


@main.command(short_help="Write a calibration as the file a robot reads.")
@click.argument("calibration", type=TEXT)
@click.option(
    "--to",
    "kind",
    type=click.Choice(["yarp", "firmware", "ros", "ati", "c", "json", "npz"]),
    required=True,
    help="What reads it.",
)
@click.option("-o", "--output", type=TEXT, required=True, help="File, or folder of the files.")
@click.option("--sensor", "sensors", multiple=True, metavar="NAME", help="Default: all sensors.")
@click.option(
    "--offset",
    default="auto",
    show_default=True,
    help="Which recording's offset: its name, `zero`, or auto (the last).",
)
@click.option("--undo", is_flag=True, help="Write the Workbench instead: back to before.")
@mendable
def export(
    calibration: Path,
    kind: str,
    output: Path,
    *,
    sensors: tuple[str, ...],
    offset: str,
    undo: bool,
) -> None:
    """Write CALIBRATION for a robot; every file is read back and compared before it is kept."""
    from ftcal.export import export as write

    written = write(calibration, kind, output, sensors=sensors, offset=offset, undo=undo)
    for name, remarks in written.remarks.items():
        for remark in remarks:
            click.echo(f"{name}: {remark}")
    for path in written.files:
        click.echo(f"wrote {path}")


@main.command(short_help="Show what changes between two calibration files.")
@click.argument("a", type=TEXT)
@click.argument("b", type=TEXT)
@click.option("--log", type=TEXT, help="Show the change at the loads of this log, too.")
@click.option("--like", type=TEXT, help="Job whose first recording says how LOG is to be read.")
@as_json
@mendable
def diff(a: Path, b: Path, log: Path | None, like: Path | None, machine: bool) -> None:
    """Show what changes on the robot in N and Nm when B takes the place of A.

    A and B are calibration.json, or files of `ftcal export`.
    """
    from ftcal import logs
    from ftcal.comparison import as_record, compare, print_changes, unpaired
    from ftcal.config import read_job
    from ftcal.export import read

    layout = logs.Layout() if like is None else read_job(like).recordings[0].layout()
    old, new = read(a), read(b)
    changes = compare(old, new, None if log is None else logs.read(log, layout))
    if machine:
        click.echo(json.dumps(as_record(changes, unpaired(old, new)), indent=1))
    else:
        print_changes(console(), changes, unpaired(old, new))


@main.command(short_help="Weigh an unknown tool on a wrist sensor.")
@click.argument("tables", type=TEXT, nargs=-1, required=True)
@click.option("--wrench", nargs=6, metavar="FX FY FZ TX TY TZ", help="Columns in N and Nm.")
@click.option("--rotation", nargs=9, metavar="R11 … R33", help="Columns, sensor to base, by rows.")
@click.option("--gravity", nargs=3, metavar="GX GY GZ", help="Columns, in the sensor's frame.")
@click.option("--acceleration", nargs=3, metavar="AX AY AZ", help="Columns of an accelerometer.")
@click.option("--unit", type=click.Choice(["m/s^2", "g"]), help="Of gravity or acceleration.")
@click.option("--time", default="time", show_default=True, help="Column of the stamps.")
@click.option("--steady", type=click.FloatRange(0.0), metavar="DEG/S",
              help="Leave rows out in which gravity turns faster.")  # fmt: skip
@as_json
@mendable
def payload(
    tables: tuple[Path, ...],
    *,
    wrench: tuple[str, ...] | None,
    rotation: tuple[str, ...] | None,
    gravity: tuple[str, ...] | None,
    acceleration: tuple[str, ...] | None,
    unit: Any,
    time: str,
    steady: float | None,
    machine: bool,
) -> None:
    """Weigh the tool of TABLES: mass, centre of mass, and the offset of the sensor.

    One table of still attitudes, or two that are joined on time: wrench and attitude. Columns not
    named are found by habit: fx … tz, and gx gy gz, r11 … r33 or ax ay az.
    """
    import math

    from ftcal.payload import estimate
    from ftcal.payload_table import payload_metrics, print_payload
    from ftcal.pose_tables import PoseLayout, read_poses
    from ftcal.poses import Attitude

    asked: dict[Attitude, tuple[str, ...] | None] = {
        "rotation": rotation, "gravity": gravity, "acceleration": acceleration,
    }  # fmt: skip
    told = [(attitude, columns) for attitude, columns in asked.items() if columns]
    if len(told) > 1:
        raise click.UsageError("give one of --rotation, --gravity and --acceleration")
    attitude, columns = told[0] if told else (None, ())
    layout = PoseLayout(
        wrench=wrench or (), attitude=attitude, columns=columns or (), unit=unit, time=time,
        steady=None if steady is None else math.radians(steady),
    )  # fmt: skip
    poses = read_poses(tables, layout)
    found = estimate(poses)
    if machine:
        click.echo(json.dumps(payload_metrics(poses, found), indent=1))
    else:
        print_payload(console(), poses, found)
    sys.exit(NOT_BETTER if found.refused else 0)


@main.command(short_help="Simulate a robot's recordings as a scenario file says.")
@click.argument("scenario", type=TEXT)
@click.option("-o", "--output", type=TEXT, required=True, help="Folder of the session.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of everything random.")
@as_json
@mendable
def simulate(scenario: Path, output: Path, seed: int | None, machine: bool) -> None:
    """Simulate SCENARIO (TOML): recordings, robot, matrices, truth.json and a job.toml."""
    from ftcal.scenario import read_scenario
    from ftcal.staging import as_lines, as_record, stage

    with progress_bar() as progress:
        job, written = stage(read_scenario(scenario), output, seed=seed, progress=progress)
    if machine:
        click.echo(json.dumps(as_record(job, written), indent=1))
        return
    click.echo("\n".join(as_lines(written)))
    click.echo(f"wrote {job}")


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
    from ftcal.synthetic import TRUTH, read_truth

    job = write_demo(output, seed=seed)
    sys.exit(run_job(job, output, machine, truth=read_truth(job.with_name(TRUTH))))


if __name__ == "__main__":
    main()
