"""A recording and a robot → what every sensor said beside what its model says it felt.

Only usable samples: inside a contact interval, with every needed joint known, without a finding of
the data doctor that cuts. Channels and model wrench then pass the *same* zero-phase filter: the
law is linear, so C is unchanged, while the noise in r, which would bias it towards zero, goes.

A recording passes by piece by piece: joints are filtered once for all sensors, one kernel gives all
their wrenches, and what the filter still needs is carried over. It makes no difference how long the
pieces are, nor whether they come from memory or from a file that is larger than it.

A moving contact's own motion comes from an `imus` signal of six columns in the contact frame:
proper acceleration [m/s^2] (what an accelerometer reads) and angular velocity [rad/s].
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.clocks import Clocks
from ftcal.contact import ContactSchedule, Interval
from ftcal.dynamics import expected_wrenches
from ftcal.errors import DataError
from ftcal.kinematics import centre_of_mass_in_sensor, gravity_in_sensor
from ftcal.logs.pieces import Piece, Pieces
from ftcal.motion import Contact, FixedContact, Motion
from ftcal.pairing import FtChannel, SignalOptions, moving_contact
from ftcal.piece_motion import Source, reach
from ftcal.piece_parts import Part, check_width, contact_source, parts_of
from ftcal.recording import NANOSECONDS, Finding, Recording
from ftcal.robot import Robot
from ftcal.run_filter import odd_window
from ftcal.signals import longest_pause, temperature_at, usable
from ftcal.smoothing import Rows, Smoother

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array


@dataclass(slots=True, eq=False)
class Pairing:
    """The sensors of one recording, paired with the model while it passes by piece by piece."""

    head: Recording
    robot: Robot
    channels: tuple[FtChannel, ...]
    gravity: tuple[float, float, float]
    """Of the contact frame while it stands still [m/s^2]."""
    findings: tuple[Finding, ...]
    options: SignalOptions
    with_attitude: bool
    parts: tuple[Part, ...]
    contact: Source | None
    """The IMU that moves with the contact, if any."""
    overlap: float
    """How far beyond its own samples a piece must reach [s]."""
    smoothers: dict[str, Smoother]
    """By sensor."""
    pauses: dict[str, float]
    """Longest pause of every thermometer that is not a hole [s]."""
    usable: Counter[str] = field(default_factory=Counter)
    """Samples of every sensor that no finding cuts."""
    logged: Counter[str] = field(default_factory=Counter)
    """Samples of every sensor."""
    paired: Counter[str] = field(default_factory=Counter)
    """Samples of every sensor that came out."""
    latest: dict[str, Interval] = field(default_factory=dict)
    """In which interval the rows of a sensor were last."""

    @staticmethod
    def of(
        log: Pieces,
        robot: Robot,
        channels: Sequence[FtChannel],
        schedule: ContactSchedule,
        *,
        gravity: tuple[float, float, float],
        imu: str | None = None,
        findings: Iterable[Finding] = (),
        clocks: Clocks,
        options: SignalOptions | None = None,
        with_attitude: bool = False,
    ) -> Pairing:
        """Return what pairs the sensors of a log that was opened; `clocks` are its clocks.

        Raises as `pair`, but for what only the samples show.
        """
        options = options or SignalOptions()
        head = log.head
        for channel in channels:
            check_width(head, channel)
        where = f"recording {head.name!r}"
        parts = tuple(parts_of(head, robot, channels, schedule, clocks, options))
        contact = None if imu is None else contact_source(head, imu, clocks, options)
        thermometers = [head.temperature(c.temperature).name for c in channels if c.temperature]
        # slower than all else: the longest pause that a job allows is not theirs
        pauses = {n: longest_pause(clocks["temperatures", n].period) for n in thermometers}
        some = [source for part in parts for source in part.sources]
        some += [] if contact is None else [contact]
        smoothers = {}
        for channel in channels:
            clock = clocks["channels", channel.signal]
            try:
                window = odd_window(options.smoothing, clock.period)
            except DataError as error:
                raise DataError(f"{where}, signal {channel.signal!r}: {error}") from error
            smoothers[channel.sensor] = Smoother(window, options.smoothing_order, clock.gap)
        return Pairing(
            head,
            robot,
            tuple(channels),
            gravity,
            tuple(findings),
            options,
            with_attitude,
            parts,
            contact,
            max([reach(clocks, some), *pauses.values()]),
            smoothers,
            pauses,
        )

    def rows(self, piece: Piece) -> Iterator[tuple[FtChannel, Rows]]:
        """Yield what the next piece lets come out, sensor by sensor, in the order of time.

        The values of the rows are channels, then model wrench, smoothed alike; beside them
        T [degree Celsius] of a sensor with a thermometer, then gravity and centre of mass with
        `with_attitude`.
        """
        own = piece.own
        known = {c.sensor: self._usable(own, c) for c in self.channels}
        for part in self.parts:
            for channels in same_clock(own, part.channels):
                yield from self._part_rows(piece, own, part, channels, known)

    def _usable(self, own: Recording, channel: FtChannel) -> Bool[Array, "N"]:
        ok = usable(own, own.channel(channel.signal), self.findings)
        self.logged[channel.sensor] += len(ok)
        self.usable[channel.sensor] += int(np.count_nonzero(ok))
        return ok

    def _part_rows(
        self,
        piece: Piece,
        own: Recording,
        part: Part,
        channels: Sequence[FtChannel],
        known: Mapping[str, Bool[Array, "N"]],
    ) -> Iterator[tuple[FtChannel, Rows]]:
        """Yield the rows of sensors that share a clock, in one interval."""
        clock = own.channel(channels[0].signal)
        seconds = own.seconds(clock)
        if not len(seconds):
            return
        first, last = np.searchsorted(seconds, [part.interval.start, part.interval.stop])
        inside = slice(int(first), int(last))
        if not any(known[c.sensor][inside].any() for c in channels):
            self._interrupt(part, channels)
            return
        stamps = clock.stamps[inside]
        motion, contact, valid = self._motion(piece, part, stamps, seconds[inside])
        every = bool(valid.all())
        moved = motion if every else motion.rows(valid)
        here = contact if every else contact.rows(valid)
        names = [channel.sensor for channel in channels]
        expected = expected_wrenches(self.robot, moved, here, names) if len(moved) else {}
        for channel in channels:
            signal = own.channel(channel.signal)
            read = channel.workbench.channels(signal.values[inside])
            values = np.empty((len(stamps), read.shape[1] + 6))
            values[:, :-6] = read
            values[slice(None) if every else valid, -6:] = expected.get(channel.sensor, 0.0)
            beside = self._beside(piece, channel, stamps, moved, here, valid)
            opens = np.zeros(len(stamps), dtype=bool)
            rows = np.array([row for row in signal.breaks if inside.start <= row < inside.stop])
            opens[rows.astype(np.intp) - inside.start] = True
            if len(stamps):
                opens[0] |= self.latest.get(channel.sensor) is not part.interval
            keep = known[channel.sensor][inside] & valid
            for out in self.smoothers[channel.sensor].feed(
                Rows(stamps, values, beside), keep, opens
            ):
                warm = out.beside[:, :1] if channel.temperature is not None else None
                lasting = out if warm is None else out[np.isfinite(warm[:, 0])]
                self.paired[channel.sensor] += len(lasting)
                yield channel, lasting
            self.latest[channel.sensor] = part.interval
        if inside.stop < len(clock):
            self._interrupt(part, channels)

    def _interrupt(self, part: Part, channels: Sequence[FtChannel]) -> None:
        """Note that rows were passed over which lie in no stretch of this part."""
        for channel in channels:
            if self.latest.get(channel.sensor) is part.interval:
                del self.latest[channel.sensor]

    def _motion(
        self, piece: Piece, part: Part, stamps: Int[Array, "N"], seconds: Float[Array, "N"]
    ) -> tuple[Motion, Contact, Bool[Array, "N"]]:
        """Return the motion of joints and contact, and where both are known."""
        tables = [source.motion(piece.recording, stamps) for source in part.sources]
        valid = np.ones(len(stamps), dtype=bool)
        for _, known in tables:
            valid &= known
        if len(tables) == 1:
            table = tables[0][0]
        else:
            none = np.empty((3, len(stamps), 0))
            table = np.concatenate([none, *(one for one, _ in tables)], axis=2)
        motion = Motion(seconds, part.joints, *table)
        if self.contact is None:
            return motion, FixedContact(part.interval.link, self.gravity), valid
        readings, known = self.contact.motion(piece.recording, stamps)
        return motion, moving_contact(part.interval.link, readings), valid & known

    def _beside(
        self,
        piece: Piece,
        channel: FtChannel,
        stamps: Int[Array, "N"],
        moved: Motion,
        here: Contact,
        valid: Bool[Array, "N"],
    ) -> Float[Array, "N E"]:
        """Return what goes with the rows of a sensor and is not smoothed."""
        columns = []
        if channel.temperature is not None:
            warm = piece.recording.temperature(channel.temperature)
            columns.append(temperature_at(warm, stamps, self.pauses[channel.temperature])[:, None])
        if self.with_attitude:
            hanging = np.full((len(stamps), 6), np.nan)
            if len(moved):
                hanging[valid, :3] = gravity_in_sensor(self.robot, moved, here, channel.sensor)
                hanging[valid, 3:] = centre_of_mass_in_sensor(
                    self.robot, moved, here, channel.sensor
                )
            columns.append(hanging)
        return np.concatenate([np.empty((len(stamps), 0)), *columns], axis=1)

    def check(self) -> None:
        """Raise `DataError` after the last piece for a sensor of which nothing came out."""
        for channel in self.channels:
            sensor, signal = channel.sensor, channel.signal
            if self.paired[sensor]:
                continue
            if not self.usable[sensor]:
                kinds = sorted({f.kind for f in self.findings if f.cut and f.signal == signal})
                raise DataError(
                    f"recording {self.head.name!r}: all {self.logged[sensor]} samples of"
                    f" {signal!r} are cut ({', '.join(kinds)}); check the sensor's cable and its"
                    " board"
                )
            raise DataError(
                f"recording {self.head.name!r}, sensor {sensor!r}: no usable stretch is as long"
                f" as the {self.options.smoothing:g} s smoothing window (longest"
                f" {self.smoothers[sensor].longest / NANOSECONDS:.2f} s); log longer or smooth less"
            )


def same_clock(own: Recording, channels: Sequence[FtChannel]) -> list[list[FtChannel]]:
    """Return the sensors in groups that were logged at the same instants."""
    groups: list[list[FtChannel]] = []
    for channel in channels:
        stamps = own.channel(channel.signal).stamps
        for group in groups:
            if np.array_equal(own.channel(group[0].signal).stamps, stamps):
                group.append(channel)
                break
        else:
            groups.append([channel])
    return groups
