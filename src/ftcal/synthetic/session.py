"""A session: takes of a pretend robot with one pretend sensor, what was logged, and the truth."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.firmware import FirmwareMatrix
from ftcal.recording import NANOSECONDS, Recording
from ftcal.robot import Robot
from ftcal.sensor import SensorModel
from ftcal.synthetic.logger import REFERENCE_TEMPERATURE, Conditions, Logger, Take
from ftcal.synthetic.sensor import invent_firmware, mount

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

START = 1_600_000_000 * NANOSECONDS
"""When the first pretend take began [ns since the Unix epoch]."""

PAUSE = 60 * NANOSECONDS
"""Between two takes [ns]."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorTruth:
    """What a calibration should find."""

    gain: Float[Array, "6 6"]
    """C [N, Nm per count]."""
    secondary: Float[Array, "6 6"]
    """S, `C = S C_w`."""
    offsets: Mapping[str, Float[Array, "6"]]
    """o [N, Nm] by recording."""
    firmware: FirmwareMatrix
    """C_w and full scale, as in the sensor's board: what is known beforehand."""
    temperature_gain: Float[Array, "6"] | None
    """k [N/K, Nm/K], None where the sensor did not warm up."""
    reference_temperature: float
    """T_ref [degree Celsius]."""

    def model(self, recording: str) -> SensorModel:
        """Return the true sensor in one recording."""
        return SensorModel(
            self.gain, self.offsets[recording], self.temperature_gain, self.reference_temperature
        )


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """All takes of one sensor."""

    robot: Robot
    sensor: str
    """Name of the sensor in the robot description."""
    signal: str
    """F/T signal of the recordings that carries its calibrated wrench [N, Nm]."""
    takes: tuple[Take, ...]
    recordings: tuple[Recording, ...]
    """What was logged, take by take."""
    truth: SensorTruth


def simulate(
    robot: Robot,
    takes: Sequence[Take],
    *,
    sensor: str,
    generator: np.random.Generator,
    signal: str | None = None,
    firmware: FirmwareMatrix | None = None,
    conditions: Conditions | None = None,
) -> Session:
    """Return what the robot would log of `takes`, and the truth about its sensor.

    The same mounted sensor is in all takes; each has its own raw offset. `signal` is the port of
    its log, such as `right_leg/analog:o` (default: by the sensor's name); `firmware` is that of a
    real sensor (default: an invented one). Raises `DataError` where take names repeat or the sensor
    would saturate, `RobotError` for unknown names.
    """
    conditions = conditions or Conditions()
    _check(takes)
    name = robot.sensor(sensor).name
    mounted = mount(firmware or invent_firmware(generator), generator, kappa=conditions.kappa)
    port = _port(signal or re.sub(r"[^\w-]", "_", name))
    logger = Logger(robot, name, port, mounted, conditions)
    recordings, offsets, start = [], {}, START
    for take in takes:
        recording, raw = logger.record(take, start, generator)
        recordings.append(recording)
        offsets[take.name] = -mounted.gain @ raw
        start += round(take.trajectory.duration) * NANOSECONDS + PAUSE
    truth = SensorTruth(
        mounted.gain,
        mounted.secondary,
        offsets,
        mounted.firmware,
        mounted.temperature_gain if conditions.warming else None,
        REFERENCE_TEMPERATURE,
    )
    return Session(robot, name, port, tuple(takes), tuple(recordings), truth)


def _port(signal: str) -> str:
    """Return the port of an F/T signal: its folders, then `analog:o`."""
    if not re.fullmatch(r"[\w:-]+(/[\w:-]+)*", signal):
        raise DataError(
            f"signal {signal!r} is no port; use letters, digits, _ and - with / between, such as"
            " right_leg/analog:o"
        )
    return signal if signal.endswith("/analog:o") else f"{signal}/analog:o"


def _check(takes: Sequence[Take]) -> None:
    """Raise `DataError` unless every take can have a folder of its own."""
    names = [take.name for take in takes]
    faults = [f"{n!r} is no folder name; use letters, digits, _ and -" for n in names
              if not re.fullmatch(r"[\w-]+", n)]  # fmt: skip
    faults += [f"{n!r} appears twice" for n in sorted(set(names)) if names.count(n) > 1]
    if not names:
        faults.append("there is none")
    raise_all(DataError, "takes", faults)
