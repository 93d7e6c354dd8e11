"""The commands of the pretend robot: its logs, and its calibration."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ftcal.cli.calibrating import run_job
from ftcal.cli.frame import (
    TEXT,
    as_json,
    mendable,
    progress_bar,
    require_writable,
)

if TYPE_CHECKING:
    pass


@click.command(short_help="Simulate a robot's recordings as a scenario file says.")
@click.argument("scenario", type=TEXT)
@click.option("-o", "--output", type=TEXT, required=True, help="Folder of the session.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of everything random.")
@as_json
@mendable
def simulate(scenario: Path, output: Path, seed: int | None, machine: bool) -> None:
    """Simulate SCENARIO (TOML): recordings, robot, matrices, truth.json and a job.toml."""
    from ftcal.scenario import read_scenario
    from ftcal.staging import as_lines, as_record, stage

    require_writable(output)
    with progress_bar() as progress:
        job, written = stage(read_scenario(scenario), output, seed=seed, progress=progress)
    if machine:
        click.echo(json.dumps(as_record(job, written), indent=1))
        return
    click.echo("\n".join(as_lines(written)))
    click.echo(f"wrote {job}")


@click.command(short_help="Simulate an iCub with a bent sensor and calibrate it.")
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

    require_writable(output)
    job = write_demo(output, seed=seed)
    sys.exit(run_job(job, output, machine, truth=read_truth(job.with_name(TRUTH))))
