"""How the robot moved: joint trajectories and, for a floating robot, the motion of its base.

`ftcal.signals` makes motions from recordings, `ftcal.synthetic` invents them, `ftcal.dynamics`
turns them into wrenches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, unknown

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Gravity acceleration [m/s^2] in a frame whose z axis points up (BIPM, standard acceleration)."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Joint trajectories on one clock."""

    time: Float[Array, "N"]
    """Seconds since the start of the recording, strictly increasing."""
    joints: tuple[str, ...]
    """Joint name of each column."""
    position: Float[Array, "N J"]
    """rad (m for a prismatic joint)."""
    velocity: Float[Array, "N J"]
    """rad/s (m/s)."""
    acceleration: Float[Array, "N J"]
    """rad/s^2 (m/s^2)."""

    def __len__(self) -> int:
        return len(self.time)

    def columns(self, joints: Sequence[str]) -> list[int]:
        """Return the column of each of `joints`; `DataError` names all not logged."""
        index = {name: column for column, name in enumerate(self.joints)}
        if missing := [name for name in joints if name not in index]:
            hint = unknown("joint signal", missing[0], self.joints) if len(missing) == 1 else ""
            raise DataError(
                f"joints not logged but needed: {', '.join(missing)}"
                f"{' (' + hint + ')' if hint else ''}; log them, or name another contact"
            )
        return [index[name] for name in joints]

    def rows(self, where: slice | Array) -> Motion:
        """Return the samples that `where` selects."""
        return Motion(
            self.time[where],
            self.joints,
            self.position[where],
            self.velocity[where],
            self.acceleration[where],
        )


@dataclass(frozen=True, slots=True)
class FixedContact:
    """A frame of the robot that stands still in the world, with a known direction of gravity."""

    link: str
    """Link (or frame) that touches the world."""
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    """Gravity acceleration [m/s^2] expressed in that frame: the default is a level sole."""

    def rows(self, where: slice | Array) -> FixedContact:
        """Return the contact during the samples that `where` selects: it stands still always."""
        return self


@dataclass(frozen=True, slots=True)
class MovingContact:
    """A frame whose own motion is known, such as a base with an IMU; all vectors in that frame."""

    link: str
    """Link (or frame) whose motion is known and which alone touches the world."""
    gravity: Float[Array, "N 3"]
    """Gravity acceleration [m/s^2]."""
    angular_velocity: Float[Array, "N 3"]
    """rad/s."""
    linear_acceleration: Float[Array, "N 3"]
    """Classical (not spatial) acceleration of the frame's origin without gravity [m/s^2]."""
    angular_acceleration: Float[Array, "N 3"]
    """rad/s^2."""

    def rows(self, where: slice | Array) -> MovingContact:
        """Return the samples that `where` selects."""
        return MovingContact(
            self.link,
            self.gravity[where],
            self.angular_velocity[where],
            self.linear_acceleration[where],
            self.angular_acceleration[where],
        )

    def proper_acceleration(self) -> Float[Array, "N 3"]:
        """Return what an accelerometer at the frame's origin reads [m/s^2]."""
        return np.asarray(self.linear_acceleration - self.gravity)


Contact = FixedContact | MovingContact
