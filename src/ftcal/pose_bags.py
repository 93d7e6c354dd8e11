"""Poses from a ROS bag: the wrench of a wrist, and its attitude from `tf` or a `PoseStamped`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ftcal.errors import DataError, LogError, unknown
from ftcal.frame_tree import FrameTree, listed, rotation_from_quaternion, turns
from ftcal.logs.ros_poses import PoseBag, read_pose_bag
from ftcal.pose_clocks import BROKEN, joined
from ftcal.poses import Poses, gravity_in_sensor, other_conventions
from ftcal.recording import Signal


@dataclass(frozen=True, slots=True, kw_only=True)
class BagLayout:
    """What of a bag is the wrench, and what the attitude."""

    topic: str | None = None
    """Signal of the wrench, as `ftcal inspect` calls it; None: the only one."""
    frames: tuple[str, str] | None = None
    """Base (z up) and sensor frame, whose attitude `tf` says."""
    pose: str | None = None
    """Topic of poses of the sensor in the base (z up), in place of `frames`."""
    steady: float | None = None
    """Rows in which gravity turns faster than this [rad/s] are left out; None: all are kept."""


def read_bag(bag: Path, layout: BagLayout) -> Poses:
    """Return the poses in `bag`, the attitude interpolated to the wrench's clock.

    Rows beyond it and in its holes are left out. Raises `LogError` where the bag cannot be read,
    `DataError` where frames, topics or attitudes are not what `layout` says.
    """
    found = read_pose_bag(bag)
    wrench, frame = _wrench(bag, found, layout.topic)
    notes = list(found.notes)
    if layout.frames:
        base, sensor = layout.frames
        tree = FrameTree.of(str(bag), [
            turns(str(bag), one.parent, one.child, one.quaternions, fixed=one.fixed)
            for one in found.transforms
        ])  # fmt: skip
        attitude = tree.attitude(base, sensor)
        said = f"rotation from tf {base} -> {sensor}"
        if frame and frame != sensor:
            notes.append(
                f"messages of {wrench.name} say frame {frame!r}, the attitude is that of"
                f" {sensor!r}: believed to have the same axes"
            )
    else:
        attitude = _posed(bag, found, layout.pose)
        said = f"rotation from {layout.pose}"
    rows, rotation, moving, left = joined(
        wrench, attitude, "rotation", steady=layout.steady, where=str(bag),
        cure="record both in one run",
    )  # fmt: skip
    values = wrench.values[rows]
    return Poses(
        source=str(bag),
        attitude="rotation",
        read_as=f"wrench from {wrench.name}, {said} (sensor to base, base z up)",
        rows=rows + 1,
        wrench=values,
        gravity=gravity_in_sensor("rotation", rotation),
        alternatives=other_conventions(rotation, values),
        notes=(*notes, *left),
        moving=moving,
    )


def _wrench(bag: Path, found: PoseBag, topic: str | None) -> tuple[Signal, str]:
    """Return the wrench that is meant, and its frame."""
    known = {signal.name: (signal, frame) for signal, frame in found.wrenches}
    if topic is None and len(known) > 1:
        raise DataError(f"{bag}: {len(known)} wrenches, {', '.join(sorted(known))}; say --topic")
    name = topic or next(iter(known))
    if name not in known:
        raise DataError(f"{bag}: {unknown('wrench', name, known)}")
    signal, frame = known[name]
    row, column = np.unravel_index(np.abs(signal.values).argmax(), signal.values.shape)
    if abs(value := signal.values[row, column]) > BROKEN:
        raise LogError(f"{bag}: {name}, message {row + 1}: {signal.columns[column]} is"
                       f" {value:.3g}, which no sensor reads; cut the message")  # fmt: skip
    return signal, frame


def _posed(bag: Path, found: PoseBag, topic: str | None) -> Signal:
    """Return the rotations that messages of `topic` say."""
    same = [pose for pose in found.poses if pose.topic == topic]
    topics = {pose.topic for pose in found.poses}
    if topic is None:
        frames = {frame for one in found.transforms for frame in (one.parent, one.child)}
        raise DataError(
            f"{bag}: no attitude is named; say --tf BASE SENSOR ({listed(frames)}) or --pose TOPIC"
            f" ({listed(topics)})"
        )
    if not same:
        raise LogError(f"{bag}: {unknown('topic of poses', topic, topics)}")
    if len(same) > 1:
        told = ", ".join(sorted(pose.parent for pose in same))
        raise DataError(f"{bag}: poses of {topic} are in several frames ({told}); record one")
    pose = same[0]
    turned = turns(str(bag), pose.parent, topic, pose.quaternions).turned
    rotation = rotation_from_quaternion(turned.values).reshape(-1, 9)
    return Signal(topic, tuple(map(str, range(9))), turned.stamps, np.ascontiguousarray(rotation))
