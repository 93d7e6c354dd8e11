"""What a person and a machine read of a tool that was weighed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.padding import Padding
from rich.text import Text

from ftcal.conventions import FREE
from ftcal.payload import Payload
from ftcal.poses import Poses
from ftcal.report.words import figures as shown
from ftcal.sensor import AXES, UNITS
from ftcal.terminal import table

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SIDES = {
    1: "the sensor reads what the tool does to it",
    -1: "the sensor reads the reaction to the tool (or gravity was logged pointing up)",
}
"""What the sign of the wrench means."""

RIVALS = 3
"""Other readings that are printed: plain ones, and what fits better than the one told."""


def print_payload(console: Console, poses: Poses, payload: Payload) -> None:
    """Print what was read, the figures with their standard errors, and whether to use them."""
    word, style = ("REFUSE", "bold red") if payload.refused else ("ACCEPT", "bold green")
    console.print(Text.assemble((poses.source, "bold"), "  ", (word, style)), soft_wrap=True)
    console.print(Text(f"{poses.read_as}; {SIDES[payload.sign]}"), soft_wrap=True)
    made = table("", "value", "standard error", "residual", right=range(1, 4))
    made.add_row("mass", *_cells(payload.mass, payload.mass_error, "kg"), "")
    for k, axis in enumerate("xyz"):
        figures = _cells(payload.centre[k], payload.centre_error[k], "m")
        made.add_row(f"centre of mass {axis}", *figures, "")
    for k, axis in enumerate(AXES):
        figures = _cells(payload.offset[k], payload.offset_error[k], UNITS[k])
        made.add_row(f"offset {axis}", *figures, f"{shown(payload.noise.sd[k])} {UNITS[k]}")
    console.print(made)
    fitted, held_out = payload.rms(payload.residual), payload.rms(payload.held_out)
    console.print(
        f"{payload.poses} attitudes in {len(payload.residual)} rows; RMS {fitted[0]:.3g} N and"
        f" {fitted[1]:.3g} Nm, {held_out[0]:.3g} N and {held_out[1]:.3g} Nm on the attitude left"
        f" out; condition {payload.condition:.2g}"
    )
    for reason in payload.refused:
        console.print(Padding(Text(f"REFUSE: {reason}"), (0, 0, 0, 2)))
    for outlier in payload.outliers:
        unit = UNITS[AXES.index(outlier.axis)]
        console.print(Padding(Text(
            f"look at {_span(outlier.rows)}: {outlier.axis} is {outlier.residual:+.3g} {unit} off"
            " what the other attitudes say"
        ), (0, 0, 0, 2)))  # fmt: skip
    for note in payload.notes:
        console.print(Padding(Text(note), (0, 0, 0, 2)))
    told, *others = payload.readings
    made = table("read as", "force left", "torque left", right=(1, 2))
    plain = [r for r in others if r.rank < FREE or r.misfit < told.misfit]
    for reading in (told, *plain[:RIVALS]):
        made.add_row(
            Text(reading.words), f"{shown(reading.force)} N", f"{shown(reading.torque)} Nm"
        )
    console.print(made)


def payload_metrics(poses: Poses, payload: Payload) -> dict[str, Any]:
    """Return the figures for JSON; what is not determined is null."""
    fitted, held_out = payload.rms(payload.residual), payload.rms(payload.held_out)
    return {
        "source": poses.source,
        "read_as": poses.read_as,
        "verdict": "REFUSE" if payload.refused else "ACCEPT",
        "refused": list(payload.refused),
        "mass": payload.mass,
        "mass_error": payload.mass_error,
        "centre_of_mass": _known(payload.centre),
        "centre_of_mass_error": _known(payload.centre_error),
        "offset": _known(payload.offset),
        "offset_error": _known(payload.offset_error),
        "sign": payload.sign,
        "attitudes": payload.poses,
        "rows": len(payload.residual),
        "rms": {"force": fitted[0], "torque": fitted[1]},
        "rms_left_out": {"force": held_out[0], "torque": held_out[1]},
        "noise": payload.noise.sd.tolist(),
        "inefficiency": payload.noise.inefficiency.tolist(),
        "turn": payload.turn.tolist(),
        "condition": payload.condition if math.isfinite(payload.condition) else None,
        "outliers": [
            {"rows": list(o.rows), "axis": o.axis, "residual": o.residual} for o in payload.outliers
        ],
        "notes": list(payload.notes),
        "readings": [
            {"read_as": r.words, "force": r.force, "torque": r.torque} for r in payload.readings
        ],
    }


def _cells(value: float, error: float, unit: str) -> tuple[str, str]:
    """Return a figure and its standard error, to two digits of the error."""
    if not math.isfinite(value):
        return "not determined", "-"
    places = max(0, min(9, 1 - math.floor(math.log10(error)))) if error > 0 else 9
    return f"{value:.{places}f} {unit}", f"{error:.{places}f} {unit}"


def _known(values: Float[Array, "K"]) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]


def _span(rows: tuple[int, int]) -> str:
    first, last = rows
    return f"row {first}" if first == last else f"rows {first} to {last}"
