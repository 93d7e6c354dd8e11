"""How a pretend robot logs one take: the sensor's board, the encoders, the clocks.

The sensor feels the wrench of the *true* motion at the very times it is logged; what is logged of
the motion is what the encoders saw, on their own clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.dynamics import expected_wrenches
from ftcal.errors import DataError, raise_all
from ftcal.logs.layout import ICUB_JOINTS, WRENCH_AXES
from ftcal.motion import FixedContact
from ftcal.motions import Trajectory
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.robot import Robot
from ftcal.synthetic.sensor import PretendSensor

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

MICROSECOND = 1000
"""Finest step of the time stamps [ns]: logs of a YARP dumper keep no more."""

REFERENCE_TEMPERATURE = 25.0
"""T_ref of every pretend sensor [degree Celsius]."""

WARMEST_START = 5.0
"""How much warmer than T_ref a sensor may be when a take begins [K]."""

THERMOMETER_STEP = 0.1
"""Resolution of the thermometer [K]; it is read once a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """How imperfect the pretend sensor, encoders and clocks are; the defaults are an iCub's."""

    kappa: float = 0.03
    """Expected bend of the secondary matrix by mounting, fraction of full scale."""
    noise: float = 8.0
    """Standard deviation of the white noise on every raw channel [counts]: the sensors of the real
    iCubGenova02 show 2 to 14."""
    offset: float = 8000.0
    """Largest raw offset of a channel [counts]; every recording draws its own."""
    digital: bool = True
    """Whether counts are whole and the board sends steps of full scale / 32768."""
    encoder: float = 2.0 * np.pi / 4096.0
    """Step of the joint encoders [rad]; 0 for none. Default: 12 bits, 0.0879 degrees."""
    flicker: float = 0.2
    """Standard deviation of the noise of the joint encoders, share of their step: of the joints of
    the real iCubGenova02 at rest, two in five keep changing between two readings."""
    rate: float = 100.0
    """Samples of every signal per second."""
    jitter: float = 2e-4
    """Standard deviation of the time between samples about its mean [s]."""
    warming: float = 0.0
    """How much the sensor warms up during a take [K]; where it does, a thermometer is logged."""

    def __post_init__(self) -> None:
        faults = [
            f"{name} = {value:g} must be zero or more and finite"
            for name, value in (
                ("kappa", self.kappa),
                ("noise", self.noise),
                ("offset", self.offset),
                ("encoder", self.encoder),
                ("flicker", self.flicker),
                ("jitter", self.jitter),
                ("warming", abs(self.warming)),
            )
            if not 0.0 <= value < np.inf
        ]
        if not 0.0 < self.rate < np.inf:
            faults.append(f"rate = {self.rate:g} must be positive and finite")
        raise_all(DataError, "conditions", faults)


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """One recording to be made."""

    name: str
    """Its name, and that of its folder."""
    trajectory: Trajectory
    """How the robot moves: of `ftcal.motions`, or a user's own."""
    contact: FixedContact
    """What stands still, and which way gravity points there."""
    held_out: bool = False
    """Whether the job keeps it for validation alone."""


@dataclass(frozen=True, slots=True)
class Warmth:
    """Temperature of the sensor during a take."""

    start: float
    """Above T_ref when the take begins [K]."""
    rate: float
    """K/s."""

    def above_reference(self, time: Float[Array, "N"]) -> Float[Array, "N"]:
        """Return T - T_ref [K] at `time` [s]."""
        return np.asarray(self.start + self.rate * time)


@dataclass(frozen=True, slots=True, eq=False)
class Logger:
    """A robot with its mounted sensor, and how well it logs both."""

    robot: Robot
    sensor: str
    port: str
    mounted: PretendSensor
    conditions: Conditions

    def record(
        self, take: Take, start: int, generator: np.random.Generator
    ) -> tuple[Recording, Float[Array, "6"]]:
        """Return one recording from `start` [ns] on, and the raw offset of its sensor [counts]."""
        trajectory, warming = take.trajectory, self.conditions.warming
        ports = _joint_ports(trajectory.joints)
        clocks = _clocks([self.port, *ports], trajectory.duration, self.conditions, generator)
        began = min(int(clock[0]) for clock in clocks.values())
        since = {name: clock - began for name, clock in clocks.items()}

        warmth = Warmth(generator.uniform(0.0, WARMEST_START) if warming else 0.0,
                        warming / trajectory.duration)  # fmt: skip
        wrench, raw = self.sense(take, warmth, since[self.port] / NANOSECONDS, generator)
        felt = Signal(self.port, WRENCH_AXES, since[self.port] + start, wrench)
        joints = [
            Signal(
                name,
                columns,
                since[name] + start,
                self.encode(trajectory, columns, since[name], generator),
            )
            for name, columns in ports.items()
        ]
        recording = Recording(
            name=take.name,
            source="ftcal.synthetic",
            start=start,
            joints=tuple(joints),
            channels=(felt,),
            temperatures=(self.thermometer(warmth, trajectory.duration, start),) if warming else (),
        )
        return recording, raw

    def sense(
        self, take: Take, warmth: Warmth, time: Float[Array, "N"], generator: np.random.Generator
    ) -> tuple[Float[Array, "N 6"], Float[Array, "6"]]:
        """Return what the board sends [N, Nm] at `time` [s], and the raw offset [counts]."""
        motion = take.trajectory.at(time)
        wrench = expected_wrenches(self.robot, motion, take.contact, [self.sensor])[self.sensor]
        response = self.mounted.response(wrench, warmth.above_reference(time))
        noise, largest = self.conditions.noise, self.conditions.offset
        raw = self.mounted.zero(response, generator, largest=largest, spare=8.0 * noise)
        counts = response + raw + noise * generator.normal(size=response.shape)
        if self.conditions.digital:
            return self.mounted.sent(np.rint(counts)), raw
        return counts @ self.mounted.firmware.matrix.T, raw

    def encode(
        self,
        trajectory: Trajectory,
        joints: tuple[str, ...],
        since: Int[Array, "N"],
        generator: np.random.Generator,
    ) -> Float[Array, "N K"]:
        """Return what the encoders of `joints` see [rad or m]."""
        motion = trajectory.at(since / NANOSECONDS)
        position = motion.position[:, motion.columns(joints)]
        noise = self.conditions.flicker * generator.normal(size=position.shape)
        step = self.conditions.encoder
        return np.asarray(np.rint(position / step + noise) * step) if step else position

    def thermometer(self, warmth: Warmth, duration: float, start: int) -> Signal:
        """Return the sensor's temperature [degree Celsius], read once a second."""
        second = np.arange(int(np.ceil(duration)) + 1)
        celsius = REFERENCE_TEMPERATURE + warmth.above_reference(second)
        if self.conditions.digital:
            celsius = np.rint(celsius / THERMOMETER_STEP) * THERMOMETER_STEP
        name = f"{self.port.rpartition('/')[0]}/temperature:o"
        return Signal(name, ("temperature",), start + second * NANOSECONDS, celsius[:, None])


def _joint_ports(joints: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the joints of each logged port: an iCub's parts as its boards log them, then others.

    A part logs its first joints up to the first that the robot lacks.
    """
    left = dict.fromkeys(joints)
    ports = {}
    for part, names in ICUB_JOINTS.items():
        logged = names[: next((k for k, n in enumerate(names) if n not in left), len(names))]
        if logged:
            ports[f"{part}/stateExt:o"] = logged
            left = dict.fromkeys(name for name in left if name not in logged)
    return {**ports, "body/stateExt:o": tuple(left)} if left else ports


def _clocks(
    ports: Sequence[str], duration: float, conditions: Conditions, generator: np.random.Generator
) -> dict[str, Int[Array, "N"]]:
    """Return the stamps [ns] of each port from the start of the motion, in whole microseconds.

    Every port starts within one period; stamps keep their order whatever the jitter.
    """
    period = 1.0 / conditions.rate
    clocks = {}
    for port in ports:
        phase = generator.uniform(0.4, 1.4) * period
        count = int((duration - phase) / period)
        jitter = generator.normal(size=count) * conditions.jitter
        when = phase + np.arange(count) * period + np.clip(jitter, -0.4 * period, 0.4 * period)
        clocks[port] = np.rint(when * (NANOSECONDS / MICROSECOND)).astype(np.int64) * MICROSECOND
    return clocks
