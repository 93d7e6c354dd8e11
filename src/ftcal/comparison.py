"""What changes on a robot when one calibration file takes the place of another.

Between two laws `w = M x + o + k (T - T_ref)` on the same x (`B - A` throughout):

* at full scale: the largest `|dM x|` over a box of x, axis by axis `sum_j |dM_ij| box_j`;
* at the loads of a log: `dM (x - mean x)`, RMS and largest; its mean goes with the offset;
* the offset `do`, and in a log the shift `dM mean(x) + do`, which taring the robot removes.

Laws on different x (channels, the board's wrench) are brought to one by the Workbench that either
file knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.text import Text

from ftcal.errors import DataError, SensorError
from ftcal.export.installed import Installed, Reads
from ftcal.firmware import COUNTS
from ftcal.recording import Recording
from ftcal.report.words import figures
from ftcal.sensor import AXES, UNITS, Workbench
from ftcal.terminal import table

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ROUNDING = 1e-9
"""N or Nm below which a change is that of the last digits of a double."""


@dataclass(frozen=True, slots=True)
class LogChange:
    """What changes at the loads of a log, per axis [N, Nm]."""

    samples: int
    rms: Float[Array, "6"]
    """Of the change about its mean."""
    largest: Float[Array, "6"]
    """The same, largest absolute value."""
    shift: Float[Array, "6"]
    """Mean of the change, offsets included."""


@dataclass(frozen=True, slots=True)
class Change:
    """What changes on one sensor, B - A."""

    sensor: str
    box: str
    """What full scale means here; empty where neither file says it."""
    full_scale: Float[Array, "6"] | None
    """Largest change of the gain over that box [N, Nm]."""
    offset: Float[Array, "6"]
    """[N, Nm]"""
    per_kelvin: Float[Array, "6"]
    """[N/K, Nm/K]"""
    at_log: LogChange | None


def compare(
    a: Sequence[Installed], b: Sequence[Installed], recording: Recording | None = None
) -> tuple[Change, ...]:
    """Return the changes of every sensor in both files; `SensorError` where there is none."""
    return tuple(change(old, new, recording) for old, new in pairs(a, b))


def pairs(a: Sequence[Installed], b: Sequence[Installed]) -> list[tuple[Installed, Installed]]:
    """Return the sensors of both files: by name, else by serial number; one and one are a pair."""
    by_name = {law.sensor: law for law in b}
    names = {law.sensor for law in a}
    found = []
    for old in a:
        alike = [law for law in b if law.sensor not in names and serial(law) == serial(old)]
        if old.sensor in by_name:
            found.append((old, by_name[old.sensor]))
        elif len(alike) == 1:
            found.append((old, alike[0]))
    if not found and len(a) == len(b) == 1:
        return [(a[0], b[0])]
    if not found:
        told = [", ".join(law.sensor for law in side) for side in (a, b)]
        raise SensorError(f"no sensor is in both files: {told[0]} in A, {told[1]} in B")
    return found


def serial(law: Installed) -> str:
    """Return what the Workbench is called; the sensor's own name where there is none."""
    return law.sensor if law.workbench is None else law.workbench.name


def unpaired(a: Sequence[Installed], b: Sequence[Installed]) -> list[str]:
    """Return a line for every sensor that one file alone has."""
    both = pairs(a, b)
    sides = (("A", a, [old for old, _ in both]), ("B", b, [new for _, new in both]))
    return [
        f"{law.sensor} is in {side} alone"
        for side, laws, kept in sides
        for law in laws
        if law not in kept
    ]


def change(old: Installed, new: Installed, recording: Recording | None = None) -> Change:
    """Return what changes on one sensor. Raises `SensorError` or `DataError`.

    The Workbench of one file serves the other where that knows none.
    """
    workbench = old.workbench or new.workbench
    old = replace(old, workbench=old.workbench or workbench)
    new = replace(new, workbench=new.workbench or workbench)
    if old.reads != new.reads:
        old, new = old.on("channels"), new.on("channels")
    if old.matrix.shape != new.matrix.shape:
        shapes = f"{old.matrix.shape[1]} channels in A, {new.matrix.shape[1]} in B"
        raise SensorError(f"sensor {old.sensor!r}: {shapes}; they are not the same sensor")
    gain = new.matrix - old.matrix
    offset = new.offset - old.offset
    zero = np.zeros(6)
    k = [zero if law.temperature_gain is None else law.temperature_gain for law in (old, new)]
    # both laws at the T_ref of A: the rest of B's term is an offset
    offset = offset + k[1] * (old.reference_temperature - new.reference_temperature)
    size, said = box(old.reads, gain.shape[1], workbench)
    at_log = None
    if recording is not None:
        x = readings(old, new, recording)
        swing = x - x.mean(axis=0)
        moved = swing @ gain.T
        rms, largest = np.sqrt(np.mean(moved**2, axis=0)), np.abs(moved).max(axis=0)
        at_log = LogChange(len(x), rms, largest, gain @ x.mean(axis=0) + offset)
    return Change(
        old.sensor,
        said,
        None if size is None else np.abs(gain @ size).sum(axis=1),
        offset,
        k[1] - k[0],
        at_log,
    )


def box(
    reads: Reads, channels: int, workbench: Workbench | None
) -> tuple[Float[Array, "K K"] | None, str]:
    """Return B of the box `x = B y, |y| <= 1` that is full scale, and what it is called.

    Six channels: every axis of the Workbench's wrench to its full scale. Any other number: every
    channel to where it alone makes a full scale. No Workbench: counts to 32767, or not known.
    """
    if workbench is None:
        if reads == "wrench":
            return None, ""
        return np.eye(channels) * COUNTS, f"every channel to {COUNTS} counts"
    if channels != 6:
        size = np.linalg.inv(workbench.scaling)
        return size, "every channel to where it alone makes a full scale of the Workbench"
    force, torque = (" ".join(f"{v:g}" for v in part) for part in np.split(workbench.full_scale, 2))
    named = f"every axis of the Workbench's wrench to its full scale ({force} N, {torque} Nm)"
    full = np.diag(workbench.full_scale)
    return (full if reads == "wrench" else np.linalg.solve(workbench.gain, full)), named


def readings(old: Installed, new: Installed, recording: Recording) -> Float[Array, "N K"]:
    """Return x of the sensor in a log: what both laws are applied to."""
    signal = old.signal or new.signal
    if signal is None:
        if len(recording.channels) != 1:
            raise DataError(
                f"sensor {old.sensor!r}: neither file names its signal, and the log has"
                f" {len(recording.channels)}; give calibration.json for A or B"
            )
        signal = recording.channels[0].name
    for law in (old, new):
        if link := (law.about or {}).get("wrench_frame"):
            raise DataError(
                f"signal {signal!r} is in the axes of {link!r}, the laws in those of the sensor;"
                " compare without --log"
            )
    values = recording.channel(signal).values
    logged = values[np.isfinite(values).all(axis=1)]
    if not len(logged):
        raise DataError(f"signal {signal!r} of recording {recording.name!r} has no samples")
    if logged.shape[1] != old.matrix.shape[1]:
        raise DataError(
            f"signal {signal!r} of recording {recording.name!r} has {logged.shape[1]} columns;"
            f" sensor {old.sensor!r} has {old.matrix.shape[1]}"
        )
    workbench = old.workbench
    if workbench is None:
        # with no Workbench to say what the log carries, it carries what the files read
        return np.asarray(logged)
    if old.reads == "channels":
        return workbench.channels(logged)
    return np.asarray(logged if workbench.logged == "wrench" else logged @ workbench.gain.T)


def as_record(changes: Sequence[Change], alone: Sequence[str]) -> dict[str, Any]:
    """Return the comparison as plain JSON."""

    def by_axis(values: Float[Array, "6"] | None) -> dict[str, float] | None:
        return None if values is None else dict(zip(AXES, map(float, values), strict=True))

    sensors = {
        found.sensor: {
            "box": found.box,
            "full_scale": by_axis(found.full_scale),
            "offset": by_axis(found.offset),
            "per_kelvin": by_axis(found.per_kelvin),
            "log": None
            if (log := found.at_log) is None
            else {
                "samples": log.samples,
                "rms": by_axis(log.rms),
                "largest": by_axis(log.largest),
                "shift": by_axis(log.shift),
            },
        }
        for found in changes
    }
    return {"sensors": sensors, "alone": list(alone)}


def shown(value: float) -> str:
    """Return a figure with three digits; what is left by rounding is zero."""
    return figures(value).replace("−", "-") if abs(value) > ROUNDING else "0"


def print_changes(console: Console, changes: Sequence[Change], alone: Sequence[str]) -> None:
    """Print a table a sensor, an axis a row."""
    for found in changes:
        console.print(Text.assemble((found.sensor, "bold"), ", B minus A"))
        columns: list[tuple[str, Float[Array, "6"]]] = []
        if found.full_scale is not None:
            columns.append(("largest at\nfull scale", found.full_scale))
        if (log := found.at_log) is not None:
            columns += [("RMS\nin log", log.rms), ("largest\nin log", log.largest)]
            columns.append(("mean shift\nin log", log.shift))
        columns.append(("offset", found.offset))
        if found.per_kelvin.any():
            columns.append(("per kelvin", found.per_kelvin))
        made = table("axis", *(name for name, _ in columns), right=range(1, len(columns) + 1))
        for axis, (name, unit) in enumerate(zip(AXES, UNITS, strict=True)):
            made.add_row(name, *(f"{shown(values[axis])} {unit}" for _, values in columns))
        console.print(made)
        lines = ["full scale: " + (found.box or "not known; give calibration.json for A or B")]
        if log is not None:
            lines.append(
                f"log: {log.samples} samples; RMS and largest about the mean, which is in the shift"
            )
        console.print(Text("\n".join(lines)))
        console.print()
    for line in alone:
        console.print(Text(line))
