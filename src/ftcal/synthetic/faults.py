"""What goes wrong on request: the faults of real sensors, feet, clocks and robot descriptions.

All are off by default. They draw from a stream of their own: a session with a fault and the one
without it differ by that fault alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ftcal.errors import DataError, raise_all, unknown
from ftcal.robot import Robot
from ftcal.support import Support
from ftcal.synthetic.take import Take


@dataclass(frozen=True, slots=True, kw_only=True)
class Saturation:
    """The raw zero of a sensor leaves one channel too little room: the board freezes at times."""

    sensor: str
    share: float
    """About which share of the samples has the widest channel beyond its range."""
    take: str | None = None
    """Take in which it happens; None: every one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetStep:
    """The reading of a sensor jumps, as that of the real right hip does."""

    sensor: str
    take: str
    start: float
    """When it jumps [s]."""
    wrench: tuple[float, float, float, float, float, float]
    """By how much [N, Nm]."""
    stop: float | None = None
    """When it jumps back [s]; None: never."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Brush:
    """A frame that the job says is free carries a little, as toes that touch the floor do."""

    take: str
    frame: str
    start: float
    """From when on it carries all of its share [s]."""
    stop: float
    """Until when [s]."""
    share: float
    """Of the weight."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults:
    """What goes wrong beyond the usual `Conditions`; nothing by default."""

    kappa: Mapping[str, float] = field(default_factory=dict)
    """Sensor → bend by its mounting, instead of that of the conditions."""
    saturation: tuple[Saturation, ...] = ()
    steps: tuple[OffsetStep, ...] = ()
    brushing: tuple[Brush, ...] = ()
    """At given times."""
    switch_share: float = 0.0
    """Share of the weight on every foot just after the job says it was lifted, and just before it
    says it is put down."""
    switch_seconds: float = 0.5
    """For how long [s]."""
    delay: float = 0.0
    """How much later than it was felt a wrench is stamped [s]."""
    delays: Mapping[str, float] = field(default_factory=dict)
    """Sensor → its own delay [s], instead."""
    joint_zero: float = 0.0
    """Standard deviation of the zero of each joint's encoder [rad or m]."""
    mass: float = 0.0
    """Standard deviation of the mass of each link about the description's, relative."""
    com: float = 0.0
    """Standard deviation of each coordinate of a link's centre of mass [m]."""

    def __post_init__(self) -> None:
        faults = [
            f"{name} = {value:g} must be zero or more and finite"
            for name, value in (
                *((f"kappa of {sensor!r}", value) for sensor, value in self.kappa.items()),
                *((f"delay of {sensor!r}", abs(value)) for sensor, value in self.delays.items()),
                ("delay", abs(self.delay)),
                ("switch_seconds", self.switch_seconds),
                ("joint_zero", self.joint_zero),
                ("mass", self.mass),
                ("com", self.com),
            )
            if not 0.0 <= value < np.inf
        ]
        faults += [
            f"{name} = {share:g} must be from 0 up to below 1"
            for name, share in (
                *((f"saturation of {fault.sensor!r}: share", fault.share)
                  for fault in self.saturation),
                *((f"brushing of {fault.frame!r}: share", fault.share) for fault in self.brushing),
                ("switch_share", self.switch_share),
            )
            if not 0.0 <= share < 1.0
        ]  # fmt: skip
        faults += [
            f"{name}: {start:g} to {stop:g} s ends before it starts"
            for name, start, stop in (
                *((f"step of {s.sensor!r}", s.start, s.stop) for s in self.steps),
                *((f"brushing of {b.frame!r}", b.start, b.stop) for b in self.brushing),
            )
            if stop is not None and not stop > start
        ]
        raise_all(DataError, "faults", faults)

    def delay_of(self, sensor: str) -> float:
        """Return the delay of `sensor` [s]."""
        return self.delays.get(sensor, self.delay)

    def saturated_share(self, sensor: str, take: str) -> float:
        """Return about which share of the samples of a take a sensor is to be frozen."""
        shares = (s.share for s in self.saturation
                  if s.sensor == sensor and s.take in (None, take))  # fmt: skip
        return max(shares, default=0.0)

    def steps_of(self, sensor: str, take: str) -> tuple[OffsetStep, ...]:
        """Return the offset steps of `sensor` in a take."""
        return tuple(s for s in self.steps if s.sensor == sensor and s.take == take)

    def brushes(self, take: Take) -> tuple[Brush, ...]:
        """Return when which frame of a take brushes: as asked, and at every switch."""
        given = tuple(brush for brush in self.brushing if brush.take == take.name)
        if not self.switch_share:
            return given
        return given + tuple(
            Brush(take=take.name, frame=frame, start=start, stop=stop, share=self.switch_share)
            for frame, start, stop in _switches(take.support, self.switch_seconds)
        )


def _switches(support: Support, seconds: float) -> Iterable[tuple[str, float, float]]:
    """Yield frame, start and stop [s] of what follows a lift-off or precedes a touch-down."""
    pairs = list(itertools.pairwise(support.schedule().intervals))
    # a pole that lets the robot go is no foot: it never takes weight anew
    feet = {name for a, b in pairs for name in b.touching if name not in a.touching}
    for before, after in pairs:
        for frame in sorted(feet.intersection(before.touching).difference(after.touching)):
            yield frame, after.start, min(after.start + seconds, after.stop)
        for frame in sorted(set(after.touching).difference(before.touching)):
            yield frame, max(before.stop - seconds, before.start), before.stop


def check(faults: Faults, robot: Robot, sensors: Iterable[str], takes: Sequence[Take]) -> None:
    """Raise `DataError` that names every sensor, take and frame of `faults` that is not there."""
    known = {
        "sensor": set(sensors),
        "take": {take.name for take in takes},
        "link": set(robot.links),
    }
    named = [
        *(("kappa", "sensor", name) for name in faults.kappa),
        *(("delays", "sensor", name) for name in faults.delays),
        *(("saturation", "sensor", s.sensor) for s in faults.saturation),
        *(("saturation", "take", s.take) for s in faults.saturation if s.take is not None),
        *(("steps", "sensor", s.sensor) for s in faults.steps),
        *(("steps", "take", s.take) for s in faults.steps),
        *(("brushing", "take", b.take) for b in faults.brushing),
        *(("brushing", "link", b.frame) for b in faults.brushing),
    ]
    wrong = [
        f"{key}: {unknown(kind, name, known[kind])}"
        for key, kind, name in named
        if name not in known[kind]
    ]
    raise_all(DataError, "faults", wrong)
