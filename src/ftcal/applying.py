"""A log read again with a calibration: the same channels, corrected wrenches, how sure they are.

A corrected wrench is `w = C x + o` with x the channels (and T - T_ref), and the offset was found at
the mean x0 of one segment: `o = w0 - C x0`, so `w = C (x - x0) + w0`. Gain and w0 err independently
(the gain was fitted about the means, P4 to P6), hence per axis, with Sigma the covariance of a row,

    sd^2 = (x - x0)^T Sigma (x - x0) + sd0^2 .

The standard deviation of o itself is that of a reading of zero counts, far away: it holds
x0^T Sigma x0 and would count the gain twice.

A log passes through in pieces, so its length costs no memory. What a piece becomes does not depend
on where it was cut, to the last bit: no sum here goes over samples, nor asks how many there are.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ftcal.calibration import Calibration, Centre, Offset, SensorCalibration
from ftcal.errors import DataError, OutputError, unknown
from ftcal.logs.pieces import Pieces
from ftcal.pairing import FtChannel
from ftcal.recording import Recording, Signal
from ftcal.robot import Robot
from ftcal.sensor import AXES
from ftcal.signals import default_gap, longest_pause, temperature_at
from ftcal.turning import turned_back

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

ZERO = "zero"
"""Name of the choice to add no offset."""
AUTO = "auto"
"""Name of the choice to take the log's own offset, else the latest that is known."""


BLOCK_ROWS = 4096
"""Rows that are mapped at a time: what was read and what is written stay in cache."""


class Writer(Protocol):
    """A file that grows by pieces of a recording."""

    def add(self, recording: Recording) -> None:
        """Append the samples of a piece."""


def apply(
    calibration: Calibration,
    log: Pieces,
    path: Path,
    offset: str = AUTO,
    *,
    sd: bool = False,
    rows: int | None = None,
    robot: Robot | None = None,
) -> dict[str, str]:
    """Write the corrected wrenches of a log at `path`, as `corrected` returns them of the whole.

    Returns by sensor whose offset was added. A sensor with a `wrench_frame` needs the `robot`: the
    log is first turned into the sensor's frame. In memory are `rows` samples of each signal (a few
    MB where it is not said) and what a thermometer, or turning, needs beyond. Raises as `corrected`
    and `in_sensor_frames` do, `LogError` for what only the numbers of the log show, and
    `OutputError`; then nothing is written.
    """
    log = in_sensor_frames(calibration, log, robot)
    _, used = corrected(calibration, log.head, offset, sd=sd)  # refused before a file is begun
    thermometers = {
        sensor.temperature_signal
        for sensor in calibration.sensors
        if sensor.sensor in used and sensor.temperature_gain is not None
    }
    gaps = {name: longest_pause(log.period("temperatures", name)) for name in thermometers if name}
    with writer(path) as file:
        for piece in log.pieces(rows=rows, overlap=max(gaps.values(), default=0.0)):
            shown = replace(piece.recording, channels=piece.own.channels)
            file.add(corrected(calibration, shown, offset, sd=sd, gaps=gaps)[0])
    return used


def in_sensor_frames(calibration: Calibration, log: Pieces, robot: Robot | None) -> Pieces:
    """Return a log with every wrench in the frame of its sensor.

    Raises `DataError` where a calibrated sensor that it carries is logged in the axes of another
    link and the robot, which would turn it, is not known; else as `turning.turned_back`.
    """
    logged = {signal.name for signal in log.head.channels}
    turned = [
        sensor
        for sensor in calibration.sensors
        if sensor.wrench_frame is not None and sensor.signal in logged
    ]
    if not turned:
        return log
    if robot is None:
        named = "; ".join(f"{s.signal!r} is in the axes of {s.wrench_frame!r}" for s in turned)
        raise DataError(
            f"recording {log.head.name!r}: {named}, and only the joints turn it into the sensor's"
            " frame; give --robot URDF"
        )
    channels = [
        FtChannel(s.sensor, s.signal, s.workbench(), s.temperature_signal, s.wrench_frame)
        for s in turned
    ]
    return turned_back(log, robot, channels)


def corrected(
    calibration: Calibration,
    recording: Recording,
    offset: str = AUTO,
    *,
    sd: bool = False,
    gaps: Mapping[str, float] | None = None,
) -> tuple[Recording, dict[str, str]]:
    """Return the corrected wrenches [N, Nm] of every calibrated sensor the recording carries.

    They are expressed in each sensor's `frame`, as those of the recording must be (see
    `in_sensor_frames`). Also returns, by sensor, whose offset was added. `offset` names a recording
    of the calibration, or is `zero` or `auto`. With `sd` a sensor has columns `fx_sd` to `tz_sd`
    too, of the axes whose standard deviation is known (`wrench_sd`). `gaps` says of a thermometer
    which pause [s] is a hole, where the recording is a piece that cannot tell (default
    `default_gap`). Raises `DataError` where no calibrated sensor is in the log, the offset is not
    known, or its standard deviation is asked for and is not.
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
        stamps, x = inputs(sensor, recording, logged[sensor.signal], gaps=gaps or {})
        wrench = by_rows(x, sensor.coefficients, np.array(segment.offset))
        signal = Signal(sensor.sensor, AXES, stamps, wrench)
        signals.append(with_sd(signal, sensor, x, segment) if sd else signal)
    only = replace(
        recording, channels=tuple(signals), joints=(), temperatures=(), imus=(), findings=()
    )
    return only, used


def by_rows(
    x: Float[Array, "N P"], matrix: Float[Array, "M P"], offset: Float[Array, "M"]
) -> Float[Array, "N M"]:
    """Return `matrix x + offset` of every row, rounded alike wherever the row stands.

    BLAS rounds a row by its place among the others, and a log in pieces must give the bits of the
    whole: products are added channel by channel. Each column of the result is contiguous.
    """
    result = np.empty((len(matrix), len(x)))
    product = np.empty(BLOCK_ROWS)
    for start in range(0, len(x), BLOCK_ROWS):
        block = x[start : start + BLOCK_ROWS]
        term = product[: len(block)]
        for row, constant, axis in zip(matrix, offset, result, strict=True):
            total = axis[start : start + BLOCK_ROWS]
            np.multiply(block[:, 0], row[0], out=total)
            for channel in range(1, len(row)):
                np.multiply(block[:, channel], row[channel], out=term)
                total += term
            total += constant
    return result.T


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
    sensor: SensorCalibration,
    recording: Recording,
    signal: Signal,
    *,
    gaps: Mapping[str, float],
) -> tuple[Int[Array, "N"], Float[Array, "N P"]]:
    """Return stamps [ns] and what the law reads: raw channels, and T - T_ref [K] where it has one.

    With a temperature term, samples without a temperature are left out.
    """
    decode = channels_of_logged(sensor)
    channels = by_rows(signal.values, decode, np.zeros(len(decode)))
    if sensor.temperature_gain is None:
        return signal.stamps, channels
    if sensor.temperature_signal is None:
        raise DataError(f"calibration of {sensor.sensor!r} names no temperature signal")
    thermometer = recording.temperature(sensor.temperature_signal)
    gap = gaps.get(thermometer.name, default_gap(thermometer))
    warmer = temperature_at(thermometer, signal.stamps, gap) - sensor.reference_temperature
    kept = np.isfinite(warmer)
    return signal.stamps[kept], np.column_stack([channels, warmer])[kept]


def channels_of_logged(sensor: SensorCalibration) -> Float[Array, "K K"]:
    """Return the matrix that makes raw channels of what a log carries: the identity, or C_w^-1."""
    return sensor.workbench().channels(np.eye(len(sensor.gain[0]))).T


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
    centre = known_centre(sensor, segment)
    away = x - np.array(centre.inputs)
    sd = np.full((len(x), 6), np.nan)
    for axis, (name, root) in enumerate(zip(AXES, gain_roots(sensor), strict=True)):
        if name in refused(sensor):
            continue
        squared = np.full(len(x), centre.sd[axis] ** 2)
        for spread in by_rows(away, root.T, np.zeros(len(root))).T:
            squared += spread**2
        sd[:, axis] = np.sqrt(squared)
    return sd


def known_centre(sensor: SensorCalibration, segment: Offset) -> Centre:
    """Return the mean about which an offset was found; `DataError` where the file is silent."""
    if segment.centre is None:
        raise DataError(
            f"offset of {sensor.sensor!r} for {segment.recording!r} has no `centre`, so its"
            " standard deviation is not known; calibrate each sensor by itself with this ftcal, or"
            " leave out --sd"
        )
    return segment.centre


def gain_roots(sensor: SensorCalibration) -> Float[Array, "6 P P"]:
    """Return R of each row of the gain, with `R R^T` its covariance."""
    # a gain that nothing moved, or a prior that is certain, leaves Sigma singular: no Cholesky
    d, V = np.linalg.eigh(np.array(sensor.covariance))
    return np.asarray(V * np.sqrt(np.maximum(d, 0.0))[:, None, :])


def writer(path: Path) -> AbstractContextManager[Writer]:
    """Return what writes signals at `path`, whole or not at all, piece by piece.

    `*.csv` and `*.parquet` are one table, for signals of one clock; a name without a suffix is a
    folder of Parquet files, one a signal; `*.mcap` are ROS messages. Raises `OutputError`.
    """
    suffix = path.suffix.lower()
    if suffix == ".mcap":
        from ftcal.logs import mcap_writer

        return mcap_writer.Writer(path)
    from ftcal.logs import tables_append

    if suffix not in tables_append.SUFFIXES:
        raise OutputError(
            f"{path}: unknown table {path.suffix!r}; use .csv, .parquet, .mcap or a folder"
        )
    return tables_append.Writer(path)
