"""A session: takes of a pretend robot with pretend sensors, what was logged, and the truth."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all, unknown
from ftcal.firmware import FirmwareMatrix
from ftcal.recording import NANOSECONDS, Recording
from ftcal.robot import Robot
from ftcal.sensor import SensorModel
from ftcal.synthetic.conditions import REFERENCE_TEMPERATURE, Conditions
from ftcal.synthetic.faults import Faults
from ftcal.synthetic.faults import check as check_faults
from ftcal.synthetic.inertia import perturbed
from ftcal.synthetic.logger import Logger, Mounted
from ftcal.synthetic.sensor import invent_firmware, mount
from ftcal.synthetic.take import Take
from ftcal.synthetic.take import check as check_takes

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

START = 1_600_000_000 * NANOSECONDS
"""When the first pretend take began [ns since the Unix epoch]."""

PAUSE = 60 * NANOSECONDS
"""Between two takes [ns]."""

FIRST_SERIAL = 900
"""Serial number of the first invented sensor; the others follow."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorTruth:
    """What a calibration should find."""

    gain: Float[Array, "6 6"]
    """C [N, Nm per count]."""
    secondary: Float[Array, "6 6"]
    """S, `C = S C_w`."""
    offsets: Mapping[str, Float[Array, "6"]]
    """o [N, Nm] by recording, as it begins: before any offset step."""
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
    """All takes of all sensors."""

    robot: Robot
    """As its description says."""
    real: Robot
    """As it weighs."""
    sensors: Mapping[str, str]
    """Sensor → F/T signal of the recordings that carries its calibrated wrench [N, Nm]."""
    takes: tuple[Take, ...]
    recordings: tuple[Recording, ...]
    """What was logged, take by take."""
    truth: Mapping[str, SensorTruth]
    """By sensor."""
    faults: Faults
    """What was made to go wrong."""
    joint_zeros: Mapping[str, float]
    """Joint → what its encoder reads at position zero [rad or m]; empty where all read zero."""
    thermometers: Mapping[str, str]
    """Sensor → temperature signal; empty where none is logged."""


def simulate(
    robot: Robot,
    takes: Sequence[Take],
    *,
    sensors: Mapping[str, str],
    generator: np.random.Generator,
    firmware: Mapping[str, FirmwareMatrix] | None = None,
    conditions: Conditions | None = None,
    faults: Faults | None = None,
) -> Session:
    """Return what the robot would log of `takes`, and the truth about its sensors.

    `sensors` maps sensors to their ports in the log, such as `right_leg/analog:o`; `firmware` those
    that are real to what is in their boards (default: invented). The same mounted sensors are in
    all takes; each take has its own raw offsets. Raises `DataError` where names repeat, a fault
    names what is not there, or a sensor would saturate unasked; `RobotError` for unknown names.
    """
    conditions, faults = conditions or Conditions(), faults or Faults()
    check_takes(takes)
    ports = _ports(robot, sensors)
    boards = {robot.sensor(name).name: board for name, board in (firmware or {}).items()}
    _check_boards(ports, boards)
    check_faults(faults, robot, ports, takes)
    mounted = []
    for number, (name, port) in enumerate(ports.items()):
        board = boards.get(name) or invent_firmware(generator, serial=serial(number))
        kappa = faults.kappa.get(name, conditions.kappa)
        mounted.append(Mounted(name, port, mount(board, generator, kappa=kappa)))
    # of their own stream: what is drawn for a session does not depend on its faults
    weights, encoders = generator.spawn(2)
    real = perturbed(robot, weights, mass=faults.mass, com=faults.com)
    drawn = faults.joint_zero * encoders.normal(size=len(robot.moving_joints))
    zeros = dict(zip(robot.moving_joints, drawn.tolist(), strict=True)) if faults.joint_zero else {}
    warm = bool(conditions.warming) or any(take.warm for take in takes)
    logger = Logger(real, mounted, conditions, faults, zeros, warm)
    recordings, start = [], START
    offsets: dict[str, dict[str, Float[Array, "6"]]] = {name: {} for name in ports}
    for take in takes:
        recording, raw = logger.record(take, start, generator)
        recordings.append(recording)
        for one in mounted:
            offsets[one.name][take.name] = -one.sensor.gain @ raw[one.name]
        start += round(take.trajectory.duration) * NANOSECONDS + PAUSE
    truth = {
        one.name: SensorTruth(
            one.sensor.gain,
            one.sensor.secondary,
            offsets[one.name],
            one.sensor.firmware,
            one.sensor.temperature_gain if warm else None,
            REFERENCE_TEMPERATURE,
        )
        for one in mounted
    }
    logged = warm and conditions.thermometer
    return Session(
        robot=robot,
        real=real,
        sensors=ports,
        takes=tuple(takes),
        recordings=tuple(recordings),
        truth=truth,
        faults=faults,
        joint_zeros=zeros,
        thermometers={one.name: one.thermometer for one in mounted} if logged else {},
    )


def serial(number: int) -> str:
    """Return the serial number of the board of an invented sensor; they count from 0."""
    return f"SN{FIRST_SERIAL + number}"


def _ports(robot: Robot, sensors: Mapping[str, str]) -> dict[str, str]:
    """Return the port of each sensor by its name in the robot; `DataError` where one repeats."""
    named = [(robot.sensor(name).name, _port(signal)) for name, signal in sensors.items()]
    faults = [
        f"{name!r} appears twice"
        for names in zip(*named, strict=True)
        for name in sorted(set(names))
        if names.count(name) > 1
    ]
    if not named:
        faults.append("there is none")
    raise_all(DataError, "sensors", faults)
    return dict(named)


def _check_boards(ports: Mapping[str, str], boards: Mapping[str, FirmwareMatrix]) -> None:
    """Raise `DataError` unless every board is of a sensor that is simulated, and the only one."""
    serials = [board.serial for board in boards.values()]
    faults = [unknown("simulated sensor", name, ports) for name in boards if name not in ports]
    faults += [f"{n!r} appears twice" for n in sorted(set(serials)) if serials.count(n) > 1]
    raise_all(DataError, "firmware", faults)


def _port(signal: str) -> str:
    """Return the port of an F/T signal: its folders, then `analog:o`."""
    if not re.fullmatch(r"[\w:-]+(/[\w:-]+)*", signal):
        raise DataError(
            f"signal {signal!r} is no port; use letters, digits, _ and - with / between, such as"
            " right_leg/analog:o"
        )
    return signal if signal.endswith("/analog:o") else f"{signal}/analog:o"
