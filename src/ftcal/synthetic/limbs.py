"""Several limbs at once: each joint moves as in the one motion that is told to move it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.motion import Motion
from ftcal.trajectory import Trajectory

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


ROUNDING = 1e-6
"""By how much durations may differ that are meant to be equal [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class SideBySide:
    """The motions of several groups of joints as one; all others are as in the first.

    Raises `DataError` where a joint is in two groups, or motions differ in length or joints.
    """

    parts: Sequence[Trajectory]
    """One motion a group, all of the same joints and duration."""
    groups: Sequence[Sequence[str]]
    """Joints that each of them moves."""

    def __post_init__(self) -> None:
        named = [joint for group in self.groups for joint in group]
        faults = [
            f"joint {joint!r} is in two groups" for joint in sorted(set(named))
            if named.count(joint) > 1
        ]  # fmt: skip
        if len(self.parts) != len(self.groups) or not self.parts:
            faults.append(f"{len(self.parts)} motions for {len(self.groups)} groups")
        last = [part.duration for part in self.parts]
        if len({part.joints for part in self.parts}) > 1 or np.ptp(last or [0.0]) > ROUNDING:
            faults.append("motions must be of the same joints and last equally long")
        raise_all(DataError, "motions side by side", faults)

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that move or are held."""
        return self.parts[0].joints

    @property
    def duration(self) -> float:
        """Seconds from 0 to the end."""
        return self.parts[0].duration

    def at(self, time: Float[Array, "N"]) -> Motion:
        """Return the motion at `time` [s]."""
        moved = [part.at(time) for part in self.parts]
        mover = {joint: k for k, group in enumerate(self.groups) for joint in group}
        sources = [moved[mover.get(joint, 0)] for joint in self.joints]

        def columns(quantity: str) -> Float[Array, "N J"]:
            return np.column_stack(
                [getattr(source, quantity)[:, k] for k, source in enumerate(sources)]
            )

        return Motion(
            moved[0].time,
            self.joints,
            columns("position"),
            columns("velocity"),
            columns("acceleration"),
        )
