"""The commands that put a calibration to use."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ftcal.cli.frame import (
    TEXT,
    as_json,
    console,
    mendable,
)

if TYPE_CHECKING:
    pass


@click.command(short_help="Recalibrate a log.")
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
@click.option("--robot", type=TEXT,
              help="URDF or xacro; turns a LOG in the axes of another link.")  # fmt: skip
@mendable
def apply(
    calibration: Path,
    log: Path,
    output: Path,
    offset: str,
    like: Path | None,
    *,
    sd: bool,
    robot: Path | None,
) -> None:
    """Recalibrate LOG: write the corrected wrenches of every calibrated sensor that it carries."""
    from ftcal import applying, logs
    from ftcal.calibration import read_calibration
    from ftcal.config import read_job
    from ftcal.urdf import read_robot

    layout = logs.Layout() if like is None else read_job(like).recordings[0].layout()
    known = read_calibration(calibration)
    model = None if robot is None else read_robot(robot)
    used = applying.apply(known, logs.in_pieces(log, layout), output, offset, sd=sd, robot=model)
    for sensor, source in used.items():
        click.echo(f"{sensor}: offset of {source}")
        if (link := known.sensor(sensor).wrench_frame) is not None:
            frame = known.sensor(sensor).frame
            click.echo(f"{sensor}: turned from the axes of {link} into the sensor's, {frame}")
        if sd and (kept := applying.refused(known.sensor(sensor))):
            click.echo(f"{sensor}: no standard deviation of {', '.join(kept)}: Workbench kept")
    click.echo(f"wrote {output}")


@click.command(short_help="Write a calibration as the file a robot reads.")
@click.argument("calibration", type=TEXT)
@click.option(
    "--to",
    "kind",
    type=click.Choice(["yarp", "firmware", "ros", "ati", "c", "json", "npz"]),
    required=True,
    help="What reads it.",
)
# a path forgets the slash at its end, which says that it is a folder
@click.option("-o", "--output", required=True, help="File, or folder of the files (NAME/).")
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
    output: str,
    *,
    sensors: tuple[str, ...],
    offset: str,
    undo: bool,
) -> None:
    """Write CALIBRATION for a robot; every file is read back and compared before it is kept."""
    from ftcal.export import export as write

    written = write(
        calibration,
        kind,
        Path(output),
        sensors=sensors,
        offset=offset,
        undo=undo,
        into_folder=output.endswith(("/", os.sep)),
    )
    for name, remarks in written.remarks.items():
        for remark in remarks:
            click.echo(f"{name}: {remark}")
    for path in written.files:
        click.echo(f"wrote {path}")


@click.command(short_help="Show what changes between two calibration files.")
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
