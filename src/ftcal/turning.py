"""Wrenches that a driver logged in the axes of another link, turned back into the sensor's frame.

Some drivers turn the force and the torque of a wrist or leg sensor by the robot's own kinematics,
often into the axes of the base; the torque stays that about the sensor's origin. In those axes a
sensor has no constant gain and no constant offset. With R the rotation of the sensor's frame S in
link L, and positions linear between two samples of the joints,

    S_f = L_R_S(q)^T L_f,    S_tau = L_R_S(q)^T L_tau .

Where a joint on the way is not known the sample is left out. A log in pieces gives the bits of the
whole: the two samples about a stamp alone decide.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.kinematics import sensor_pose
from ftcal.logs.pieces import Piece, Pieces, Role, WholeLog, cut, named, signal_rows
from ftcal.motion import Motion
from ftcal.pairing import FtChannel
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.robot import Robot
from ftcal.signals import joint_owners, longest_pause, temperature_at

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

BLOCK_ROWS = 4096
"""Samples that are turned at a time: 4x4 poses of all samples of a log would not fit."""


@dataclass(frozen=True, slots=True)
class Turn:
    """One sensor whose wrench is logged in the axes of a link."""

    signal: str
    """F/T signal of the log."""
    sensor: str
    """Name in the robot description."""
    link: str
    """Link in whose axes the log gives force and torque."""
    joints: Mapping[str, str]
    """Joints between link and sensor, with the signal that logs each."""


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """All that turns the wrenches of one log, whether it is seen whole or piece by piece."""

    robot: Robot
    turns: tuple[Turn, ...]
    gaps: Mapping[tuple[Role, str], float]
    """Longest pause [s] that is not a hole, of every signal concerned."""

    @staticmethod
    def of(
        log: Pieces, robot: Robot, channels: Iterable[FtChannel], max_gap: float | None = None
    ) -> Turning:
        """Return what turns the sensors among `channels` that have a `wrench_frame`.

        Raises `DataError` with all faults: a signal that is no wrench, or joints not logged;
        `RobotError` for an unknown link.
        """
        head = log.head
        turns, faults = [], []
        logged = {joint for signal in head.joints for joint in signal.columns}
        for channel in channels:
            if channel.wrench_frame is None:
                continue
            signal, link = channel.signal, channel.wrench_frame
            if (columns := len(head.channel(signal).columns)) != 6:
                faults.append(
                    f"{signal!r} has {columns} channels; a wrench in the axes of {link!r} has six,"
                    " so leave wrench_frame out"
                )
            way = robot.path(link, robot.sensor(channel.sensor).child)
            joints = [joint.name for joint in way if joint.kind != "fixed"]
            if missing := [joint for joint in joints if joint not in logged]:
                faults.append(
                    f"turning {signal!r} back from the axes of {link!r} needs joints that are not"
                    f" logged ({', '.join(missing)}); log them, or log the wrench as the sensor"
                    " measures it"
                )
                continue
            owners = {joint: owner.name for joint, owner in joint_owners(head, joints).items()}
            turns.append(
                Turn(signal, channel.sensor, link, {joint: owners[joint] for joint in joints})
            )
        raise_all(DataError, f"recording {head.name!r}", faults)
        concerned: set[tuple[Role, str]] = {("channels", turn.signal) for turn in turns}
        concerned |= {("joints", name) for turn in turns for name in turn.joints.values()}
        return Turning(
            robot,
            tuple(turns),
            {
                (role, name): longest_pause(log.period(role, name)) if max_gap is None else max_gap
                for role, name in concerned
            },
        )

    @property
    def reach(self) -> float:
        """How far from a sample lies what turns it [s]."""
        # two nanoseconds: spans and pauses are rounded to them
        return max(self.gaps.values(), default=0.0) + 2.0 / NANOSECONDS

    def turned(self, recording: Recording) -> Recording:
        """Return a recording, or a part of it, with the wrenches in the frames of their sensors."""
        by_signal = {turn.signal: turn for turn in self.turns}
        return replace(
            recording,
            channels=tuple(
                self._turned(recording, signal, by_signal[signal.name])
                if signal.name in by_signal
                else signal
                for signal in recording.channels
            ),
        )

    def _turned(self, recording: Recording, signal: Signal, turn: Turn) -> Signal:
        position = self._positions(recording, turn, signal.stamps)
        known = np.isfinite(position).all(axis=1)
        kept = without(signal, known, self.gaps["channels", signal.name])
        position = position[known]
        values = np.empty(kept.values.shape)
        for start in range(0, len(kept), BLOCK_ROWS):
            rows = slice(start, start + BLOCK_ROWS)
            q = position[rows]
            motion = Motion(np.zeros(len(q)), tuple(turn.joints), q, q, q)  # no pose asks for rates
            L_R_S = sensor_pose(self.robot, motion, turn.link, turn.sensor)[:, :3, :3]
            values[rows] = in_sensor(L_R_S, kept.values[rows])
        return replace(kept, values=values)

    def _positions(
        self, recording: Recording, turn: Turn, clock: Int[Array, "N"]
    ) -> Float[Array, "N J"]:
        """Return the joints of a turn on the stamps `clock` [ns], NaN where they are not known."""
        position = np.empty((len(clock), len(turn.joints)))
        for column, (joint, owner) in enumerate(turn.joints.items()):
            signal = named(recording, "joints", owner)
            at = signal.columns.index(joint)
            alone = replace(signal, columns=(joint,), values=signal.values[:, at : at + 1])
            # a joint between two samples, as a thermometer is: no other sample has a say
            position[:, column] = temperature_at(alone, clock, self.gaps["joints", owner])
        return position


def in_sensor(L_R_S: Float[Array, "N 3 3"], wrench: Float[Array, "N 6"]) -> Float[Array, "N 6"]:
    """Return wrenches [N, Nm] of the axes of L in those of S, about the same point."""
    turned = np.empty(wrench.shape)
    for first in (0, 3):
        for axis in range(3):
            # term by term: a sum over an axis rounds a row by its place among the others
            turned[:, first + axis] = (
                L_R_S[:, 0, axis] * wrench[:, first]
                + L_R_S[:, 1, axis] * wrench[:, first + 1]
                + L_R_S[:, 2, axis] * wrench[:, first + 2]
            )
    return turned


def without(signal: Signal, known: Bool[Array, "N"], gap: float) -> Signal:
    """Return the samples of a signal that are known; one after samples left out opens a session.

    Unless a hole longer than `gap` [s] lies before it anyway: what a piece shows must decide.
    """
    if known.all():
        return signal
    opens = np.zeros(len(signal), dtype=bool)
    opens[list(signal.breaks)] = True
    opens[1:] |= ~known[:-1] & (np.diff(signal.stamps) <= round(gap * NANOSECONDS))
    return replace(
        signal,
        stamps=signal.stamps[known],
        values=signal.values[known],
        breaks=tuple(np.flatnonzero(opens[known]).tolist()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class TurnedPieces:
    """A log in pieces with the wrenches in the frames of their sensors: a `Pieces` itself."""

    log: Pieces
    """As logged."""
    turning: Turning
    head: Recording
    """The recording with the first sample of each signal that is left."""

    @staticmethod
    def of(log: Pieces, turning: Turning) -> TurnedPieces:
        """Return a log that was opened as one that is turned; it is read as far as its head needs.

        Raises `LogError` where it cannot be believed so far.
        """
        first = {
            turn.signal: signal_rows(log.head.channel(turn.signal), 0, 0) for turn in turning.turns
        }
        for piece in TurnedPieces(log, turning, log.head).pieces():
            waiting = [name for name, signal in first.items() if not len(signal)]
            first |= {name: signal_rows(piece.own.channel(name), 0, 1) for name in waiting}
            if all(len(signal) for signal in first.values()):
                break
        channels = tuple(first.get(signal.name, signal) for signal in log.head.channels)
        return TurnedPieces(log, turning, replace(log.head, channels=channels))

    def period(self, role: Role, name: str) -> float:
        """Return `Signal.period` [s] of a signal as it was logged; `DataError` without one."""
        return self.log.period(role, name)

    def pieces(self, *, rows: int | None = None, overlap: float = 0.0) -> Iterator[Piece]:
        """Yield the pieces in order, as `Pieces.pieces` has it."""
        margin = round(overlap * NANOSECONDS)
        for piece in self.log.pieces(rows=rows, overlap=overlap + self.turning.reach):
            shown = self.turning.turned(piece.recording)
            yield replace(piece, recording=cut(shown, piece.start - margin, piece.stop + margin))


def turned_back(
    log: Pieces, robot: Robot, channels: Sequence[FtChannel], *, max_gap: float | None = None
) -> Pieces:
    """Return a log with every wrench in the frame of its sensor.

    Those of `channels` with a `wrench_frame` are turned; without any it is the log itself. A pause
    of the joints longer than `max_gap` [s] (None: five periods) is a hole, whose samples are left
    out. Raises `DataError` with all faults of the signals, and where no sample is left of one;
    `RobotError` for an unknown link, `LogError` where the log cannot be believed.
    """
    if all(channel.wrench_frame is None for channel in channels):
        return log
    match log:
        case WholeLog(recording):
            return WholeLog(recording_turned_back(recording, robot, channels, max_gap=max_gap))
    turned = TurnedPieces.of(log, Turning.of(log, robot, channels, max_gap))
    check_left(turned.turning, log.head, turned.head)
    return turned


def recording_turned_back(
    recording: Recording,
    robot: Robot,
    channels: Sequence[FtChannel],
    *,
    max_gap: float | None = None,
) -> Recording:
    """Return `turned_back` of a recording that is in memory; raises as it does."""
    if all(channel.wrench_frame is None for channel in channels):
        return recording
    turning = Turning.of(WholeLog(recording), robot, channels, max_gap)
    turned = turning.turned(recording)
    check_left(turning, recording, turned)
    return turned


def check_left(turning: Turning, logged: Recording, turned: Recording) -> None:
    """Raise `DataError` where a signal has samples as it was logged and none when turned."""
    raise_all(
        DataError,
        f"recording {logged.name!r}",
        [
            f"{', '.join(turn.joints)} are known at no sample of {turn.signal!r}, which they turn"
            f" back from the axes of {turn.link!r}; log both at once"
            for turn in turning.turns
            if len(logged.channel(turn.signal)) and not len(turned.channel(turn.signal))
        ],
    )
