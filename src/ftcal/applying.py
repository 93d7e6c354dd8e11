"""A log read again with a calibration: the same channels, corrected wrenches."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ftcal.calibration import Calibration, Offset, SensorCalibration
from ftcal.errors import DataError, OutputError, unknown
from ftcal.logs import tables
from ftcal.recording import Recording, Signal
from ftcal.sensor import AXES
from ftcal.signals import interpolate

ZERO = "zero"
"""Name of the choice to add no offset."""
AUTO = "auto"
"""Name of the choice to take the log's own offset, else the latest that is known."""


def corrected(
    calibration: Calibration, recording: Recording, offset: str = AUTO
) -> tuple[Recording, dict[str, str]]:
    """Return the corrected wrenches [N, Nm] of every calibrated sensor the recording carries.

    Also returns, by sensor, whose offset was added. `offset` names a recording of the calibration,
    or is `zero` or `auto`. Raises `DataError` where no calibrated sensor is in the log, or the
    offset is not known.
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
        values, used[sensor.sensor] = chosen_offset(sensor, recording.name, offset)
        signals.append(corrected_signal(sensor, recording, logged[sensor.signal], values))
    only = replace(
        recording, channels=tuple(signals), joints=(), temperatures=(), imus=(), findings=()
    )
    return only, used


def chosen_offset(
    sensor: SensorCalibration, recording: str, choice: str
) -> tuple[Sequence[float], str]:
    """Return the offset [N, Nm] that `choice` means for a recording, and whose it is."""
    if choice == ZERO:
        return [0.0] * 6, ZERO
    known: dict[str, Offset] = {segment.recording: segment for segment in sensor.offsets}
    last = sensor.offsets[-1].recording
    name = (recording if recording in known else last) if choice == AUTO else choice
    if name not in known:
        raise DataError(unknown(f"offset of {sensor.sensor!r} for recording", name, known))
    segment = known[name]
    return segment.offset, f"{segment.recording} {segment.start:.1f}-{segment.stop:.1f} s"


def corrected_signal(
    sensor: SensorCalibration, recording: Recording, signal: Signal, offset: Sequence[float]
) -> Signal:
    """Return the wrench [N, Nm] that the calibration reads from one signal.

    With a temperature term, samples without a temperature are left out.
    """
    model = sensor.model(list(offset))
    temperature = None
    kept = np.ones(len(signal), dtype=bool)
    if sensor.temperature_gain is not None:
        if sensor.temperature_signal is None:
            raise DataError(f"calibration of {sensor.sensor!r} names no temperature signal")
        warm = recording.temperature(sensor.temperature_signal)
        temperature = interpolate(warm, signal.stamps)[:, 0]
        kept = np.isfinite(temperature)
        temperature = temperature[kept]
    channels = sensor.workbench().channels(signal.values[kept])
    return Signal(
        sensor.sensor,
        AXES,
        signal.stamps[kept],
        model.wrench(channels, temperature),
    )


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
