"""How a pretend robot logs one take: the sensors' boards, the encoders, the clocks.

Sensors feel the wrench of the *true* motion at the very times they are logged, or a delay before;
what is logged of the motion is what the encoders saw, on their own clocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.logs.layout import ICUB_JOINTS, WRENCH_AXES
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.robot import Robot
from ftcal.synthetic.conditions import REFERENCE_TEMPERATURE, Conditions
from ftcal.synthetic.faults import Faults
from ftcal.synthetic.load import felt
from ftcal.synthetic.sensor import PretendSensor
from ftcal.synthetic.take import COLD, Take, Warmth, warmth

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

MICROSECOND = 1000
"""Finest step of the time stamps [ns]: logs of a YARP dumper keep no more."""

THERMOMETER_STEP = 0.1
"""Resolution of the thermometer [K]; it is read once a second."""


@dataclass(frozen=True, slots=True, eq=False)
class Mounted:
    """One sensor in the robot, and its port in the log."""

    name: str
    port: str
    sensor: PretendSensor

    @property
    def thermometer(self) -> str:
        """Port of its temperature."""
        return f"{self.port.rpartition('/')[0]}/temperature:o"


@dataclass(frozen=True, slots=True, eq=False)
class Logger:
    """A robot with its mounted sensors, and how well it logs both."""

    robot: Robot
    """As it weighs, not as its description says."""
    mounted: Sequence[Mounted]
    conditions: Conditions
    faults: Faults
    zeros: Mapping[str, float]
    """Joint → zero of its encoder [rad or m]."""
    warm: bool
    """Whether any sensor warms up in any take."""

    def record(
        self, take: Take, start: int, generator: np.random.Generator
    ) -> tuple[Recording, dict[str, Float[Array, "6"]]]:
        """Return one recording from `start` [ns] on, and the raw offset of each sensor [counts]."""
        ports = _joint_ports(take.trajectory.joints)
        ours = [mounted.port for mounted in self.mounted]
        clocks = _clocks([*ours, *ports], take.trajectory.duration, self.conditions, generator)
        began = min(int(clock[0]) for clock in clocks.values())
        since = {name: clock - began for name, clock in clocks.items()}

        offsets, channels, temperatures = {}, [], []
        for mounted in self.mounted:
            warm = warmth(take, self.conditions, generator) if self.warm else COLD
            stamps = since[mounted.port]
            wrench, raw = self.sense(mounted, take, warm, stamps / NANOSECONDS, generator)
            offsets[mounted.name] = raw
            channels.append(Signal(mounted.port, WRENCH_AXES, stamps + start, wrench))
            if self.warm and self.conditions.thermometer:
                name, duration = mounted.thermometer, take.trajectory.duration
                temperatures.append(self.thermometer(name, warm, duration, start))
        joints = tuple(
            Signal(
                name, columns, since[name] + start,
                self.encode(take, columns, since[name] / NANOSECONDS, generator),
            )
            for name, columns in ports.items()
        )  # fmt: skip
        recording = Recording(
            name=take.name,
            source="ftcal.synthetic",
            start=start,
            joints=joints,
            channels=tuple(channels),
            temperatures=tuple(temperatures),
        )
        return recording, offsets

    def sense(
        self,
        mounted: Mounted,
        take: Take,
        warm: Warmth,
        time: Float[Array, "N"],
        generator: np.random.Generator,
    ) -> tuple[Float[Array, "N 6"], Float[Array, "6"]]:
        """Return what a board sends [N, Nm] at `time` [s], and its raw offset [counts]."""
        name, sensor, faults = mounted.name, mounted.sensor, self.faults
        then = time - faults.delay_of(name)
        brushes = faults.brushes(take)
        wrench = felt(self.robot, take.trajectory, take.support, brushes, [name], then)[name]
        response = sensor.response(wrench, warm.above_reference(time))
        noise, largest = self.conditions.noise, self.conditions.offset
        raw = sensor.zero(response, generator, largest=largest, spare=8.0 * noise)
        if share := faults.saturated_share(name, take.name):
            raw = sensor.saturating(response, raw, share)
        counts = response + raw + noise * generator.normal(size=response.shape)
        for step in faults.steps_of(name, take.name):
            jumped = (time >= step.start) & (time < (np.inf if step.stop is None else step.stop))
            counts[jumped] += np.linalg.solve(sensor.gain, np.array(step.wrench))
        return sensor.sent(counts, digital=self.conditions.digital), raw

    def encode(
        self,
        take: Take,
        joints: tuple[str, ...],
        time: Float[Array, "N"],
        generator: np.random.Generator,
    ) -> Float[Array, "N K"]:
        """Return what the encoders of `joints` see at `time` [s], in rad or m."""
        motion = take.trajectory.at(time)
        zeros = np.array([self.zeros.get(joint, 0.0) for joint in joints])
        position = motion.position[:, motion.columns(joints)] + zeros
        noise = self.conditions.flicker * generator.normal(size=position.shape)
        step = self.conditions.encoder
        return np.asarray(np.rint(position / step + noise) * step) if step else position

    def thermometer(self, name: str, warm: Warmth, duration: float, start: int) -> Signal:
        """Return a sensor's temperature [degree Celsius], read once a second."""
        second = np.arange(int(np.ceil(round(duration, 6))) + 1)
        celsius = REFERENCE_TEMPERATURE + warm.above_reference(second)
        if self.conditions.digital:
            celsius = np.rint(celsius / THERMOMETER_STEP) * THERMOMETER_STEP
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

    Ports start within the stagger of each other; stamps keep their order whatever the jitter.
    """
    period = 1.0 / conditions.rate
    clocks = {}
    for port in ports:
        phase = generator.uniform(0.4, 0.4 + conditions.stagger) * period
        count = int((duration - phase) / period)
        jitter = generator.normal(size=count) * conditions.jitter
        when = phase + np.arange(count) * period + np.clip(jitter, -0.4 * period, 0.4 * period)
        clocks[port] = np.rint(when * (NANOSECONDS / MICROSECOND)).astype(np.int64) * MICROSECOND
    return clocks
