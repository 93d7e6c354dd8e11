"""`ftcal inspect`: what a log holds, before anything is made of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ftcal.cli.frame import (
    TEXT,
    as_json,
    console,
    mendable,
    require_writable,
)

if TYPE_CHECKING:
    pass


@click.command(short_help="Show what is in a log and what is wrong with it.")
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
    from ftcal import inspection, terminal
    from ftcal.logs import Layout

    if plot is not None:
        require_writable(plot.parent, option="--plot")
    layout = Layout(time=time, zero=zero)
    seen = inspection.inspected(
        log, layout, robot=robot, feet=feet, contacts=contacts, whole=init or diagnose
    )
    if plot is not None and seen.timeline is not None:
        from ftcal.plots.contact import contact_timeline
        from ftcal.report.single import write_plot

        write_plot(plot, contact_timeline(seen.timeline, seen.recording.name))
    if init:
        from ftcal.job_draft import draft

        told = {} if time == Layout().time else {"time": time}
        told |= {} if zero is None else {"zero": zero}
        text = draft(seen.recording, log, seen.robot, robot, seen.contacts, told)
        click.echo(text, nl=False)
        return
    if diagnose:
        seen = inspection.diagnosed(seen, rivals)
    if machine:
        click.echo(json.dumps(inspection.as_record(seen), indent=1))
    else:
        terminal.print_inspection(console(), seen)
