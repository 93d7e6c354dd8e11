"""What a log does not say of itself: names, units, which column is which.

Every field has a default that fits the format's own habits; a job file states what differs. The
joint order of an iCub part is that of its motor board, not that of the URDF.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

Angle = Literal["deg", "rad"]
TimeUnit = Literal["s", "ms", "us", "ns"]
Acceleration = Literal["m/s^2", "g"]
AngularVelocity = Literal["rad/s", "deg/s"]

WRENCH_AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
"""Channels of a six-axis sensor in logged order, force first."""

_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow",
        "wrist_prosup", "wrist_pitch", "wrist_yaw")  # fmt: skip

ICUB_JOINTS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "torso": ("torso_yaw", "torso_roll", "torso_pitch"),
    "head": ("neck_pitch", "neck_roll", "neck_yaw", "eyes_tilt", "eyes_version", "eyes_vergence"),
    **{f"{side}_leg": tuple(f"{side[0]}_{joint}" for joint in _LEG) for side in ("left", "right")},
    **{f"{side}_arm": tuple(f"{side[0]}_{joint}" for joint in _ARM) for side in ("left", "right")},
})  # fmt: skip
"""URDF joint of each logged column, by part. An arm logs up to nine hand joints more: left out.
The eyes are no joints of the calibration models; their names are only kept apart here."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What a job file may say about a log."""

    joints: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """YARP: port (`torso/state:o`) → URDF joint of each logged column, in logged order; columns
    beyond the last name, and those named "", are left out. Default: `ICUB_JOINTS` by the part's
    name; columns of an unknown part are called `<part>_0`, `<part>_1`, ….
    Tables: column → `(joint,)` renames it, column → `()` leaves it out.
    ROS: topic → URDF joint of each position, in the order of its first message; "" and what lies
    beyond the last name are left out, `()` leaves out the topic. Default: the message's names.
    robot-logger: leaf → URDF joint of each column, "" to leave out. Default: `elements_names`."""

    angle: Angle | None = None
    """Unit of the logged joint positions; None: the format's own (YARP deg, tables rad)."""

    time: str = "time"
    """Tables: the column of time stamps."""

    time_unit: TimeUnit | None = None
    """Unit of the stamps (not YARP, ROS). None: fractional numbers are seconds; integers are taken
    for Unix time of the years 2000 to 2100 in whichever unit makes them so, others are refused;
    a column of date-and-time type needs no unit."""

    channels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Tables: F/T signal → its columns. Whatever is left over and reads `<prefix>fx` … `fz` with
    `tx` … `tz` (or `mx` … `mz`; separator `.`, `_`, `/` or none) becomes the signal `<prefix>`;
    with no prefix it is called like its file.
    YARP: port → names of its columns; makes any numeric port an F/T signal.
    ROS: topic → names of its columns; makes an array or a JointState an F/T signal.
    robot-logger: F/T signal → the leaves whose columns it joins. `.npz`: an array's name stands for
    all its columns."""

    temperatures: Mapping[str, str] = field(default_factory=dict)
    """Temperature signal → its column (tables), port of one column (YARP), topic (ROS) or
    leaf (robot-logger)."""

    imus: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Base motion or inertial unit → its columns (tables), or port → names of its columns (YARP);
    read as logged but for the units below. robot-logger: imu → its accelerometer and its gyro."""

    acceleration: Acceleration | None = None
    """Unit of the accelerations among the imus; None: m/s^2, or what the log itself declares."""

    angular_velocity: AngularVelocity | None = None
    """Unit of the angular velocities among the imus; None: as logged, or as the log declares."""

    zero: str | None = None
    """Signal whose first sample is second 0 of the recording; None: the earliest of all."""


PLAIN = Layout()
"""A log that is all habit."""


def part_joints(part: str, logged: int) -> tuple[str, ...]:
    """Return the URDF joint of each of the `logged` columns of an iCub part, "" to leave out."""
    names = ICUB_JOINTS.get(part) or tuple(f"{part}_{column}" for column in range(logged))
    return names[:logged] + ("",) * (logged - len(names))
