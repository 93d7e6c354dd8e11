"""A fleet as a table, worst first: whose sensors drifted, by how much, and what could not be done.

Everything that comes from a file is printed as text, never as markup.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.text import Text

from ftcal.fleet import Fleet, RobotState, SensorState
from ftcal.terminal import STYLES, table

WORST_FIRST = ("drifted", "exchanged", "steady", "new")


def rows(fleet: Fleet) -> list[tuple[RobotState, SensorState]]:
    """Return every calibrated sensor, worst first: by what became of it, then by how surely."""
    every = [(robot, sensor) for robot in fleet.robots for sensor in robot.sensors]

    def badness(row: tuple[RobotState, SensorState]) -> tuple[int, float, str, str]:
        robot, sensor = row
        sd = sensor.drift.sd if sensor.drift else 0.0
        return WORST_FIRST.index(sensor.changed), -sd, robot.name, sensor.sensor

    return sorted(every, key=badness)


def as_record(fleet: Fleet) -> dict[str, Any]:
    """Return a fleet as plain JSON; `sensors` are worst first."""
    return {
        "format": "ftcal-fleet",
        "version": 1,
        "sensors": [
            {
                "robot": robot.name,
                "sensor": sensor.sensor,
                "verdict": sensor.verdict,
                "changed": sensor.changed,
                "drift": None if sensor.drift is None else asdict(sensor.drift),
            }
            for robot, sensor in rows(fleet)
        ],
        "robots": {
            robot.name: {
                "calibrated": not robot.reason,
                "reason": robot.reason,
                "used": list(robot.used),
                "failed": robot.failed,
            }
            for robot in fleet.robots
        },
        "missing": fleet.missing,
        "paired": fleet.paired,
        "fitted": fleet.fitted,
    }


def print_fleet(console: Console, fleet: Fleet) -> None:
    """Print the table, what could not be done by name, and how much was done in this run."""
    if every := rows(fleet):
        made = table("robot", "sensor", "verdict", "since last", "Δ force", "Δ torque",
                     "of scale", "in sd", "used", right=range(4, 9))  # fmt: skip
        for robot, sensor in every:
            made.add_row(
                Text(robot.name, overflow="fold"),
                Text(sensor.sensor, overflow="fold"),
                Text(sensor.verdict, STYLES[sensor.verdict]),
                Text(sensor.changed, "bold red" if sensor.changed == "drifted" else ""),
                *change_cells(sensor),
                f"{len(robot.used)}/{len(robot.used) + len(robot.failed)}",
            )
        console.print(made)
    lines = [f"not calibrated: {one.name}: {one.reason}" for one in fleet.robots if one.reason]
    lines += [
        f"left out: {robot.name}, {label}: {reason}"
        for robot in fleet.robots
        for label, reason in robot.failed.items()
    ]
    lines += [f"not fetched: {name}: {reason}" for name, reason in fleet.missing.items()]
    recordings = sum(len(robot.used) for robot in fleet.robots)
    lines.append(
        f"{len(fleet.robots)} robots, {recordings} recordings; new in this run: {fleet.fitted}"
        f" robots fitted, {fleet.paired} recordings paired"
    )
    console.print(Text("\n".join(lines)), soft_wrap=True)


def change_cells(sensor: SensorState) -> list[str]:
    """Return the cells that say how much a sensor changed."""
    found = sensor.drift
    if found is None:
        return ["-"] * 4
    return [
        f"{three_digits(found.force)} N",
        f"{three_digits(found.torque)} Nm",
        f"{100 * found.share:.2g} %",
        f"{found.sd:.1f}",
    ]


def three_digits(value: float) -> str:
    """Return a figure with three digits, or as many as stand before its point."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"
