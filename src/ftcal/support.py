"""Which frames carry the robot, and how much of it each: a foot, both feet, the pole it hangs on.

The wrenches inside a robot that several frames carry are not determined by its motion: it may press
its feet apart. But whatever wrench each sensor would feel if one frame carried all, in proportion
to the shares of the weight their blend satisfies the balance of every sub-model that touches
nothing. So a share per frame is all that a pretend robot needs to stand on two feet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError, raise_all
from ftcal.motion import STANDARD_GRAVITY, FixedContact
from ftcal.trajectory import progress

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ROUNDING = 1e-9
"""By how much the shares of a row may miss one."""


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """Frames that stand still while they carry, their shares of the weight, and a clock.

    Raises `DataError` where times do not increase from 0 or the shares of a row are not shares.
    """

    frames: tuple[str, ...]
    """Links or frames that touch the world at some time; each stands still while it carries."""
    times: Float[Array, "K"]
    """When each row of `shares` is reached [s], from 0, strictly increasing."""
    shares: Float[Array, "K F"]
    """Share of the weight each frame carries; each row sums to one."""
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    """Gravity acceleration [m/s^2] in every one of the frames: the default is a level sole."""

    def __post_init__(self) -> None:
        faults = [
            f"frame {name!r} appears twice; give it one column"
            for name in sorted(set(self.frames))
            if self.frames.count(name) > 1
        ]
        if not self.frames:
            faults.append("there is no frame; a robot hangs or stands on something")
        if np.ndim(self.times) != 1 or np.shape(self.shares) != (len(self.times), len(self.frames)):
            faults.append(
                f"shares have shape {np.shape(self.shares)} for {np.shape(self.times)} times and"
                f" {len(self.frames)} frames; give one row a time, one column a frame"
            )
        else:
            faults += self._wrong_times() + self._wrong_shares()
        if not np.isfinite(self.gravity).all():
            faults.append(f"gravity {self.gravity} must be finite")
        raise_all(DataError, "support", faults)

    def _wrong_times(self) -> list[str]:
        begins = len(self.times) > 0 and self.times[0] == 0.0
        if begins and np.isfinite(self.times).all() and (np.diff(self.times) > 0.0).all():
            return []
        return ["times must increase strictly, from 0 s; drop what comes before or twice"]

    def _wrong_shares(self) -> list[str]:
        return [
            f"shares {row.tolist()} at {time:g} s must be 0 or more and sum to one"
            for time, row in zip(self.times, self.shares, strict=True)
            if not (row.min(initial=0.0) >= 0.0 and abs(row.sum() - 1.0) < ROUNDING)
        ]

    def at(self, time: Float[Array, "N"]) -> Float[Array, "N F"]:
        """Return the shares at `time` [s]: of minimum jerk between the rows, constant beyond."""
        place = np.interp(time, self.times, np.arange(len(self.times)))
        row = place.astype(np.intp)
        after = np.minimum(row + 1, len(self.times) - 1)
        gone = progress(place - row)[:, None]
        return np.asarray(self.shares[row] + gone * (self.shares[after] - self.shares[row]))

    def schedule(self) -> ContactSchedule:
        """Return who touches, and when: longest spans with the same frames, the last without end.

        A frame touches between two rows if it carries at either.
        """
        carries = self.shares > 0.0
        touches = carries.copy()
        touches[:-1] |= carries[1:]
        begins = np.concatenate(([True], (touches[1:] != touches[:-1]).any(axis=1)))
        starts = [*self.times[begins].tolist(), np.inf]
        names = [tuple(np.array(self.frames)[row].tolist()) for row in touches[begins]]
        return ContactSchedule(
            tuple(
                Interval(start, stop, first, tuple(others))
                for start, stop, (first, *others) in zip(starts, starts[1:], names, strict=False)
            )
        )


def standing_on(contact: FixedContact) -> Support:
    """Return the support of a robot that one frame carries throughout."""
    return Support((contact.link,), np.zeros(1), np.ones((1, 1)), contact.gravity)
