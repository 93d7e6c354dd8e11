"""A log read again with a calibration: the same channels, corrected wrenches, how sure they are.

A corrected wrench is `w = C x + o` with x the channels (and T - T_ref), and the offset was found at
the mean x0 of one segment: `o = w0 - C x0`, so `w = C (x - x0) + w0`. Gain and w0 err independently
(the gain was fitted about the means, P4 to P6), hence per axis, with Sigma the covariance of a row,

    sd^2 = (x - x0)^T Sigma (x - x0) + sd0^2 .

The standard deviation of o itself is that of a reading of zero counts, far away: it holds
x0^T Sigma x0 and would count the gain twice.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal.calibration import Calibration, Centre, Offset, SensorCalibration
from ftcal.errors import DataError, OutputError, unknown
from ftcal.law import Law
from ftcal.logs import tables
from ftcal.recording import Recording, Signal
from ftcal.sensor import AXES
from ftcal.signals import interpolate

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

ZERO = "zero"
"""Name of the choice to add no offset."""
AUTO = "auto"
"""Name of the choice to take the log's own offset, else the latest that is known."""


def corrected(
    calibration: Calibration, recording: Recording, offset: str = AUTO, *, sd: bool = False
) -> tuple[Recording, dict[str, str]]:
    """Return the corrected wrenches [N, Nm] of every calibrated sensor the recording carries.

    Also returns, by sensor, whose offset was added. `offset` names a recording of the calibration,
    or is `zero` or `auto`. With `sd` a sensor has columns `fx_sd` to `tz_sd` too, of the axes whose
    standard deviation is known (`wrench_sd`). Raises `DataError` where no calibrated sensor is in
    the log, the offset is not known, or its standard deviation is asked for and is not.
    """
    logged = {signal.name: signal for signal in recording.channels}
    carried = [sensor for sensor in calibration.sensors if sensor.signal in logged]
    if not carried:
        wanted = ", ".join(sensor.signal for sensor in calibration.sensors)
        raise DataError(
            f"recording {recording.name!r} carries none of the calibrated signals ({wanted})"
        )
    signals, used = [], {}
    for sensor in carried:
        segment, used[sensor.sensor] = chosen_offset(sensor, recording.name, offset)
        stamps, x = inputs(sensor, recording, logged[sensor.signal])
        wrench = Law(sensor.coefficients, np.array(segment.offset)).read(x)
        signal = Signal(sensor.sensor, AXES, stamps, wrench)
        signals.append(with_sd(signal, sensor, x, segment) if sd else signal)
    only = replace(
        recording, channels=tuple(signals), joints=(), temperatures=(), imus=(), findings=()
    )
    return only, used


def chosen_offset(sensor: SensorCalibration, recording: str, choice: str) -> tuple[Offset, str]:
    """Return the offset that `choice` means for a recording, and whose it is.

    `zero` is an offset known without error: what is left to err is the gain, from zero counts on.
    """
    if choice == ZERO:
        none = [0.0] * 6
        nowhere = Centre(inputs=[0.0] * len(sensor.covariance[0]), sd=none)
        return Offset(recording=ZERO, start=0, stop=0, offset=none, sd=none, centre=nowhere), ZERO
    known: dict[str, Offset] = {segment.recording: segment for segment in sensor.offsets}
    last = sensor.offsets[-1].recording
    name = (recording if recording in known else last) if choice == AUTO else choice
    if name not in known:
        raise DataError(unknown(f"offset of {sensor.sensor!r} for recording", name, known))
    segment = known[name]
    return segment, f"{segment.recording} {segment.start:.1f}-{segment.stop:.1f} s"


def inputs(
    sensor: SensorCalibration, recording: Recording, signal: Signal
) -> tuple[Int[Array, "N"], Float[Array, "N P"]]:
    """Return stamps [ns] and what the law reads: raw channels, and T - T_ref [K] where it has one.

    With a temperature term, samples without a temperature are left out.
    """
    channels = sensor.workbench().channels(signal.values)
    if sensor.temperature_gain is None:
        return signal.stamps, channels
    if sensor.temperature_signal is None:
        raise DataError(f"calibration of {sensor.sensor!r} names no temperature signal")
    logged = interpolate(recording.temperature(sensor.temperature_signal), signal.stamps)
    warmer = logged[:, 0] - sensor.reference_temperature
    kept = np.isfinite(warmer)
    return signal.stamps[kept], np.column_stack([channels, warmer])[kept]


def with_sd(
    signal: Signal, sensor: SensorCalibration, x: Float[Array, "N P"], segment: Offset
) -> Signal:
    """Return a corrected signal with the standard deviation of every axis that has one."""
    known = [axis not in refused(sensor) for axis in AXES]
    names = tuple(f"{axis}_sd" for axis, has in zip(AXES, known, strict=True) if has)
    sd = wrench_sd(sensor, x, segment)[:, known]
    return replace(
        signal,
        columns=(*signal.columns, *names),
        values=np.column_stack([signal.values, sd]),
    )


def refused(sensor: SensorCalibration) -> tuple[str, ...]:
    """Return the axes that keep their Workbench row: the covariance is not of what they deploy."""
    return tuple(verdict.axis for verdict in sensor.verdicts if verdict.verdict == "REFUSE")


def wrench_sd(
    sensor: SensorCalibration, x: Float[Array, "N P"], segment: Offset
) -> Float[Array, "N 6"]:
    """Return the standard deviation [N, Nm] of the wrenches corrected with the offset of a segment.

    `x` are channels, and T - T_ref [K] as the last column where there is a temperature term. This
    is the error of the calibration, which neighbouring samples share and no averaging removes; the
    noise of the reading itself is apart (`noise_sd` bounds that of a smoothed sample: add it in
    squares). NaN where an axis was refused: nothing says how wrong its Workbench row is. It knows
    no drift of the offset after the segment, and no error of the robot model that the residuals do
    not show (a mass that is wrong by a factor). Raises `DataError` where the file does not say
    about which mean the offset was found.
    """
    if segment.centre is None:
        raise DataError(
            f"offset of {sensor.sensor!r} for {segment.recording!r} has no `centre`, so its"
            " standard deviation is not known; calibrate each sensor by itself with this ftcal, or"
            " leave out --sd"
        )
    away = x - np.array(segment.centre.inputs)
    sd = np.full((len(x), 6), np.nan)
    for axis, name in enumerate(AXES):
        if name in refused(sensor):
            continue
        # a gain that nothing moved, or a prior that is certain, leaves Sigma singular: no Cholesky
        d, V = np.linalg.eigh(np.array(sensor.covariance[axis]))
        spread = away @ (V * np.sqrt(np.maximum(d, 0.0)))
        from_gain = np.einsum("np,np->n", spread, spread)
        sd[:, axis] = np.sqrt(from_gain + segment.centre.sd[axis] ** 2)
    return sd


def write_table(recording: Recording, path: Path) -> None:
    """Write the signals of a recording, whole or not at all.

    `*.csv` and `*.parquet` are one table, for signals of one clock; a name without a suffix is a
    folder of Parquet files, one a signal. Raises `OutputError`.
    """
    if path.suffix.lower() not in {"", ".csv", ".parquet"}:
        raise OutputError(f"{path}: unknown table {path.suffix!r}; use .csv, .parquet or a folder")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as scratch:
            made = Path(scratch) / path.name
            tables.write(recording, made)
            made.replace(path)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror or error}); name another place with -o"
        ) from error
