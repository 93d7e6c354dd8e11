"""`ftcal payload`: a tool on a wrist sensor."""

from __future__ import annotations

import json
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
)

if TYPE_CHECKING:
    pass


@click.command(short_help="Weigh an unknown tool on a wrist sensor.")
@click.argument("tables", type=TEXT, nargs=-1, required=True)
@click.option("--wrench", nargs=6, metavar="FX FY FZ TX TY TZ", help="Columns in N and Nm.")
@click.option("--rotation", nargs=9, metavar="R11 … R33", help="Columns, sensor to base, by rows.")
@click.option("--gravity", nargs=3, metavar="GX GY GZ", help="Columns, in the sensor's frame.")
@click.option("--acceleration", nargs=3, metavar="AX AY AZ", help="Columns of an accelerometer.")
@click.option("--tf", nargs=2, metavar="BASE SENSOR", help="Frames of a ROS bag; z of BASE is up.")
@click.option("--pose", metavar="TOPIC", help="Of a ROS bag: PoseStamped, in place of --tf.")
@click.option("--topic", metavar="TOPIC", help="Of a ROS bag: the wrench, where it has several.")
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
    tf: tuple[str, str] | None,
    pose: str | None,
    topic: str | None,
    unit: Any,
    time: str,
    steady: float | None,
    machine: bool,
) -> None:
    """Weigh the tool of TABLES: mass, centre of mass, and the offset of the sensor.

    One table of still attitudes, or two that are joined on time: wrench and attitude. Columns not
    named are found by habit: fx … tz, and gx gy gz, r11 … r33 or ax ay az. Or one ROS bag, with a
    WrenchStamped topic and the attitude from --tf or --pose.
    """
    import math

    from ftcal.logs import ros_files
    from ftcal.payload import estimate
    from ftcal.payload_table import payload_metrics, print_payload
    from ftcal.pose_bags import BagLayout, read_bag
    from ftcal.pose_tables import PoseLayout, read_poses
    from ftcal.poses import Attitude

    slow = None if steady is None else math.radians(steady)
    asked: dict[Attitude, tuple[str, ...] | None] = {
        "rotation": rotation, "gravity": gravity, "acceleration": acceleration,
    }  # fmt: skip
    told = [(attitude, columns) for attitude, columns in asked.items() if columns]
    bagged = any(map(ros_files.holds, tables))
    if bagged and (told or wrench or unit or len(tables) > 1 or (tf and pose)):
        raise click.UsageError("of a ROS bag give one file, --tf or --pose, and no columns")
    if not bagged and (tf or pose or topic):
        raise click.UsageError("--tf, --pose and --topic are for ROS bags")
    if len(told) > 1:
        raise click.UsageError("give one of --rotation, --gravity and --acceleration")
    if bagged:
        poses = read_bag(tables[0], BagLayout(topic=topic, frames=tf, pose=pose, steady=slow))
    else:
        attitude, columns = told[0] if told else (None, ())
        poses = read_poses(
            tables,
            PoseLayout(
                wrench=wrench or (), attitude=attitude, columns=columns or (), unit=unit, time=time,
                steady=slow,
            ),
        )  # fmt: skip
    found = estimate(poses)
    if machine:
        click.echo(json.dumps(payload_metrics(poses, found), indent=1))
    else:
        print_payload(console(), poses, found)
    sys.exit(NOT_BETTER if found.refused else 0)
