"""What pairing a recording needs of its signals, known before the first sample passes by.

Sensors that are free in the same interval, and whose joints come from the same signals, are one
part: their motion is filtered once, and one kernel gives all their wrenches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ftcal.clocks import Clocks
from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError
from ftcal.pairing import FtChannel, SignalOptions, inertial_unit, one_sided
from ftcal.piece_motion import Source, sources
from ftcal.recording import NANOSECONDS, Recording
from ftcal.robot import Robot
from ftcal.signals import joint_owners


@dataclass(frozen=True, slots=True)
class Part:
    """Sensors that one half of the robot shows in one interval, from the same joint signals."""

    interval: Interval
    channels: tuple[FtChannel, ...]
    joints: tuple[str, ...]
    """All that their model wrenches need, signal by signal."""
    sources: tuple[Source, ...]
    """The signals that log them."""


def check_width(head: Recording, channel: FtChannel) -> None:
    """Raise `DataError` where a sensor has not the channels of its Workbench matrix."""
    signal = head.channel(channel.signal)
    expected = channel.workbench.gain.shape[1]
    if len(signal.columns) != expected:
        raise DataError(
            f"recording {head.name!r}: {signal.name!r} has {len(signal.columns)} channels, the"
            f" Workbench {channel.workbench.name!r} {expected}"
        )


def parts_of(
    head: Recording,
    robot: Robot,
    channels: Sequence[FtChannel],
    schedule: ContactSchedule,
    clocks: Clocks,
    options: SignalOptions,
) -> Iterator[Part]:
    """Yield which sensors are paired in which interval, as far as the log reaches."""
    alike: dict[tuple[Interval, frozenset[str]], list[FtChannel]] = {}
    joints_of: dict[tuple[str, str], tuple[str, ...]] = {}
    for channel in channels:
        runs_of_signal = clocks["channels", channel.signal].runs
        for interval in one_sided(robot, channel.sensor, schedule).intervals:
            spans = (runs_of_signal[:, :2] - head.start) / NANOSECONDS
            if not ((spans[:, 1] >= interval.start) & (spans[:, 0] < interval.stop)).any():
                continue
            key = (channel.sensor, interval.link)
            if key not in joints_of:
                joints_of[key] = robot.required_joints(*key)
            needed = joints_of[key]
            owners = joint_owners(head, needed)
            signals = frozenset(owners[joint].name for joint in needed)
            alike.setdefault((interval, signals), []).append(channel)
    for (interval, _), some in alike.items():
        every = {j for c in some for j in joints_of[c.sensor, interval.link]}
        columns = {
            signal.name: [k for k, joint in enumerate(signal.columns) if joint in every]
            for signal in head.joints
        }
        made = sources(
            clocks,
            [("joints", name, which) for name, which in columns.items() if which],
            window=options.joint_window,
            order=options.joint_order,
            where=f"recording {head.name!r}",
        )
        by_name = {signal.name: signal for signal in head.joints}
        joints = [by_name[one.signal].columns[k] for one in made for k in one.columns]
        yield Part(interval, tuple(some), tuple(joints), tuple(made))


def contact_source(head: Recording, imu: str, clocks: Clocks, options: SignalOptions) -> Source:
    """Return the IMU of a moving contact.

    The filter of the joints gives its values and, as their rate, the angular acceleration.
    """
    unit = inertial_unit(head, imu)
    (source,) = sources(
        clocks,
        [("imus", imu, range(len(unit.columns)))],
        window=options.joint_window,
        order=options.joint_order,
        where=f"recording {head.name!r}",
    )
    return source
